"""The verb `lint`: all findings of files, each at its place, with the correction."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

import dyknow_command
from dyknow_command.linting.findings import FilePlace
from dyknow_command.linting.inputs import syntax_findings
from dyknow_common import TextPosition, ValueType
from dyknow_configuration import ObservedTopic, TopicTimes
from dyknow_semantics import parse_annotations

LINTED = Path(__file__).parent / 'linted'
ROOT = Path(__file__).parent.parent.parent
ROVER = ROOT / 'docs' / 'examples'

STORE = get_typestore(Stores.ROS2_JAZZY)
ARRAY = 'diagnostic_msgs/msg/DiagnosticArray'
POINT = 'geometry_msgs/msg/PointStamped'

ROBOTS = (
    'domains',
    'element_keys',
    'guards',
    'list',
    'misspelt_nodes',
    'misspelt_ros_parameters',
    'named_in_faulty',
    'notes',
    'other_file',
    'parameters',
    'positions',
    'relations',
    'robot',
    'streams_of_objects',
    'topics',
    'uncertainties',
    'units',
)
"""Files with findings, each beside the expected output."""
RECORDED = ('expected_topics', 'recording')
"""The same of files that are compared with the recording `NOMINAL`, as seen from their folder."""
NOMINAL = '../../../dyknow_bringup/recordings/nominal'

LIMIT_S = 30
"""Seconds of the processor: far more than each takes, and less than one without a limit would."""


def lint(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    code = dyknow_command.main(['lint', *map(str, arguments)])
    return code, capsys.readouterr().out


@pytest.mark.parametrize(
    ('name', 'arguments'),
    [
        *((name, [f'{name}.yaml']) for name in ROBOTS),
        *((name, [f'{name}.yaml', '--recording', NOMINAL]) for name in RECORDED),
        ('elements', ['elements.yaml', '--recording', '../../../examples/rover/recordings/clean']),
        ('broken_annotations', ['broken.ssl']),
        ('unfitting_annotations', ['unfitting.ssl', ROVER / 'rover.owl']),
        ('unfitting_bridges', ['unfitting.bridges', ROVER / 'rover.owl']),
        ('broken_streams', ['broken.streams']),
        ('formulas', ['formulas.txt']),
    ],
)
def test_findings(
    name: str,
    arguments: list[str | Path],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(LINTED)
    code, shown = lint(capsys, *arguments)
    assert code == 1
    assert shown == (LINTED / f'{name}.expected').read_text(encoding='utf-8')


@pytest.mark.parametrize('name', ['triggers', 'guard_messages'])
def test_messages(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip('rclpy')
    test_findings(name, [f'{name}.yaml'], capsys, monkeypatch)


def test_triggers_that_no_formula_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are checked, too: also without ROS, that they never run."""
    path = tmp_path / 'robot.yaml'
    text = (
        'triggers:\n'
        '  beep: {run: ["true"]}\n'
        '  alarm: {publish: {topic: /a, type: std_msgs/msg/Bool, message: {dat: true}}}\n'
        'formulas: [{name: near, formula: \'always "/scan".range_min > 0.3\', on: {false: NAME}}]\n'
    )
    unnamed = f"{path}:3:10: warning: trigger 'alarm': no formula names it, so it never runs"
    path.write_text(text.replace('NAME', 'beep'), encoding='utf-8')
    monkeypatch.setitem(sys.modules, 'dyknow_reactions.ros.triggers', None)
    code, shown = lint(capsys, path)
    assert (code, shown.count(unnamed), shown.count(': trigger ')) == (1, 1, 1), shown
    # A formula at fault may name it.
    path.write_text(text.replace('NAME', 'alarn'), encoding='utf-8')
    assert 'no formula names it' not in lint(capsys, path)[1]
    pytest.importorskip('rclpy')
    monkeypatch.delitem(sys.modules, 'dyknow_reactions.ros.triggers')
    path.write_text(text.replace('NAME', 'beep'), encoding='utf-8')
    code, shown = lint(capsys, path)
    assert (code, unnamed in shown, shown.count(': trigger ')) == (1, True, 2), shown
    assert "error: trigger 'alarm': std_msgs/msg/Bool has no field 'dat'" in shown


