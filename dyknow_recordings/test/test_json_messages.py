"""Messages of mcap files in JSON."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from small_bags import channel, mcap, schema, stored

from dyknow_common import ValueType
from dyknow_configuration import RequestedFormula
from dyknow_recordings import RecordingError, evaluate_recording, in_order, open_recording

START = 1_700_000_000 * 10**9
NUMBER = {'type': 'number'}
STAMP = {'properties': {'sec': {'type': 'integer'}, 'nanosec': {'type': 'integer'}}}
CELL = {'type': 'object', 'properties': {'name': {'type': 'string'}, 'voltage': NUMBER}}
SCHEMA = {
    'type': 'object',
    'properties': {
        'header': {'type': 'object', 'properties': {'stamp': {'$ref': '#/$defs/stamp'}}},
        'voltage': {'type': ['number', 'null']},
        'ok': {'type': 'boolean'},
        'cells': {'type': 'array', 'items': CELL},
        'matrix': {'type': 'array', 'items': {'type': 'array', 'items': NUMBER}},
        'any': {},
        'not an identifier': NUMBER,
    },
    '$defs': {'stamp': STAMP},
}


def write(path: Path, definition: Any, *messages: Any) -> Path:
    rows = [
        stored(1, START + n * 10**8, each if isinstance(each, bytes) else json.dumps(each).encode())
        for n, each in enumerate(messages)
    ]
    text = definition if isinstance(definition, str) else json.dumps(definition)
    kind = schema(1, 'Battery', text, 'jsonschema')
    path.write_bytes(mcap(kind, channel(1, 1, '/battery', 'json'), *rows))
    return path


def battery(number: int, **others: Any) -> Mapping[str, Any]:
    sec, nanosec = divmod(START + number * 10**8 - 5, 10**9)
    cells = [{'name': name, 'voltage': number + place} for place, name in enumerate('ab')]
    stamp = {'sec': float(sec), 'nanosec': nanosec}
    return {'header': {'stamp': stamp}, 'voltage': number, 'ok': True, 'cells': cells, **others}


def test_fields_of_messages_in_json(tmp_path: Path) -> None:
    messages = [battery(0), battery(1, voltage=None), battery(2, voltage='high', cells=[]), b'{']
    with open_recording(write(tmp_path / 'a.mcap', SCHEMA, *messages)) as opened:
        assert opened.fields('/battery') == {
            'header.stamp.sec': ValueType.INT,
            'header.stamp.nanosec': ValueType.INT,
            'voltage': ValueType.FLOAT,
            'ok': ValueType.BOOLEAN,
            'cells[0..].name': ValueType.STRING,
            'cells[0..].voltage': ValueType.FLOAT,
        }
        assert opened.contents['/battery'].has_stamp
        paths = ['voltage', 'ok', 'cells[name="b"].voltage', 'cells[1].name', 'max(cells.voltage)']
        rows = list(in_order(opened.columns({'/battery': paths})))
        assert [row.stamp for row in rows] == [START + n * 10**8 - 5 for n in range(3)]
        assert rows[0].values == dict(zip(paths, [0.0, True, 1.0, 'b', 1.0], strict=True))
        assert rows[1].absent == {'voltage': "the message has no 'voltage'"}
        assert rows[2].absent['voltage'] == "'voltage' does not fit its schema"
        assert set(rows[2].absent) == {*paths} - {'ok'}
        assert [str(each) for each in opened.faults] == [
            "topic '/battery': a message is no object in JSON, Battery"
        ]


@pytest.mark.parametrize(
    ('stamp', 'expected'),
    [
        ({'nanosec': 5}, 0),
        ({'sec': 10**30, 'nanosec': 0}, (1 << 32) * 10**9),
        ({'sec': -1, 'nanosec': 1}, 1 - 10**9),
    ],
)
def test_stamps_that_are_none(tmp_path: Path, stamp: Mapping[str, int], expected: int) -> None:
    message = battery(0, header={'stamp': stamp})
    with open_recording(write(tmp_path / 'a.mcap', SCHEMA, battery(0), message)) as opened:
        rows = list(in_order(opened.columns({'/battery': ['voltage']})))
    assert [row.stamp for row in rows] == [START - 5, expected]


def test_formulas_over_messages_in_json(tmp_path: Path) -> None:
    path = write(tmp_path / 'a.mcap', SCHEMA, *map(battery, range(20)))
    formula = RequestedFormula('always "/battery".voltage < 15')
    with open_recording(path) as opened:
        (found,) = evaluate_recording(opened, [formula]).formulas
    assert found.outcome == 'false'
    assert found.episodes[0].decided_at == START + 15 * 10**8 - 5


DEEP: Any = {'type': 'object', 'properties': {'a': {'$ref': '#'}, 'b': {'$ref': '#'}}}
LONG: Any = {'properties': {'x' * 10**6: {'properties': {f'y{n}': NUMBER for n in range(20)}}}}


@pytest.mark.parametrize(
    ('definition', 'reason'),
    [
        ('', 'cannot be read'),
        ('[' * 100_000, 'cannot be read'),
        ({'type': 'array', 'items': NUMBER}, 'cannot be read'),
        (True, 'cannot be read'),
        (DEEP, 'contains itself, or is too large'),
        (LONG, 'are too long'),
    ],
)
def test_schemas_that_cannot_be_read(tmp_path: Path, definition: Any, reason: str) -> None:
    with open_recording(write(tmp_path / 'a.mcap', definition, {})) as opened:
        with pytest.raises(RecordingError, match=reason):
            opened.fields('/battery')
        assert reason in opened.fault_of('/battery') or opened.contents['/battery'].fields is None
