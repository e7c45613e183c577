"""The JSON Schema for editors knows the keys of the reader, and accepts what the reader accepts.

What it refuses, the reader refuses, too, at its place.
"""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Iterator
from datetime import date
from math import inf, nan
from pathlib import Path
from typing import Any, Final

import pytest
import yaml
from jsonschema import Draft202012Validator

from dyknow_common import CONSTRAINT_KINDS, NOWHERE, ValueType
from dyknow_configuration import PACKAGES, ConfigurationError, Severity, reading
from dyknow_configuration.expectations import EXPECTATION_KEYS
from dyknow_configuration.federation import FEDERATION_KEYS, SHARE_KEYS
from dyknow_configuration.forecasts import FORECAST_KEYS
from dyknow_configuration.formulas import FORMULA_KEYS
from dyknow_configuration.guards import GUARD_KEYS
from dyknow_configuration.reading import TEMPLATE_KEYS, robot_of
from dyknow_configuration.regions import POSITION_KEYS, REGION_KEYS
from dyknow_configuration.topics import SOURCE_KEYS
from dyknow_configuration.triggers import ACTION_KEYS, TRIGGER_KEYS, TriggerEvent
from dyknow_configuration.vocabulary import FEATURE_KEYS, SORT_KEYS
from dyknow_configuration.yaml_values import YamlValue, parse_yaml

ROOT = Path(__file__).parents[2]
SCHEMA = json.loads((ROOT / 'docs' / 'robot.schema.json').read_text(encoding='utf-8'))
DEFINITIONS = SCHEMA['$defs']
BAD = Path(__file__).parent / 'bad_robots'
VALIDATOR = Draft202012Validator(SCHEMA)

WRONG = (
    'bad_object_name', 'bare_duration', 'bare_gap', 'rate_without_unit', 'relative_topic',
    'stamped_text', 'type_without_package', 'unknown_expectation_key',
    'boolean_for_object', 'endpoint_without_protocol', 'federation_without_name',
    'formula_without_name', 'share_unknown_key',
    'guard_without_input', 'list_for_message', 'no_action', 'no_field', 'no_list_of_objects',
    'no_mapping', 'no_type_of_message', 'number_for_object', 'number_in_command',
    'nothing_in_message', 'parameter_of_no_type', 'record_of_number', 'record_unknown_key',
    'record_without_unit', 'topic_and_stream', 'two_actions', 'unknown_action',
    'unknown_feature_key', 'unknown_guard_key', 'unknown_key', 'unknown_node', 'unknown_severity',
    'unknown_source_key', 'unknown_type', 'unknown_unit_of_time',
)  # fmt: skip
"""The faults that a schema can know."""

ACCEPTED = """\
objects: {A: [a1], B: }
sorts:
formulas:
  - {name: a, formula: 'always x.y = 1', severity: error, margin: true, on: {false: [t], true: t}}
  - name: b
    formula: x.y = 1
    on: {violation: {run: [a, b]}, clear: [{cancel_goal: /a}, {cancel_goal: {action: /a}}]}
  - {name: c, formula: x.y = 1, record: true}
  - {name: d, formula: x.y = 1, record: {topics: [/a], before: 5 s, after: 0 s}}
  - more.yaml
features:
  Empty:
  F: {of: [A, B], type: boolean, from: [{topic: /a, field: b, max_lead: 1.5min, where: {A: c}}]}
triggers: {t: {publish: {topic: /a, type: a/msg/B, message: {on: [1]}}, retries: 2, timeout: 1 s}}
streams: [a.streams, {for: {a: A}, text: sink a}]
nodes: {stream_manager: {a: 1, b: [c], d: true, e: 1.5, f: g}, ontology_manager: }
ontology: a.owl
annotations: [a.ssl, b.ssl]
domains: {A: a1}
regions:
  r: {is: Z, frame: map, circle: {center: [1, 2.5], radius: 3}, altitude: [0, 1.5], since: '2026'}
  s: {is: [Z, Y], frame: map, buffer: {of: r, by: -1.5}}
positions:
  - {of: {a: A}, frame: map, topic: /a, field: b, max_delay: 1 s, moves: straight, orientation: c}
  - {of: {c: C}, frame: map, tf: '{c}', yaw: yaw, walls: Z}
  - {of: {b: B}, frame: wgs84, topic: /a, axes: [lon, lat, alt]}
topics: {/a: , /b: {type: a/msg/B, min_rate: 1 Hz, max_rate: 1.5Hz, max_gap: 1 s, stamped: true}}
federation:
  name: a
  connect: tcp/b:7447
  listen: ['tcp/[::]:7447', quic/c:1]
  share: [F, {feature: G, every: 1 s, deadband: 0.5}]
  same: a1
  compared: {F: 1, G: [-1.5, 2]}
  history: 90 s
  max_uncertainty: 1 ms
  zenoh: a.json5
guards:
  - {name: g, input: /a, output: b, formulas: a, safe: {x: 1}, period: 1 s, type: a_msgs/msg/B}
  - {name: h, input: c, output: /d, formulas: [a, p = 1], safe: nothing, latch: true, timeout: 1 s}
"""