SHARED = """\
features:
  Level: {type: int, from: {topic: /diagnostics, field: 'status[name = "gps"].level', CONSTRAINT}}
streams: |
  stream gps = select status[name = "gps"].level as level from "/diagnostics" with max_gap = 1 s;
  sink gps;
formulas:
  - {name: level, formula: 'always Level + gps.level < 2'}
  - {name: log, formula: 'always "/rosout".msg does not contain "failsafe"'}
"""


@pytest.mark.parametrize('constraint', ['max_gap: 1 s', 'sample_period: 1 s'])
@pytest.mark.parametrize('publishers', [1, 3])
def test_several_may_publish_elements_and_logs(
    constraint: str,
    publishers: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The timing of the topic is that of the element if one alone publishes."""
    times = TopicTimes.of(None, np.array([0, 500_000_000, 1_000_000_000], np.int64), 10**9)
    types = {'stamp.sec': ValueType.INT, 'msg': ValueType.STRING}
    fields = {'status[0..].level': ValueType.INT, 'status[0..].name': ValueType.STRING}
    observed = (
        ObservedTopic('/diagnostics', ARRAY, fields, times, {}, publishers),
        ObservedTopic('/rosout', 'rcl_interfaces/msg/Log', types, times, {}, publishers),
    )
    monkeypatch.setattr('dyknow_command.lint.observe', lambda *_, **__: observed)
    path = tmp_path / 'robot.yaml'
    path.write_text(SHARED.replace('CONSTRAINT', constraint), encoding='utf-8')
    code, shown = lint(capsys, path, '--live')
    is_broken = publishers == 1 and constraint.startswith('sample_period')
    assert (code, 'sample_period' in shown, 'publishers' in shown) == (is_broken, is_broken, False)


STATION = """\
formulas: [{name: charged, formula: 'forall c in Carrier: always Charge[c] > 0.2'}]
"""


def test_objects_may_come_from_peers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / 'station.yaml'
    path.write_text(STATION, encoding='utf-8')
    code, shown = lint(capsys, path)
    assert (code, 'objects: {Carrier: [object1, object2]} in robot.yaml' in shown) == (1, True)
    for text in (STATION, STATION.replace('> 0.2', '> 20 %')):
        path.write_text(f'{text}federation: {{name: station}}\n', encoding='utf-8')
        assert lint(capsys, path) == (0, f'{path}: 1 formula, nothing to mend\n')
    # What this host declares is known.
    features = 'features: {Range: {unit: m, from: {topic: /range, field: range}}}\n'
    wrong = STATION.replace('Charge[c] > 0.2', 'Range > 2 kg')
    path.write_text(f'{features}{wrong}federation: {{name: station}}\n', encoding='utf-8')
    code, shown = lint(capsys, path)
    assert (code, 'Range' in shown) == (1, True), shown


@pytest.mark.parametrize(
    ('changed', 'finding'),
    [
        ('Speed', None),
        ('Charge', None),
        ('Sped', "4:75: warning: unknown concept 'Sped'; did you mean 'Speed'? If a peer shares "),
        ('share: Spee', "5:36: error: unknown concept 'Spee'; did you mean 'Speed'?"),
        ('share: {feature: Spee}', "5:46: error: unknown concept 'Spee'"),
        ('same: [r1, r2]', "5:40: error: unknown instance 'r2'"),
    ],
)
def test_names_that_only_this_host_can_have(
    changed: str, finding: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'robot.yaml'
    feature, federation = (changed, '') if ':' not in changed else ('Speed', f', {changed}')
    path.write_text(
        'objects: {Rover: [r1]}\nfeatures:\n'
        "  Speed: {of: {r: Rover}, unit: m/s, from: {topic: '/{r}/odom', field: x}}\n"
        "formulas: [{name: a, formula: 'forall r in Rover: always Speed[r] < 9 and "
        f"{feature}[r] > 0'}}]\n"
        f'federation: {{name: station{federation}}}\n'
    )
    code, shown = lint(capsys, path)
    assert (code, f'{path}:{finding}' in shown) == ((0, False) if finding is None else (1, True)), (
        shown
    )


OBJECTS = ', '.join(f'r{number}' for number in range(50_100))
WORDS = 'a > 1 and ' * 50_100


@pytest.mark.parametrize('verb', ['lint', 'up', 'monitor'])
@pytest.mark.parametrize(
    ('content', 'reason'),
    [
        (None, 'cannot read the configuration in robot.yaml: it is no regular file'),
        (Path('/dev/zero'), 'cannot read the configuration in robot.yaml: it is no regular file'),
        (Path('/'), 'cannot read the configuration in robot.yaml: Is a directory'),
        ('#' * 2**25, 'cannot read the configuration in robot.yaml: it has more than 16,777,216 '),
    ],
    ids=['pipe', 'device', 'folder', 'large'],
)
def test_hostile_files(
    verb: str,
    content: Path | str | None,
    reason: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if verb != 'lint':
        pytest.importorskip('rclpy')
    monkeypatch.chdir(tmp_path)
    if content is None:
        os.mkfifo('robot.yaml')
    elif isinstance(content, Path):
        Path('robot.yaml').symlink_to(content)
    else:
        Path('robot.yaml').write_text(content, encoding='utf-8')
    begin = time.process_time()
    assert dyknow_command.main([verb, 'robot.yaml']) in {1, 2}
    assert time.process_time() - begin < LIMIT_S
    printed = capsys.readouterr()
    assert reason in printed.out + printed.err


# `monitor` reads a file as `up` does.
@pytest.mark.parametrize('verb', ['lint', 'up'])
@pytest.mark.parametrize(
    ('content', 'reason'),
    [
        (f'objects: {{R: [{OBJECTS}]}}', 'robot.yaml:1:388865: more than 50000 values; split it'),
        (f'formulas: [{{name: a, formula: {WORDS}}}]', 'has more than 200000 words and symbols'),
    ],
    ids=['objects', 'words'],
)
def test_files_with_too_much(
    verb: str,
    content: str,
    reason: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    test_hostile_files(verb, content, reason, tmp_path, capsys, monkeypatch)


@pytest.mark.parametrize('name', ['a.owl', 'a.ssl', 'a.streams', 'a.bridges', 'a.txt'])
def test_named_pipes(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(tmp_path / name)
    assert dyknow_command.main(['lint', str(tmp_path / name)]) == 2
    assert capsys.readouterr().err.endswith(f'in {tmp_path / name}: it is no regular file\n')


@pytest.mark.parametrize(
    ('files', 'checked'),
    [
        ([ROVER / 'rover.yaml'], '2 formulas, 2 topics, '),
        ([ROVER / 'rover.owl', ROVER / 'rover.ssl', ROVER / 'rover.streams'], '2 topics, '),
        ([ROVER / 'rover.ssl'], '1 topic, '),
    ],
)
def test_correct_files(files: list[Path], checked: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, shown = lint(capsys, *files)
    assert (code, shown) == (0, f'{", ".join(map(str, files))}: {checked}nothing to mend\n')


def test_statements_of_ontologies_in_vain(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ontology = tmp_path / 'rover.owl'
    text = (
        (ROVER / 'rover.owl').read_text(encoding='utf-8').replace('dyknow:unit>', 'dyknow:units>')
    )
    ontology.write_text(text, encoding='utf-8')
    code, shown = lint(capsys, ontology)
    assert code == 1
    assert f"{ontology}: warning: DyKnow's ontology has no term 'units'; did you mean" in shown


@pytest.mark.parametrize('number', [1, 2])
def test_a_later_ontology_may_define_what_an_earlier_one_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], number: int
) -> None:
    begin = (
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" '
        'xmlns:rdfs="http://www.w3.org/2000/01/rdf-schema#" '
        'xmlns:owl="http://www.w3.org/2002/07/owl#">'
    )
    drone, quadcopter = (f'http://www.dyknow.org/ontology#{each}' for each in ('Drone', 'Quad'))
    parent = f'<rdfs:subClassOf rdf:resource="{drone}"/>'
    paths = tmp_path / 'quad.owl', tmp_path / 'drone.owl'
    for path, content in zip(
        paths,
        (
            f'<owl:Class rdf:about="{quadcopter}">{parent}</owl:Class>',
            f'<owl:Class rdf:about="{drone}"/>',
        ),
        strict=True,
    ):
        head = f'<owl:Ontology rdf:about="http://robots.org/{path.stem}"/>'
        path.write_text(f'{begin}{head}{content}</rdf:RDF>', encoding='utf-8')
    code, shown = lint(capsys, *paths[:number])
    assert ("no term 'Drone'" in shown) == (code == 1) == (number == 1), shown


def test_json(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(LINTED)
    code, shown = lint(capsys, 'formulas.txt', '--json')
    first = json.loads(shown.splitlines()[0])
    assert code == 1
    assert (first['file'], first['line'], first['column']) == ('formulas.txt', 3, 9)
    assert first['level'] == 'error'


@pytest.mark.parametrize('name', ['missing.yaml', 'missing.ssl', 'missing.owl', 'missing.txt'])
def test_a_missing_file(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert dyknow_command.main(['lint', name]) == 2
    assert f'in {name}: No such file' in capsys.readouterr().err


def record_points(recording: Path, frames: Mapping[str, Sequence[str]]) -> None:
    """Write a recording of topics with a point each second, each in a frame."""
    types = STORE.types
    with Writer(recording, version=9) as writer:
        for topic, its_frames in frames.items():
            connection = writer.add_connection(topic, POINT, typestore=STORE)
            for time_s, frame in enumerate(its_frames, 1):
                stamp = types['builtin_interfaces/msg/Time'](time_s, 0)
                point = types['geometry_msgs/msg/Point'](1.0, 2.0, 3.0)
                message = types[POINT](types['std_msgs/msg/Header'](stamp, frame), point)
                writer.write(connection, time_s * 10**9, STORE.serialize_cdr(message, POINT))


@pytest.mark.parametrize(('frame', 'places'), [('map', []), ('b/odom', ['9:46', '11:22', '13:3'])])
def test_positions_in_several_frames(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], frame: str, places: list[str]
) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text(
        """\
objects: {Uav: [a, b]}
features:
  X: {of: {u: Uav}, from: {topic: '/{u}/position', field: point.x}}
  Gap: {from: {stream: gap, field: x}}
formulas:
  - name: a
    formula: 'forall u in Uav: always X[u] < 9'
  - name: b
    formula: 'forall u, v in Uav: always abs(X[u] - X[v]) < 9'
  - name: c
    formula: 'always "/a/position".point.x < "/b/position".point.x'
streams: |
  stream gap = merge(
    select point.x as x from "/a/position", select point.x as x from "/b/position");
  sink gap;
"""
    )
    recording = tmp_path / 'recording'
    record_points(recording, {'/a/position': ['map'] * 3, '/b/position': [frame] * 3})
    _, shown = lint(capsys, path, '--recording', recording)
    found = [line for line in shown.splitlines() if 'several frames' in line]
    assert [line.removeprefix(f'{path}:').partition(': ')[0] for line in found] == places
    assert all('/a/position is in map; /b/position is in b/odom' in line for line in found)


def test_a_topic_in_another_frame_than_is_stated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Positions without a header are not compared."""
    path, recording = tmp_path / 'robot.yaml', tmp_path / 'bag'
    path.write_text(
        """\
objects: {Robot: [r1], Boat: [b1]}
regions: {dock: {is: Dock, frame: map, circle: {center: [0, 0], radius: 1}}}
positions:
  - {of: {r: Robot}, frame: map, topic: '/{r}/pose', field: point}
  - {of: {b: Boat}, frame: map, topic: '/{b}/pose', field: point, header: false}
formulas: [{name: out, formula: 'forall r in Robot, d in Dock: always not inside(r, d)'}]
"""
    )
    frames = ['map', 'odom']
    record_points(recording, {'/r1/pose': frames, '/b1/pose': frames})
    code, shown = lint(capsys, path, '--recording', recording)
    assert code == 1
    text = '/r1/pose is in odom, but its frame is stated as map; correct it, or let tf transform'
    assert f'{path}:4:5: error: {text} the positions' in shown
    assert '/b1/pose is in odom' not in shown


def test_an_open_text_ends_the_statements() -> None:
    """The text after an unclosed quotation mark is one statement."""
    text = 'stream a contains = x; stream "b; c; d;'
    found = list(syntax_findings(parse_annotations, text, FilePlace('f', text, TextPosition(1, 1))))
    assert [each.place.position for each in found] == [TextPosition(1, 19), TextPosition(1, 31)]


@pytest.mark.parametrize('expires', [True, False])
def test_a_gap_after_which_a_value_expires_is_no_fault(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], *, expires: bool
) -> None:
    robot = tmp_path / 'robot.yaml'
    source = f'max_delay: 1 s, max_gap: 100 ms, expires: {str(expires).lower()}'
    robot.write_text(
        'features: {Voltage: {missing: unknown, '
        f'from: {{topic: /uav1/battery, field: voltage, {source}}}}}}}\n'
        "formulas: [{name: charged, formula: 'always Voltage > 3'}]\n"
    )
    recording = ROOT / 'dyknow_bringup' / 'recordings' / 'nominal'
    _, shown = lint(capsys, robot, '--recording', recording)
    assert ('intervals break max_gap = 100 ms' in shown) is not expires


