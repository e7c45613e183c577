"""Stamps outside of a log of PX4, and formats that no log has."""

import struct
from collections.abc import Sequence
from pathlib import Path

import pytest
from small_logs import PERIOD_US, START_US, data, log, record, start

from dyknow_configuration import RequestedFormula
from dyknow_recordings import EpisodeStart, RecordingError, evaluate_recording, open_recording
from dyknow_recordings.reading import ulog

COUNT = 500
END_US = START_US + (COUNT - 1) * PERIOD_US
HOUR_US = 3600 * 10**6
BEFORE = "topic '/number_1': a message has no time: its stamp is from before the log"
AFTER = "topic '/number_1': a message has no time: its stamp is from long after its end"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / 'flight.ulg'


def write(path: Path, first: Sequence[int], last: Sequence[int] = ()) -> None:
    """Write a log whose second topic has messages of some times before and after the first."""
    rows = [data(0, START_US + number * PERIOD_US, number) for number in range(COUNT)]
    begin, end = ([data(1, time, x) for x, time in enumerate(times)] for times in (first, last))
    path.write_bytes(log([]) + b''.join([*begin, *rows, *end]))


@pytest.mark.parametrize(
    ('first', 'last', 'found', 'faults'),
    [
        ([0], [], [(START_US, 0)], []),
        ([START_US - 9, START_US - 8], [], [(START_US, 1)], []),
        ([0, 0, START_US - 8, START_US + 5], [], [(START_US, 2), (START_US + 5, 3)], []),
        ([0, START_US], [], [(START_US, 1)], []),
        ([0, 0, START_US + 5], [], [(START_US + 5, 2)], [f'{BEFORE} (2 times)']),
        ([], [0], [], [BEFORE]),
        ([START_US + 5, 0, START_US + 9], [], [(START_US + 5, 0), (START_US + 9, 2)], [BEFORE]),
        ([END_US + HOUR_US], [], [], [AFTER]),
        ([START_US, START_US + HOUR_US], [END_US], [(START_US, 0), (END_US, 0)], [AFTER]),
        # Nothing tells that this stamp is wrong.
        ([], [END_US + HOUR_US // 2], [(END_US + HOUR_US // 2, 0)], []),
    ],
)
def test_stamps_outside_of_a_log(
    path: Path,
    first: Sequence[int],
    last: Sequence[int],
    found: Sequence[tuple[int, int]],
    faults: Sequence[str],
) -> None:
    write(path, first, last)
    with open_recording(path) as opened:
        assert opened.start_time == START_US * 1000
        assert opened.end_time == max(END_US, *(time for time, _ in found), 0) * 1000
        parts = list(opened.columns({'/number_1': ['x']}))
        times = [time for part in parts for time in part.log_times.tolist()]
        values = [x for part in parts for x in part.values['x'].tolist()]
        assert list(zip(times, values, strict=True)) == [(time * 1000, x) for time, x in found]
        assert [str(each) for each in opened.faults if 'jumps back' not in each.reason] == faults


def test_a_start_after_all_messages_is_not_used(path: Path) -> None:
    path.write_bytes(log([]) + data(0, START_US - 7, 0) + data(0, START_US - 5, 1))
    with open_recording(path) as opened:
        assert opened.start_time == (START_US - 7) * 1000
        assert 'from before the start in its header' in str(opened.faults)


def test_strays_do_not_change_a_check(path: Path) -> None:
    write(path, [0, END_US + HOUR_US])
    formulas = ['always "/number".x < 500', 'always ("/number".x >= "/number_1".x)']
    begin = EpisodeStart(START_US * 1000 + 4 * 10**9)
    with open_recording(path) as opened:
        reports = [evaluate_recording(opened, [RequestedFormula(each)]) for each in formulas]
        late = evaluate_recording(opened, [RequestedFormula(formulas[0])], start=begin)
    for report in reports:
        (found,) = report.formulas
        assert (found.outcome, found.waits_for) == ('undecided', '')
        assert found.states >= COUNT - 1  # A state of two topics waits for both.
    assert late.formulas[0].episodes[0].begin == begin.begin
    assert late.start_time == START_US * 1000


@pytest.mark.parametrize(
    ('formats', 'topics', 'reason'),
    [
        ([f'a{n}:a{n + 1}[100] x;' for n in range(9)], ['a0'], "'a0' has more than 65536 values"),
        (['a0:b[100] x;', 'b:a0[100] x;'], ['a0'], 'contains itself'),
        (['a0:uint8_t[60000] x;'], ['a0'] * 9, 'the messages of all topics have more than 65536'),
        ([f'a0:b[9] {"x" * 60000};', f'b:a9[9] {"y" * 60000};'], ['a0'], 'are too long'),
    ],
)
def test_formats_of_any_size(
    path: Path, formats: Sequence[str], topics: Sequence[str], reason: str
) -> None:
    texts = [*formats, 'a9:uint8_t[100] x;']
    subscribed = [struct.pack('<BH', 0, n) + each.encode() for n, each in enumerate(topics)]
    content = [record('F', each.encode()) for each in texts] + [
        record('A', each) for each in subscribed
    ]
    path.write_bytes(start() + b''.join(content))
    with pytest.raises(RecordingError, match=f'not a readable log of PX4: .*{reason}'):
        open_recording(path)


def test_a_lack_of_memory_is_no_damage(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def read(_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(ulog, 'BoundedLog', read)
    write(path, [])
    with pytest.raises(RecordingError, match='needs more memory than this computer has'):
        open_recording(path)
