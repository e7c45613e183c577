import math
import struct
from pathlib import Path

import numpy as np
import pytest
from running_checks import run_check
from small_logs import PERIOD_US, START_US, data, log, record, start

from dyknow_common import ExitCode, ValueType
from dyknow_recordings import RecordedTopic, RecordingError, in_order, open_recording

COUNT = 20_000


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / 'flight.ulg'


def test_topics_and_fields_of_a_log(path: Path) -> None:
    path.write_bytes(log(range(10)))
    with open_recording(path) as opened:
        assert opened.topics == (
            RecordedTopic('/number', 'px4/number', 10, None),
            RecordedTopic('/number_1', 'px4/number', 5, None),
        )
        assert opened.start_time == START_US * 1000
        assert opened.end_time == (START_US + 9 * PERIOD_US) * 1000
        assert opened.fields('/number') == {
            'timestamp': ValueType.INT,
            'x': ValueType.INT,
            'q[0..2]': ValueType.FLOAT,
            'ready': ValueType.BOOLEAN,
            'parts[0..1].a': ValueType.INT,
            'parts[0..1].b': ValueType.FLOAT,
        }
        with pytest.raises(RecordingError, match='computed from an array'):
            list(opened.columns({'/number': ['max(q)']}))
        with pytest.raises(RecordingError, match="topic '/number' has no field 'z'") as error:
            opened.columns({'/number': ['z']})
        assert error.value.code == ExitCode.NOT_FOUND
        with pytest.raises(RecordingError, match="unknown topic '/n'"):
            opened.columns({'/n': []})
        assert opened.faults == ()


def test_messages_of_a_log_in_order(path: Path) -> None:
    path.write_bytes(log(range(COUNT)))
    fields = ['x', 'q[1]', 'q[2]', 'ready', 'parts[1].a', 'parts[1].b']
    with open_recording(path) as opened:
        parts = list(opened.columns({'/number': fields, '/number_1': ['x']}))
    assert len(parts) > 2
    assert parts[0].values['x'].dtype == np.uint32
    assert parts[0].values['ready'].dtype == np.bool_
    assert parts[0].stamps is None
    rows = list(in_order(iter(parts)))
    assert len(rows) == COUNT * 3 // 2
    assert [row.log_time for row in rows] == sorted(row.log_time for row in rows)
    second = next(row for row in rows if row.values['x'] == 3)
    assert second.log_time == (START_US + 3 * PERIOD_US) * 1000
    assert math.isnan(second.values.pop('q[1]'))  # type: ignore[attr-defined]
    assert second.values == {
        'x': 3, 'q[2]': -2.0, 'ready': False, 'parts[1].a': -3, 'parts[1].b': 0.75
    }  # fmt: skip


def test_faults_of_a_log(path: Path) -> None:
    times = [START_US, START_US + 2, START_US - 2_000_000, 2**63, START_US + 4 * 3600 * 10**6]
    rows = b''.join(data(0, time, number) for number, time in enumerate(times))
    dropout = record('O', struct.pack('<H', 250))
    path.write_bytes(log([]) + rows + dropout + data(0, START_US, 9)[:-1])
    with open_recording(path) as opened:
        found = [row.values['x'] for row in in_order(opened.columns({'/number': ['x']}))]
        assert found == [0, 1, 4]
        assert [str(fault) for fault in opened.faults] == [
            "topic '/number': a message has no time",
            "topic '/number': the log time jumps back, first for 2.00 s after 5.000002 s",
            "topic '/number': a message has no time: its stamp is from before the log",
            f'{path}: the logger has lost messages, first for 250 ms',
            f'{path}: the file ends early, within a message',
            f'{path}: no message is recorded, first for 14400 s after 5.000002 s',
        ]


