"""Recorded samples of streams, as a black box has them of features of other hosts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from running_checks import run_check

from dyknow_common import SECOND_NS, Alternatives
from dyknow_recordings import BlackBoxContent
from dyknow_recordings.reading.opening import open_recording
from dyknow_recordings.reading.recording import in_order
from dyknow_stream_processing import SAMPLE_TYPE

S = SECOND_NS
TOPIC = '/dyknow/federation/r1/X_r1'
STATES = f'stream x = select value as "X[r1]" from "{TOPIC}";\nsink sync(x)'

FIELD = 'dyknow_interfaces/msg/Field'
INTERFACES = Path(__file__).resolve().parents[2] / 'dyknow_interfaces' / 'msg'
TYPES = get_typestore(Stores.ROS2_JAZZY)
for each in (FIELD, SAMPLE_TYPE):
    definition = (INTERFACES / f'{each.rpartition("/")[2]}.msg').read_text(encoding='utf-8')
    TYPES.register(get_types_from_msg(definition, each))

Row = Sequence[tuple[str, str, str]]
"""The type, name and text of each field."""


def number(value: float) -> Row:
    return [('float', 'value', repr(value))]


def either(*values: float) -> Row:
    return [('alternatives', 'value', str(Alternatives.of(values, 'the clocks differ')))]


def write(
    path: Path,
    rows: Iterable[Row],
    content: BlackBoxContent | None = None,
    delay: int = S // 2,
    made: int | None = None,
) -> Path:
    """Write a bag with a sample each second from 10 s on, which come late.

    Args:
        path: of the bag.
        rows: the fields of each sample.
        content: of a black box.
        delay: from the valid times to those of receipt, nanoseconds.
        made: from the valid times to those of an engine that made them; None without one.
    """
    types: Any = TYPES.types
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    for key, text in content.custom_data.items() if content else ():
        writer.set_custom_data(key, text)
    with writer:
        connection = writer.add_connection(TOPIC, SAMPLE_TYPE, typestore=TYPES)
        for second, row in enumerate(rows, start=10):
            time = types['builtin_interfaces/msg/Time'](second, 0)
            header = types['std_msgs/msg/Header'](time, '')
            fields = [types[FIELD](*each) for each in row]
            available = types['builtin_interfaces/msg/Time'](second + (made or 0) // S, 0)
            watermark = [] if made is None else [time]
            sample = types[SAMPLE_TYPE](header, time, available, fields, watermark, 1, second, time)
            writer.write(connection, second * S + delay, TYPES.serialize_cdr(sample, SAMPLE_TYPE))
    return path


def values(path: Path, name: str = 'value') -> list[tuple[int, Any]]:
    """The stamps and values of a field, and the reasons why there are none."""
    with open_recording(path) as recording:
        found = list(in_order(recording.columns({TOPIC: [name]})))
    return [(each.stamp or 0, each.values.get(name, each.absent.get(name))) for each in found]


def test_values_have_names(tmp_path: Path) -> None:
    path = write(tmp_path / 'bag', [number(1.5), either(1.5, 2.5), number(2.5), []])
    *known, (_, reason) = values(path)
    assert [value for _, value in known] == [1.5, either(1.5, 2.5)[0][2], 2.5]
    assert isinstance(known[1][1], Alternatives)
    assert [time for time, _ in known] == [10 * S, 11 * S, 12 * S]
    assert reason == "the sample has no field 'value'"
    # Their members can still be read.
    assert values(path, 'fields[0].value')[0] == (10 * S, '1.5')
    assert values(path, 'number')[1] == (11 * S, 11)


def test_values_have_types(tmp_path: Path) -> None:
    row = [('int', 'n', '7'), ('boolean', 'ready', 'true'), ('string', 'mode', 'on')]
    path = write(tmp_path / 'bag', [row])
    assert [values(path, each)[0][1] for each in ('n', 'ready', 'mode')] == [7, True, 'on']


def test_a_sample_with_another_text_is_a_fault(tmp_path: Path) -> None:
    path = write(tmp_path / 'bag', [number(1.0), [('float', 'value', 'much')], number(2.0)])
    with open_recording(path) as recording:
        found = [each.values['value'] for each in in_order(recording.columns({TOPIC: ['value']}))]
        [fault] = recording.faults
    assert found == [1.0, 2.0]
    assert fault.reason == f'a sample has a field that is no value, {SAMPLE_TYPE}'


def test_a_black_box_about_another_host_is_checked(tmp_path: Path) -> None:
    """While one of two values is possible, the state is not known."""
    content = BlackBoxContent('x', 'X[r1] > 2', states=STATES, every_state=True)
    rows = [number(3.0), either(3.0, 1.0), number(1.0), number(3.0), number(3.0)]
    (found,) = run_check(write(tmp_path / 'box', rows, content), '--json').formulas
    assert found['outcome'] == 'false', found
    told = [(each['begin_ns'] // S, each['verdict']) for each in found['episodes']]
    assert told == [(10, 'true'), (11, 'undecided'), (12, 'false'), (13, 'true'), (14, 'true')]


@pytest.mark.parametrize(
    ('made', 'outcome'), [(None, 'error'), (9 * S, 'false'), (4 * S, 'false'), (11 * S, 'error')]
)
def test_samples_of_an_engine_may_come_late(tmp_path: Path, made: int | None, outcome: str) -> None:
    """An engine vouches for the times of its samples, unless its clock is ahead of this one."""
    content = BlackBoxContent('x', 'always X[r1] > 2', states=STATES)
    path = write(tmp_path / 'box', [number(3.0), number(3.0), number(1.0)], content, 9 * S, made)
    (found,) = run_check(path, '--json').formulas
    assert found['outcome'] == outcome, found