def loaded(text: str) -> Any:
    """Return a document as editors read it, in YAML 1.2: `on` is no boolean there."""
    resolvers = {
        first: [(tag, pattern) for tag, pattern in each if not tag.endswith(':bool')]
        for first, each in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }
    loader = type('Loader', (yaml.SafeLoader,), {'yaml_implicit_resolvers': resolvers})
    loader.add_implicit_resolver('tag:yaml.org,2002:bool', re.compile('^(true|false)$'), ['t', 'f'])
    return with_text_keys(yaml.load(text, loader))  # noqa: S506 - it is a safe one


def with_text_keys(value: Any) -> Any:
    if isinstance(value, list):
        return [with_text_keys(each) for each in value]
    if not isinstance(value, dict):
        return value
    names = {True: 'true', False: 'false'}
    return {
        names[key] if isinstance(key, bool) else key: with_text_keys(each)
        for key, each in value.items()
    }


def test_the_keys_are_those_of_the_reader() -> None:
    properties = {name: {*each.get('properties', ())} for name, each in DEFINITIONS.items()}
    assert {*SCHEMA['properties']} == {*reading.KEYS}
    assert properties['sort'] == {*SORT_KEYS}
    assert properties['feature'] == {*FEATURE_KEYS}
    assert properties['forecast'] == {*FORECAST_KEYS}
    assert properties['constraints'] == {*CONSTRAINT_KINDS}
    assert properties['source'] == {*SOURCE_KEYS} >= {*CONSTRAINT_KINDS}
    assert properties['formula'] == {*FORMULA_KEYS}
    assert properties['federation'] == {*FEDERATION_KEYS}
    assert properties['share'] == {*SHARE_KEYS}
    assert properties['guard'] == {*GUARD_KEYS}
    assert properties['region'] == {*REGION_KEYS}
    assert properties['position'] == {*POSITION_KEYS} >= {*CONSTRAINT_KINDS} - {'expires'}
    assert properties['expectation'] == {*EXPECTATION_KEYS}
    assert properties['trigger'] == {*TRIGGER_KEYS}
    assert {*DEFINITIONS['formula']['properties']['on']['properties']} == {*TriggerEvent}
    for kind, keys in ACTION_KEYS.items():
        action = DEFINITIONS['trigger']['properties'][kind]
        assert {*(action if 'properties' in action else action['oneOf'][1])['properties']} == {
            *keys
        }
    template = next(each for each in DEFINITIONS['stream']['oneOf'] if 'properties' in each)
    assert {*template['properties']} == {*TEMPLATE_KEYS}
    assert {*SCHEMA['properties']['nodes']['properties']} == {*PACKAGES, 'black_box_recorder'}
    assert DEFINITIONS['feature']['properties']['type']['enum'] == [*ValueType]
    assert DEFINITIONS['formula']['properties']['severity']['enum'] == [*Severity]


def test_examples_are_valid() -> None:
    rover = (ROOT / 'docs' / 'examples' / 'rover.yaml').read_text(encoding='utf-8')
    for text in (rover, ACCEPTED, ''):
        VALIDATOR.validate(loaded(text))