@pytest.mark.parametrize(
    ('change', 'reason'),
    [
        ('dropout', 'the logger has lost messages'),
        ('cut', 'the file ends early, within a message'),
        ('damage', 'parts of the file are damaged: they are left out'),
    ],
)
def test_no_verdict_depends_on_lost_messages(path: Path, change: str, reason: str) -> None:
    """Earlier verdicts stay, unless it is unknown which messages are lost."""
    content = log(range(20))
    later = b''.join(data(0, START_US + n * PERIOD_US, n) for n in range(30, 40))
    lost = record('O', struct.pack('<H', 10 * PERIOD_US // 1000))
    middle = {'dropout': lost, 'cut': b'', 'damage': bytes(12)}[change]
    path.write_bytes((content + middle + later)[: -1 if change == 'cut' else None])
    early = 2 if change == 'damage' else 1
    for formula, code in (('always "/number".x < 50', 2), ('always "/number".x < 5', early)):
        found = run_check(path, '--json', '--formula', formula)
        assert found.code == code
        assert (reason in str(found.formulas[0]['error'])) is (code == 2)


def test_a_log_without_messages(path: Path) -> None:
    path.write_bytes(start())
    with open_recording(path) as opened:
        assert opened.topics == ()
        assert list(opened.columns({})) == []
        with pytest.raises(RecordingError, match='the recording has no messages'):
            _ = opened.end_time


def test_a_trace(tmp_path: Path) -> None:
    path = tmp_path / 'flight.csv'
    path.write_text(
        'time_s: float, Power[uav1], mode: string, ready, spare: string, empty\n'
        '1, 3, a,,,\n2, 4.5, b, true,,\n3,,,,,\n'
    )
    with open_recording(path) as opened:
        assert opened.topics == (RecordedTopic('/trace', 'csv/row', 3, None),)
        assert (opened.start_time, opened.end_time) == (10**9, 3 * 10**9)
        assert opened.fields('/trace') == {
            'Power[uav1]': ValueType.FLOAT,
            'mode': ValueType.STRING,
            'ready': ValueType.BOOLEAN,
            'spare': ValueType.STRING,  # It is declared, though all of its cells are empty.
            'empty': ValueType.FLOAT,
        }
        rows = list(in_order(opened.columns({'/trace': ['Power[uav1]', 'mode', 'ready']})))
        assert [row.values for row in rows] == [
            {'Power[uav1]': 3, 'mode': 'a'},
            {'Power[uav1]': 4.5, 'mode': 'b', 'ready': True},
            {},
        ]
        assert rows[0].absent == {'ready': "the cell of 'ready' is empty"}
        assert rows[0].stamp == 10**9
        assert opened.faults == ()
        with pytest.raises(
            RecordingError, match=r"the trace has no field 'power'; did you mean 'Power"
        ):
            opened.columns({'/trace': ['power']})


def test_a_trace_of_one_type_has_columns_of_that_type(tmp_path: Path) -> None:
    path = tmp_path / 'long.csv'
    path.write_text('time_ns, x\n' + ''.join(f'{n}, {n}\n' for n in range(COUNT)))
    with open_recording(path) as opened:
        parts = list(opened.columns({'/trace': ['x']}))
    assert len(parts) > 1
    assert all(part.values['x'].dtype == np.int64 for part in parts)
    assert np.concatenate([part.values['x'] for part in parts]).tolist() == list(range(COUNT))
    assert np.concatenate([part.positions for part in parts]).tolist() == list(range(COUNT))


def test_a_trace_with_a_bad_row(tmp_path: Path) -> None:
    path = tmp_path / 'bad.csv'
    path.write_text('time_s, x\n0, 1\n7200, 2\n7200, 3\n')
    with open_recording(path) as opened:
        assert [row.values['x'] for row in in_order(opened.columns({'/trace': ['x']}))] == [1, 2]
        assert [fault.reason for fault in opened.faults] == [
            (
                "the rest of the file is left out: line 4, column 'time_s': the time is not later "
                'than that of the row before; times must increase'
            ),
            'no message is recorded, first for 7200 s after 0.000 s',
        ]
