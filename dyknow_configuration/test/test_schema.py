"""The JSON Schema for editors knows the keys of the reader, and accepts what the reader accepts."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from jsonschema import Draft202012Validator

from dyknow_common import CONSTRAINT_KINDS, ValueType
from dyknow_configuration import PACKAGES, Severity, reading
from dyknow_configuration.expectations import EXPECTATION_KEYS
from dyknow_configuration.federation import FEDERATION_KEYS, SHARE_KEYS
from dyknow_configuration.forecasts import FORECAST_KEYS
from dyknow_configuration.formulas import FORMULA_KEYS
from dyknow_configuration.guards import GUARD_KEYS
from dyknow_configuration.reading import TEMPLATE_KEYS
from dyknow_configuration.regions import POSITION_KEYS, REGION_KEYS
from dyknow_configuration.topics import SOURCE_KEYS
from dyknow_configuration.triggers import ACTION_KEYS, TRIGGER_KEYS, TriggerEvent
from dyknow_configuration.vocabulary import FEATURE_KEYS, SORT_KEYS

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
    'parameter_of_no_type', 'record_of_number', 'record_unknown_key', 'record_without_unit',
    'topic_and_stream', 'two_actions', 'unknown_action',
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
