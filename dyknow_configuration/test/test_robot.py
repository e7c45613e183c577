"""The ontology, the annotations, the streams and the formulas of a robot.yaml."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from dyknow_common import CONSTRAINT_KINDS, InlineText, StreamConstraints, ValueType
from dyknow_configuration import (
    NO_MAP,
    PACKAGES,
    ConfigurationError,
    RequestedFormula,
    RobotConfiguration,
    Severity,
    export,
    read_formulas,
    read_robot,
    write_texts,
)
from dyknow_configuration.nodes import COMMON, PARAMETERS, ParameterKind
from dyknow_semantics import Ontology, check_annotation, match, parse_annotations, parse_concept
from dyknow_stream_processing import parse_specification, specifications_by_sink

FLEET = """\
sorts:
  Vehicle: {description: It moves <by itself> & alone.}
  UAV: {below: Vehicle}
  Zone:
objects:
  Vehicle: [truck]
  UAV: [uav1, uav2]
  Zone: [north]
features:
  Altitude:
    description: |
      The height
      above the origin.
    of: {v: Vehicle}
    unit: m
    from:
      - {topic: '/{v}/odom', field: pose.pose.position.z, only: {v: [uav1, uav2]}, max_delay: 1 s}
      - {topic: /fleet, field: 'z', where: {v: id}, unit: ft}
  GpsAltitude: {below: Altitude, from: {topic: '/{v}/gps', field: altitude}}
  Distance:
    of: {a: UAV, b: UAV}
    unit: m
    from: {stream: '{a}_{b}_distance', field: distance}
  Inside: {of: [Vehicle, Zone], type: boolean, from: {topic: '/{Vehicle}/zones', field: '{Zone}'}}
  Wind: {unit: m/s, from: {topic: /weather, field: 'speed'}}
  Mode: {of: Vehicle, type: string}
streams:
  - 'compunit distance: float distance((x: float, y: float), (x: float, y: float))  # one'
  - for: {u: UAV}
    text: |-
      stream {u}_position = select x, y from "/{u}/odom";
      sink {u}_position # a comment at the end
  - for: {a: UAV, b: UAV}
    text: |
      stream {a}_{b}_distance = distance({a}_position, {b}_position);
      sink {a}_{b}_distance;