def test_texts_that_lack_quotes_get_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Comments, other values and a value with both kinds of quotes stay as they are."""
    path = tmp_path / 'robot.yaml'
    text = (ROVER / 'rover.yaml').read_text(encoding='utf-8')
    formula = 'forall r in Rover: always Speed[r] < 1.5'
    before = text.replace(f"'{formula}'", f'{formula}  # too fast')
    assert before != text
    path.write_text(before, encoding='utf-8')
    assert lint(capsys, path)[0] == 2
    code, shown = lint(capsys, '--fix', path)
    assert (code, shown) == (0, f'{path}: 2 formulas, 2 topics, nothing to mend\n')
    assert path.read_text(encoding='utf-8') == before.replace(formula, f'"{formula}"')
    both = """formulas: [{name: a, formula: b}]\ndescription: it's "a: b": c\n"""
    path.write_text(both)
    assert lint(capsys, '--fix', path)[0] == 2
    assert path.read_text() == both


@pytest.mark.parametrize(
    ('robot', 'warned'),
    [
        ('', "no stream 'powr' is known; did you mean 'power'?"),
        # A peer may have the stream.
        ('federation: {name: r1}', ''),
    ],
)
def test_a_stream_that_is_not_known(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, robot: str, warned: str
) -> None:
    path, formulas = tmp_path / 'robot.yaml', tmp_path / 'formulas.txt'
    streams = 'streams: \'stream power = select x from "/p"; sink power\''
    path.write_text(f'{streams}\n{robot}\nformulas: [{{name: a, formula: powr.x < power.x}}]\n')
    formulas.write_text('always powr.x < 1\n')
    assert 'powr' not in lint(capsys, formulas)[1]
    shown = lint(capsys, path)[1]
    assert warned in shown
    assert warned or 'powr' not in shown, shown
