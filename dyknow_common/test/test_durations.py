"""Points in time as people read them."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator

import pytest

from dyknow_common import (
    SECOND_NS,
    add_utc_option,
    clock_time,
    date_time,
    duration_option,
    near_time,
    time_since,
    with_readable_times,
)

START = 1_710_773_349_911_591_000
"""2024-03-18 14:49:09.911591 UTC."""


@pytest.fixture
def utc() -> Iterator[None]:
    before = os.environ.get('TZ')
    parser = argparse.ArgumentParser()
    add_utc_option(parser)
    parser.parse_args(['--utc'])
    yield
    if before is None:
        del os.environ['TZ']
    else:
        os.environ['TZ'] = before
    time.tzset()


def test_a_duration_on_the_command_line_is_not_below_0() -> None:
    assert (duration_option('2'), duration_option('0 s')) == (2 * SECOND_NS, 0)
    with pytest.raises(argparse.ArgumentTypeError, match="'-5 s' is below 0"):
        duration_option('-5 s')


@pytest.mark.usefixtures('utc')
def test_times_for_people() -> None:
    assert clock_time(START) == '14:49:09.911'
    assert date_time(START) == '2024-03-18 14:49:09.911 UTC'
    assert time_since(START + 13_662_999_999, START) == '13.662 s, 14:49:23.574'
    assert clock_time(START + 1_000, START + 1_999_999) == '14:49:09.911'
    assert clock_time(START + 1_000, START) == '14:49:09.911592'
    # Those of a simulation, or of a trace, are no times of a clock.
    assert clock_time(12_300_000_000) == date_time(12_300_000_000) == '12.300 s'
    assert time_since(12_300_000_000, 2_000_000_000) == '10.300 s'


@pytest.mark.usefixtures('utc')
@pytest.mark.parametrize(
    ('text', 'start', 'expected'),
    [
        ('x = 1 at 1710773349.911591 s is not > 2', START, 'x = 1 at 0.000 s is not > 2'),
        ('in [1710773350.321 s, 1710773355.500 s]', START, 'in [0.409 s, 5.588 s]'),
        ('since 1710773348.911 s', START, 'since -1.001 s'),
        ('at 1710773349.911591 s', None, 'at 14:49:09.911'),
        ('at 1710773349.911591 s', 12 * SECOND_NS, 'at 14:49:09.911'),  # Simulated time.
        (
            'at 1710773349.911591 s after 1710773349.911110474 s and 1710773350.911 s',
            None,
            'at 14:49:09.911591 after 14:49:09.911110 and 14:49:10.911',
        ),
        (
            'at 1710773349.911591 s after 1710773349.911591001 s',
            START,
            'at 0.000 s after 0.000000001 s',
        ),
        (  # The first one is the second one, rounded.
            'from 1710773349.911 s on: x = 1 at 1710773349.911591 s',
            None,
            'from 14:49:09.911 on: x = 1 at 14:49:09.911',
        ),
        ('at 12.300 s, x1710773349.911 s, 1710773349.911 sheep', 0, None),
        ('x = 1 at 3.456 s, since 1.5001 s', 2 * SECOND_NS, 'x = 1 at 1.456 s, since -0.4999 s'),
        (
            'in (2.500 s, 3.500 s], between 2.000 s',
            SECOND_NS,
            'in (1.500 s, 2.500 s], between 1.000 s',
        ),
        ('[0.500 s, 2.500 s] came 2.345 s late, x = 2.500', SECOND_NS, None),
    ],
)
def test_texts_with_times_for_people(text: str, start: int | None, expected: str | None) -> None:
    assert with_readable_times(text, start) == (text if expected is None else expected)


@pytest.mark.usefixtures('utc')
@pytest.mark.parametrize(
    ('days', 'expected'), [(0, '14:49:09.911'), (2, '2024-03-18 14:49:09.911 UTC')]
)
def test_a_time_of_another_day_has_a_date(days: int, expected: str) -> None:
    now = START + days * 86_400 * SECOND_NS
    assert with_readable_times('x at 1710773349.911591 s', now=now) == f'x at {expected}'
    assert near_time(START, now) == expected
    assert near_time(START, None) == '14:49:09.911'