"""


def robot(folder: Path, text: str) -> RobotConfiguration:
    path = folder / 'robot.yaml'
    path.write_text(text, encoding='utf-8')
    return read_robot(path)


def annotations(configuration: RobotConfiguration) -> list[str]:
    return [each.text for each in configuration.annotations if isinstance(each, InlineText)]


def loaded(configuration: RobotConfiguration) -> Ontology:
    ontology = Ontology()
    for each in configuration.ontologies:
        assert isinstance(each, InlineText)
        ontology.load_text(each.text)
    return ontology


def test_the_ontology(tmp_path: Path) -> None:
    with loaded(robot(tmp_path, FLEET)) as ontology:
        knowledge = ontology.knowledge
        assert knowledge.instances('Vehicle') == ('truck', 'uav1', 'uav2')
        assert knowledge.instances('robot:UAV') == ('uav1', 'uav2')
        features = {each.name: each for each in knowledge.features}
        # Each has its arguments, its type and its unit, also those that are inherited.
        assert features['GpsAltitude'].argument_sorts == ('Vehicle',)
        assert features['GpsAltitude'].unit == 'm'
        assert features['Distance'].argument_sorts == ('UAV', 'UAV')
        assert features['Inside'].value_type is ValueType.BOOLEAN
        assert features['Wind'].argument_sorts == ()
        assert 'Altitude' in knowledge.superconcepts('GpsAltitude')
        comment = 'SELECT ?c { ?x rdfs:comment ?c }'
        comments = {row[0] for row in ontology.query(comment)[1]}
        assert {'It moves <by itself> & alone.', 'The height above the origin.'} <= comments


def test_the_annotations(tmp_path: Path) -> None:
    configuration = robot(tmp_path, FLEET)
    assert annotations(configuration) == [
        'stream "/uav1/odom" contains Altitude[uav1] = pose.pose.position.z with max_delay = 1 s;',
        'stream "/uav2/odom" contains Altitude[uav2] = pose.pose.position.z with max_delay = 1 s;',
        'stream "/fleet" contains Altitude[v] = z [ft] for every v in Vehicle where v = id;',
        'stream "/truck/gps" contains GpsAltitude[truck] = altitude;',
        'stream "/uav1/gps" contains GpsAltitude[uav1] = altitude;',
        'stream "/uav2/gps" contains GpsAltitude[uav2] = altitude;',
        'stream uav1_uav2_distance contains Distance[uav1, uav2] = distance;',
        'stream uav2_uav1_distance contains Distance[uav2, uav1] = distance;',
        'stream "/truck/zones" contains Inside[truck, north] = north;',
        'stream "/uav1/zones" contains Inside[uav1, north] = north;',
        'stream "/uav2/zones" contains Inside[uav2, north] = north;',
        'stream "/weather" contains Wind = speed;',
    ]
    assert {each.name for each in configuration.annotations if isinstance(each, InlineText)} >= {
        f'{tmp_path}/robot.yaml:17:37',
        f'{tmp_path}/robot.yaml:18:33',
    }


def test_when_a_value_is_unknown(tmp_path: Path) -> None:
    text = (
        'objects: {Rover: [r1]}\n'
        'features:\n'
        '  Charge:\n'
        '    of: {r: Rover}\n'
        '    range: [0, 1]\n'
        "    unknown: '{r}.percentage < 0'\n"
        "    from: {topic: '/{r}/battery', field: percentage}\n"
    )
    found = robot(tmp_path, text)
    assert annotations(found) == [
        'stream "/r1/battery" contains Charge[r1] = percentage unless r1.percentage < 0;'
    ]
    assert '<dyknow:unknown>0.0 1.0</dyknow:unknown>' in str(found.ontologies[0].text)


def test_the_annotations_match(tmp_path: Path) -> None:
    configuration = robot(tmp_path, FLEET)
    parsed = [each for text in annotations(configuration) for each in parse_annotations(text)]
    with loaded(configuration) as ontology:
        for each in parsed:
            check_annotation(each, ontology.knowledge)
        found = match(parse_concept('Altitude[uav1]'), parsed, ontology.knowledge)
    topics = [each.specification.split('from "')[-1].split('"')[0] for each in found]
    assert sorted(topics) == ['/fleet', '/uav1/gps', '/uav1/odom']


def test_the_streams(tmp_path: Path) -> None:
    (text,) = robot(tmp_path, FLEET).streams
    assert isinstance(text, InlineText)
    assert list(specifications_by_sink(parse_specification(text.text))) == [
        'uav1_position',
        'uav2_position',
        'uav1_uav2_distance',
        'uav2_uav1_distance',
    ]


def test_anchors_and_merges(tmp_path: Path) -> None:
    configuration = robot(
        tmp_path,
        'objects: {R: [r1]}\n'
        'features:\n'
        '  A: {of: R, from: &odom {topic: /odom, field: a, max_delay: 1 s}}\n'
        '  B: {of: R, from: {<<: *odom, field: b}}\n',
    )
    assert annotations(configuration) == [
        'stream "/odom" contains A[r1] = a with max_delay = 1 s;',
        'stream "/odom" contains B[r1] = b with max_delay = 1 s;',
    ]


def test_fields_may_name_objects(tmp_path: Path) -> None:
    configuration = robot(
        tmp_path,
        'objects: {Joint: [elbow, wrist]}\n'
        'features:\n'
        '  Position: {of: {j: Joint}, from: {topic: /joints, field: "{j}.position"}}\n',
    )
    assert annotations(configuration) == [
        'stream "/joints" contains Position[elbow] = elbow.position;',
        'stream "/joints" contains Position[wrist] = wrist.position;',
    ]


def test_formulas_and_parameters(tmp_path: Path) -> None:
    (tmp_path / 'more.txt').write_text('# a comment\n\nalways a.c < 1\n')
    configuration = robot(
        tmp_path,
        'formulas:\n'
        '  - {name: slow, formula: "always a.b < 1 ", severity: error, description: It is slow.}\n'
        '  - more.txt\n'
        '  - {name: c, formula: a.c < 1, every_state: true, margin: true}\n'
        'nodes:\n'
        '  stream_reasoning_coordinator:\n'
        '    {silence_limit: 2, timeout_limit: 1e3, names: [a, b], x: no}\n',
    )
    assert configuration.formulas == (
        RequestedFormula('always a.b < 1', 'slow', 'It is slow.', Severity.ERROR),
        RequestedFormula('always a.c < 1'),
        RequestedFormula('a.c < 1', 'c', every_state=True, margin=True),
    )
    assert configuration.parameters == {
        'stream_reasoning_coordinator': {
            'silence_limit': 2,
            'timeout_limit': 1000,
            'names': ['a', 'b'],
            'x': False,
        }
    }
    # ROS takes no whole number for another one.
    given = configuration.parameters['stream_reasoning_coordinator']
    assert {type(given[name]) for name in ('silence_limit', 'timeout_limit')} == {float}


def test_files_lie_beside_the_robot(tmp_path: Path) -> None:
    folder = tmp_path / 'config'
    folder.mkdir()
    for name in ('a.owl', 'a b.ssl', 'a.streams', 'a.bridges'):
        (folder / name).write_text('')
    configuration = robot(
        folder,
        'ontology: a.owl\nannotations: [a b.ssl]\nstreams: [a.streams]\nbridges: a.bridges\n'
        'domains: {Robot: [r1]}\nformulas: []\n',
    )
    assert configuration.ontologies == (folder / 'a.owl',)
    assert configuration.annotations == (folder / 'a b.ssl',)
    assert configuration.streams == (folder / 'a.streams',)
    assert configuration.bridges == (folder / 'a.bridges',)
    assert configuration.domains == {'Robot': ('r1',)}


@pytest.mark.parametrize('text', ['', '# nothing\n', '{}', 'objects: {}\n'])
def test_every_part_is_optional(tmp_path: Path, text: str) -> None:
    assert robot(tmp_path, text) == RobotConfiguration()


def test_the_exported_files_describe_the_same_robot(tmp_path: Path) -> None:
    text = f'{FLEET}formulas: [{{name: slow, formula: Wind < 1, severity: error, margin: true}}]\n'
    text += 'nodes: {stream_manager: {memory: m.json}}\ndomains: {Zone: [south]}\n'
    (tmp_path / 'more.ssl').write_text('stream "/x" contains Wind = x;\n')
    configuration = robot(tmp_path, f'{text}annotations: more.ssl\n')
    path = export(tmp_path / 'robot.yaml', tmp_path / 'new' / 'files')
    exported = read_robot(path)
    for kind in ('formulas', 'parameters', 'domains'):
        assert getattr(exported, kind) == getattr(configuration, kind)
    assert [each.name for each in exported.annotations if isinstance(each, Path)] == [
        'more.ssl',
        'robot.ssl',
    ]
    written = '\n'.join(each.read_text() for each in exported.annotations if isinstance(each, Path))
    assert [str(each) for each in parse_annotations(written)][1:] == [
        str(each) for text in annotations(configuration) for each in parse_annotations(text)
    ]
    with Ontology() as ontology, loaded(configuration) as inline:
        ontology.load(tmp_path / 'new' / 'files' / 'robot.owl')
        assert ontology.knowledge.features == inline.knowledge.features
    with pytest.raises(ConfigurationError, match=r'robot\.owl exists; remove it'):
        export(tmp_path / 'robot.yaml', tmp_path / 'new' / 'files')


def test_written_texts_are_named_by_absolute_paths(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    written = write_texts(robot(tmp_path, FLEET), Path())
    assert written.streams == (tmp_path / 'robot.streams',)
    assert read_formulas(tmp_path / 'robot.ssl')


def test_the_nodes_are_those_of_the_packages() -> None:
    for node, package in PACKAGES.items():
        folder = Path(__file__).parents[2] / package / package / 'ros'
        assert (folder / f'{node}.py').is_file()


def test_other_objects_than_those_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text(
        'objects: {Rover: [r1], Zone: [dock]}\n'
        "features: {Inside: {of: {r: Rover, z: Zone}, from: {topic: '/{r}/{z}', field: data}}}\n",
        encoding='utf-8',
    )
    annotations = read_robot(path, {'Rover': ['r7', 'r8']}).annotations
    assert [each.text for each in annotations if isinstance(each, InlineText)] == [
        'stream "/r7/dock" contains Inside[r7, dock] = data;',
        'stream "/r8/dock" contains Inside[r8, dock] = data;',
    ]


@pytest.mark.parametrize(('text', 'value'), [('true', True), ('false', False)])
def test_the_order_of_a_topic(text: str, value: object, tmp_path: Path) -> None:
    source = f'{{topic: /odom, field: x, max_delay: 1 s, reorder: {text}}}'
    (made,) = annotations(robot(tmp_path, f'features:\n  X: {{from: {source}}}\n'))
    (annotation,) = parse_annotations(made)
    assert annotation.constraints.reorder is value
    assert f'reorder = {text}' in str(annotation)


@pytest.mark.parametrize(
    'names', [{*CONSTRAINT_KINDS} - {'expires'}, {'max_delay', 'max_gap', 'expires'}]
)
def test_all_constraints_in_all_languages(names: set[str], tmp_path: Path) -> None:
    examples = {'DURATION': '2 s', 'TRUTH': 'true'}
    texts = {name: examples[CONSTRAINT_KINDS[name].terminal] for name in names}
    values = {name: CONSTRAINT_KINDS[name].parse(text) for name, text in texts.items()}
    stated = ', '.join(f'{name}: {text}' for name, text in texts.items())
    text = f'features: {{F: {{missing: unknown, from: {{topic: /a, field: b, {stated}}}}}}}'
    (document,) = annotations(robot(tmp_path, text))
    (annotation,) = parse_annotations(document)
    assert annotation.constraints == StreamConstraints(**values)
    assert str(parse_annotations(str(annotation))[0]) == str(annotation)
    stream = f'stream c = select b from "/a" with {annotation.constraints}'
    assert str(parse_specification(stream)) == stream


EXPIRING = 'topic: /battery, field: percentage, max_delay: 1 s, max_gap: 2 s, expires: true'


@pytest.mark.parametrize(
    'features',
    [
        f'{{Charge: {{missing: unknown, from: {{{EXPIRING}}}}}}}',
        f"{{Charge: {{unknown: 'percentage < 0', from: {{{EXPIRING}}}}}}}",
        f'{{Energy: {{missing: unknown}}, Charge: {{below: Energy, from: {{{EXPIRING}}}}}}}',
    ],
)
def test_a_value_expires(features: str, tmp_path: Path) -> None:
    (made,) = annotations(robot(tmp_path, f'features: {features}\n'))
    (annotation,) = parse_annotations(made)
    assert str(annotation.constraints) == 'max_delay = 1 s, max_gap = 2 s, expires = true'


def test_an_uncertainty_does_not_expire_with_its_value(tmp_path: Path) -> None:
    uncertainty = 'missing: unknown, uncertainty: {variance: error}'
    text = f'features: {{Charge: {{{uncertainty}, from: {{{EXPIRING}}}}}}}\n'
    assert annotations(robot(tmp_path, text))[1] == (
        'stream "/battery" contains Charge_variance = error with max_delay = 1 s;'
    )


NORMAL = "of: {r: R}, uncertainty: {variance: 'c[7]'}, from: {topic: /a, field: y}"
RELATED = 'of: {r: R}, uncertainty: {variance: v, %s}, from: {topic: /a, field: x}'


def test_covariances(tmp_path: Path) -> None:
    stated = RELATED % "time_constant: 2 s, covariances: {Y: 'c[1]', Z: -0.5}"
    features = f'  X: {{{stated}}}\n  Y: {{{NORMAL}}}\n  Z: {{{NORMAL}}}\n'
    found = robot(tmp_path, f'objects: {{R: [a]}}\nfeatures:\n{features}')
    (ontology,) = (each for each in found.ontologies if isinstance(each, InlineText))
    stated = 'normal(X, sqrt(X_variance), 2 s, covariance(Y, X_Y_covariance), covariance(Z, -0.5))'
    assert f'<dyknow:uncertainty>{stated}</dyknow:uncertainty>' in ontology.text
    assert 'stream "/a" contains X_Y_covariance[a] = c[1];' in annotations(found)


def test_samples(tmp_path: Path) -> None:
    given = 'uncertainty: {samples: poses.position.x}, from: {topic: /a, field: x}'
    assert (
        annotations(robot(tmp_path, f'features: {{X: {{{given}}}}}'))[1]
        == 'stream "/a" contains X_samples = samples(poses.position.x);'
    )


def test_a_formula_states_the_constants_that_it_names() -> None:
    constants = (('near', '0.3'), ('far', '9'), ('nearer', '0.1'))
    shown = RequestedFormula('always x > near -> y < far', constants=constants).closed_text
    assert shown == 'let near = 0.3, far = 9 in always x > near -> y < far'
    assert RequestedFormula('always x > 1', constants=constants).closed_text == 'always x > 1'


def test_guards(tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text(
        'constants: {near: 0.3 m}\n'
        'formulas:\n'
        '  - {name: distance, formula: \'always "/scan".min_range > 0.3\'}\n'
        'guards:\n'
        '  - name: base_guard\n'
        '    input: /cmd_vel_in\n'
        '    output: /cmd_vel\n'
        '    formulas: [distance, \'"/cmd_vel_in".linear.x < 0.5\']\n'
        '  - {name: arm, input: a, output: b, formulas: p = 1, safe: nothing, latch: true,\n'
        '     timeout: 1 s, period: 20 ms, type: std_msgs/msg/String}\n'
        '  - {name: light, input: c, output: d, formulas: distance, safe: {data: {x: [1, 2]}}}\n'
    )
    base, arm, light = read_robot(path).guards
    assert (base.message_type, base.safe, base.latch) == ('', {}, False)
    assert (base.period, base.timeout) == (100_000_000, 300_000_000)
    distance, limit = base.formulas
    assert (distance.name, limit.name) == ('distance', '"/cmd_vel_in".linear.x < 0.5')
    assert [each.reads(base.input) for each in base.formulas] == [False, True]
    assert base.place == f'{path}:5:5'
    assert (arm.safe, arm.latch, arm.period, arm.timeout) == (None, True, 20_000_000, 10**9)
    assert arm.formulas[0].closed_text == 'p = 1'
    assert light.safe == {'data': {'x': [1, 2]}}


def test_guards_in_a_row(tmp_path: Path) -> None:
    guards = (
        f'{{name: {i}_{o}, input: {i}, output: {o}, formulas: p > 0}}' for i, o in ('ab', 'bc')
    )
    found = robot(tmp_path, f'guards: [{", ".join(guards)}]').guards
    assert [(each.input, each.output) for each in found] == [('a', 'b'), ('b', 'c')]


def test_all_that_is_no_ontology_annotation_or_stream_is_exported(tmp_path: Path) -> None:
    (tmp_path / 'more.yaml').write_text(
        '- {name: more, formula: a.b < 1, on: {true: {run: [a]}}}\n'
    )
    (tmp_path / 'zenoh.json5').write_text('{}')
    path = tmp_path / 'robot.yaml'
    path.write_text(
        'constants: {limit: 1.5 m/s}\n'
        'features: {Speed: {unit: m/s, from: {topic: /odom, field: x}}}\n'
        'formulas: [{name: slow, formula: Speed < limit, record: true}, more.yaml]\n'
        'guards: [{name: g, input: /a, output: b, formulas: [slow, \'"/a".x < 1\'], latch: true}]\n'
        'federation: {name: a, share: Speed, zenoh: zenoh.json5}\n'
        'topics: {/a: {type: a/msg/B, min_rate: 9.5 Hz, max_gap: 1500 ms, stamped: true}, /b: }\n'
    )
    given, found = read_robot(path), read_robot(export(path, tmp_path / 'new' / 'files'))
    assert found.formulas == given.formulas
    assert found.formulas[0].closed_text == 'let limit = 1.5 "m/s" in Speed < limit'
    guards, topics = (
        [replace(each, place='') for each in kind] for kind in (found.guards, found.topics)
    )
    assert guards == [replace(each, place='') for each in given.guards]
    assert topics == [replace(each, place='') for each in given.topics]
    assert found.federation is not None
    assert given.federation is not None
    assert found.federation.zenoh is not None
    assert found.federation.zenoh.samefile(tmp_path / 'zenoh.json5')
    assert replace(found.federation, zenoh=given.federation.zenoh) == given.federation


def test_the_parameters_of_nodes_are_those_of_the_reference() -> None:
    reference = Path(__file__).parents[2] / 'docs' / 'reference' / 'nodes.md'
    row = re.compile(r'^\| `(\w+)` \| (.*) \| (?:yes|no) \| (.*) \|$', re.MULTILINE)
    found: dict[str, dict[str, ParameterKind]] = {}
    for section in reference.read_text(encoding='utf-8').split('\n## ')[1:]:
        rows = row.findall(section)
        found[section.partition('\n')[0]] = {name: kind(*rest) for name, *rest in rows}
    assert {**found['Every node'], 'use_sim_time': bool} == COMMON
    assert {name: found[name] for name in PARAMETERS} == PARAMETERS
    assert PARAMETERS.keys() == {*PACKAGES, 'black_box_recorder'}


def kind(default: str, description: str) -> ParameterKind:
    """Return the kind of a parameter by its row in the reference."""
    text = default.strip('`')
    if bounds := re.search(r'\(([0-9.e+-]+) to ([0-9.e+-]+)\)$', description):
        numbers = tuple(map(float, bounds.groups()))
        return numbers if '.' in text else tuple(map(int, numbers))
    return {'true': bool, 'false': bool, '[]': list}.get(text, str)


MAP = """\
objects: {Robot: [r1], Boat: [b1]}
regions:
  cell: {is: Storm, frame: odom, topic: /cell, max_gap: 5 s}
  cloud: {is: Storm, frame: map, topic: /cloud, header: false, field: points}
  dock: {is: Dock, frame: map, circle: {center: [0, 0], radius: 1}}
positions:
  - {of: {r: Robot}, frame: map, tf: '{r}/base', max_delay: 1 s}
  - {of: {b: Boat}, frame: odom, topic: '/{b}/odom', field: pose.pose.position}
"""


def test_the_map_has_the_streams_of_its_frame(tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text(MAP)
    found = read_robot(path).map
    assert (found.frame, [each.name for each in found.regions]) == ('map', ['dock'])
    assert found.streams == {
        'r1': 'stream position = select translation.x as x, translation.y as y'
        ' from tf("map", "r1/base")',
        'cloud': 'stream outline = select wkt(points) as outline from "/cloud"',
    }
    path.write_text('\n'.join(each for each in MAP.splitlines() if 'dock' not in each))
    found = read_robot(path).map
    assert (found.frame, found.regions, [*found.streams]) == ('odom', (), ['b1', 'cell'])
    assert found.outlines['cell'] == (
        'stream outline = select header.frame_id as frame, wkt(polygon.points) as outline'
        ' from "/cell" where header.frame_id = "odom"'
    )
    path.write_text('objects: {Robot: [r1]}\n')
    assert read_robot(path).map == NO_MAP