@pytest.mark.parametrize('name', WRONG)
def test_wrong_ones_are_not(name: str) -> None:
    text = (BAD / f'{name}.yaml').read_text(encoding='utf-8')
    assert not VALIDATOR.is_valid(yaml.safe_load(text))


WRONG_VALUES: Final = (
    5, -5, 1.5, nan, inf, True, 'three', '5', '-5 s', '99999999999 h', '', ' ', [], ['three'], [5],
    {}, {'x': 1}, date(2026, 1, 1), 'a\x07', None,
)  # fmt: skip
"""Values of all kinds; each key has some of them that are wrong."""

ROVERS: Final = 'objects: {Rover: [r1]}\n'
TIMING: Final = """
max_delay: 1 s, max_gap: 1 s, max_lead: 1 s, start_time: 0 s, end_time: 9000000 s,
sample_period: 100 ms, sample_period_deviation: 10 ms, reorder: true"""

DOCUMENTS: Final = (
    f"""
sorts: {{Machine: {{description: d}}, Rover: {{below: Machine}}}}
objects: {{Rover: [r1, r2]}}
features:
  Speed:
    description: d
    of: {{r: Rover}}
    type: float
    unit: m/s
    missing: unknown
    range: [0, 10]
    unknown: a < 0
    from:
    - {{topic: '/{{r}}/odom', field: x, unit: km/h, {TIMING}}}
    - {{topic: /fleet, field: x, where: {{r: id}}, max_gap: 1 s, max_delay: 1 s, expires: true}}
    - {{stream: s, field: x, only: {{r: r1}}}}
  Fast: {{below: Speed}}
""",
    f"""
{ROVERS}
features:
  A:
    of: Rover
    uncertainty: {{deviation: 0.2, time_constant: 2 s}}
    from: {{topic: /t, field: x}}
  B:
    of: [Rover]
    uncertainty: {{variance: y, covariances: {{A: 0.1}}}}
    from: {{topic: /t, field: x}}
  C: {{uncertainty: {{interval: 0.2}}, from: {{topic: /t, field: x}}}}
  D: {{uncertainty: {{samples: y}}, from: {{topic: /t, field: x}}}}
streams:
- 'compunit mean: float mean((x: float))'
- {{for: {{r: Rover}}, text: 'stream s_{{r}} = mean("/{{r}}/odom"); sink s_{{r}}'}}
""",
    f"""
{ROVERS}
features:
  E:
    of: Rover
    from: {{topic: /t, field: x}}
    forecast:
      by: planned_path
      fields: {{speed: v}}
      path: {{topic: /plan, {TIMING}}}
      horizons: [1 s, 5 s]
      step: 500 ms
      settings: {{acceleration: 1.5}}
      table: table.yaml
""",
    f"""
{ROVERS}
regions:
  tower:
    is: NoFly
    frame: map
    circle: {{center: [10, 4], radius: 3}}
    altitude: [0, 2.5]
    since: '2026-01-01T00:00:00Z'
    until: '2026-02-01T00:00:00Z'
  near: {{is: [NoFly], frame: map, buffer: {{of: tower, by: 1.5}}}}
  hall: {{is: NoFly, frame: map, wkt: 'POLYGON ((0 0, 4 0, 4 3, 0 0))'}}
  storm: {{is: Storm, frame: map, topic: /s, field: p, header: false, {TIMING}}}
relations: [near EQ near]
positions:
- of: {{r: Rover}}
  frame: map
  topic: '/{{r}}/odom'
  field: pose
  axes: [x, y, z]
  header: true
  moves: straight
  orientation: q
  walls: NoFly
  max_delay: 1 s
""",
    """
constants: {limit: 1.5}
triggers:
  report: {publish: {topic: /f, type: a/msg/B, message: {a: 1}}, retries: 3, min_interval: 1 s}
  call: {call: {service: /a, type: a/srv/B, request: {a: true}}, timeout: 5 s}
  goal: {send_goal: {action: /a, type: a/action/B, goal: {a: 3}}}
  cancel: {cancel_goal: {action: /a}}
  beep: {run: [echo, '{name}']}
formulas:
- name: slow
  formula: 'x.y < limit'
  description: d
  severity: error
  every_state: true
  margin: true
  record: {topics: [/camera], before: 20 s, after: 5 s}
  on: {false: [report, {run: [echo]}], true: report, violation: call, clear: beep}
- more.yaml
- lines.txt
guards:
- name: g
  input: /a
  output: /b
  type: a/msg/B
  formulas: [slow, '"/a".x < 0.5']
  safe: {a: {b: 0.1}}
  period: 100 ms
  latch: true
  timeout: 300 ms
""",
    """
topics:
  /scan:
    type: a/msg/B
    min_rate: 9.5 Hz
    max_rate: 20 Hz
    max_gap: 500 ms
    max_delay: 200 ms
    max_lead: 100 ms
    stamped: true
federation:
  name: c1
  connect: [tcp/b:7447]
  listen: tcp/0.0.0.0:7447
  share: [Speed, {feature: Charge, every: 1 s, deadband: 0.01}]
  same: [dock]
  compared: {Speed: [0, 1.5]}
  peer_timeout: 10 s
  history: 60 s
  max_uncertainty: 100 ms
  zenoh: lines.txt
nodes:
  stream_manager: {max_streams: 100, naming_convention: a, discovery_period: 1.0}
  ontology_manager: {allow_download: true, ontology_path: [a]}
ontology: [lines.txt]
annotations: lines.txt
bridges: lines.txt
domains: {Rover: [r1]}
""",
)

