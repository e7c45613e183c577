"""Messages without stamps in recordings that have the times at which they were sent."""

from __future__ import annotations

from pathlib import Path

import pytest
from running_checks import run_check
from small_bags import START, channel, mcap, schema, stored

from dyknow_recordings import Bag, in_order

MS = 1_000_000
NUMBER = schema(1, 'made_up/msg/Number', 'uint8 x\n') + channel(1, 1, '/x')


def number(value: int) -> bytes:
    return b'\0\1\0\0' + bytes([value])


def written(folder: Path, *records: bytes) -> Path:
    file = folder / 'made.mcap'
    file.write_bytes(mcap(NUMBER, *records))
    return file


SENT_AND_LOGGED = [(0, 0, 80), (1, 0, 8), (1, 50, 58), (1, 100, 108), (1, 150, 158)]
"""A message: True if of /y, when it was sent and recorded, in milliseconds."""


def sent_mcap(folder: Path, shift: int) -> Path:
    """A file of a command, /x, that is recorded late, and of the speed, /y, that it sets.

    Args:
        shift: of the clock of the senders, in nanoseconds.
    """
    second = schema(2, 'made_up/msg/Number', 'uint8 x\n') + channel(2, 2, '/y')
    messages = [
        stored(1 + of_y, START + logged * MS, number(sent != 0 or not of_y), sent=at - shift)
        for of_y, sent, logged in sorted(SENT_AND_LOGGED, key=lambda each: each[2])
        for at in [START + sent * MS]
    ]
    return written(folder, second, *messages)


@pytest.mark.parametrize(
    ('shift', 'code'),
    [(0, 0), (50 * 365 * 24 * 3600 * 10**9, 1)],
    ids=['sent', 'another clock'],
)
def test_messages_without_stamps_are_valid_when_they_were_sent(
    tmp_path: Path, shift: int, code: int
) -> None:
    """The speed follows the command, although the command is recorded after it."""
    file = sent_mcap(tmp_path, shift)
    with Bag(file) as bag:
        assert bag.contents['/x'].has_sent_times is (shift == 0)
        (row, *_) = in_order(bag.columns({'/y': ['x'], '/x': ['x']}))
        assert row.stamp == (START if shift == 0 else None)
    formula = '"/x".x = 1 and "/y".x = 0 and eventually[40 ms, 60 ms] "/y".x = 1'
    found = run_check(file, '--formula', formula)
    assert found.code == code, found


@pytest.mark.parametrize(('delay', 'words'), [(90, ''), (110, 'came 110 ms after it was sent')])
def test_messages_that_were_sent_long_before(tmp_path: Path, delay: int, words: str) -> None:
    times = [(START + n * 200 * MS, START + n * 200 * MS - 5) for n in range(3)]
    times.append((START + 700 * MS, START + (700 - delay) * MS))
    rows = [stored(1, logged, number(1), sent=sent) for logged, sent in times]
    file = written(tmp_path, *rows)
    found = run_check(file, '--json', '--formula', 'always "/x".x = 1')
    assert found.code == (2 if words else 0)
    assert words in found.out