FILES: Final = {'more.yaml': '- {name: more, formula: x.y < 1}\n', 'lines.txt': 'x.y < 1\n'}

UNWRITTEN: Final = {'tf', 'yaw', 'free', 'geojson', 'mask', 'vda5050'}
"""Keys whose values need files or other keys than the documents have."""


def paths_in(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield where the values in a document are."""
    of_list = enumerate(value if isinstance(value, list) else ())
    for key, each in value.items() if isinstance(value, dict) else of_list:
        yield (*path, key)
        yield from paths_in(each, (*path, key))


def changed(document: Any, path: tuple[Any, ...], value: object) -> Any:
    found = parent = copy.deepcopy(document)
    for key in path[:-1]:
        parent = parent[key]
    parent[path[-1]] = value
    return found


def schema_keys(schema: Any) -> set[str]:
    """Return the keys that a schema knows."""
    if isinstance(schema, list):
        return {key for each in schema for key in schema_keys(each)}
    if not isinstance(schema, dict):
        return set()
    own = schema.get('properties', {})
    return {*own, *schema_keys([*schema.values(), *own.values()])}


def test_the_documents_have_all_keys() -> None:
    found = {key for text in DOCUMENTS for path in paths_in(loaded(text)) for key in path}
    known = schema_keys([SCHEMA['properties'], *DEFINITIONS.values()]) | {*SCHEMA['properties']}
    nodes = {*SCHEMA['properties']['nodes']['properties']}
    assert known - {'properties'} - found == UNWRITTEN | (nodes - found)


@pytest.mark.long
@pytest.mark.parametrize('text', DOCUMENTS, ids=lambda text: ' '.join(loaded(text)))
def test_a_wrong_value_is_refused_at_its_place(tmp_path: Path, text: str) -> None:
    for name, content in FILES.items():
        (tmp_path / name).write_text(content)
    document = loaded(text)
    right = yaml.safe_dump(document, sort_keys=False)
    robot_of(parse_yaml(tmp_path / 'robot.yaml', right))
    for path in paths_in(document):
        for value in WRONG_VALUES:
            wrong = yaml.safe_dump(changed(document, path, value), sort_keys=False)
            error = fault_of(parse_yaml(tmp_path / 'robot.yaml', wrong))
            if error is None:
                assert VALIDATOR.is_valid(loaded(wrong)), (path, value)
            else:
                assert error.position != NOWHERE, (path, value, str(error))


def fault_of(document: YamlValue) -> ConfigurationError | None:
    try:
        robot_of(document)
    except ConfigurationError as error:
        return error
    return None
