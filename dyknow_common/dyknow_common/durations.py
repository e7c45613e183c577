"""Durations and points in time as whole nanoseconds, and their texts."""

from __future__ import annotations

import argparse
import os
import re
import time  # noqa: TID251 - it sets the zone, and reads no clock
from collections.abc import Callable, Iterable
from datetime import datetime
from decimal import Decimal
from fractions import Fraction
from typing import Any, Final

from dyknow_common.errors import shortened

SECOND_NS: Final = 1_000_000_000
"""One second in nanoseconds."""

NANOSECONDS: Final = {
    'ns': 1,
    'us': 1_000,
    'ms': 1_000_000,
    's': SECOND_NS,
    'min': 60 * SECOND_NS,
    'h': 3_600 * SECOND_NS,
}
"""The units of time in texts, in nanoseconds."""

MAX_DURATION_NS: Final = (2**31 - 1) * SECOND_NS
"""The longest duration in a text, and the latest time: the longest in a message of ROS."""

REPAIR_NS: Final = 5 * SECOND_NS
"""The time in which a reader of a reliable topic gets what was lost on the way.

Fast DDS sends it again after the next heartbeat of the writer, which comes each 3 s. Until then,
the reader holds back all later messages of that writer. A burst that exceeds the buffer of a socket
is lost in part, such as the announcements of a node at its start.
"""

MAX_DIGITS: Final = 100
"""The number of characters of a number in a text."""

UNIX_TIMES: Final = 10**9 * SECOND_NS
"""Times from 2001-09-09 on count from 1970; earlier ones belong to a simulation."""

DAY_NS: Final = 86_400 * SECOND_NS

MAX_OFFSET_NS: Final = 7 * DAY_NS
"""The longest time from a start that people are shown as an offset from it."""

_UNIX_TIME = re.compile(r'(?<![\w.])([0-9]{10})\.([0-9]{3,9}) s\b')

_TIME = re.compile(r'(-?)([0-9]+)\.([0-9]{3,9}) s\b')

_MOMENT = re.compile(
    r'\b(?:after|and|at|before|between|from|since|to|until) -?[0-9.]+ s\b'
    r'|in [(\[][^ ]+ s, [^ ]+ s\b'
)
"""What says when something is, so that its numbers are no durations."""

_DURATION = re.compile(r'(?P<number>-?[0-9]+(?:\.[0-9]+)?)\s*(?P<unit>[A-Za-z]*)')


def parse_duration(text: str, bare_unit: str = 'ms') -> int:
    """Return the nanoseconds of a text such as `200 ms`, `0.5s` or `1000`.

    Args:
        text: a number with a unit or without one.
        bare_unit: the unit of a number without one: in texts ms, as in the paper.

    Raises:
        ValueError: for a text that is not a duration, an unknown unit, a part of a nanosecond, or a
            duration that is too long.
    """
    shown = shortened(text)
    match = _DURATION.fullmatch(text.strip())
    if match is None:
        raise ValueError(f"'{shown}' is not a duration; write a number and a unit, such as 200 ms")
    unit = match['unit'] or bare_unit
    if unit not in NANOSECONDS:
        unit = shortened(unit)
        raise ValueError(f"unknown unit of time '{unit}'; the units are {', '.join(NANOSECONDS)}")
    if len(match['number']) > MAX_DIGITS:
        raise ValueError(f'a number has at most {MAX_DIGITS} characters')
    nanoseconds = Fraction(match['number']) * NANOSECONDS[unit]
    if abs(nanoseconds) > MAX_DURATION_NS:
        raise ValueError(f"'{shown}' is longer than {format_duration(MAX_DURATION_NS)} (68 years)")
    if nanoseconds.denominator != 1:
        raise ValueError(f"'{shown}' is not a whole number of nanoseconds")
    return int(nanoseconds)


def duration_option(text: str) -> int:
    """Return a duration on the command line in nanoseconds; a type for argparse.

    A bare number is in seconds, as in the commands of ROS 2.

    Raises:
        ArgumentTypeError: if it is not a duration, or below 0.
    """
    try:
        duration = parse_duration(text, 's')
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    if duration < 0:
        raise argparse.ArgumentTypeError(f"'{shortened(text)}' is below 0")
    return duration


def format_duration(nanoseconds: int) -> str:
    """Return a duration as a whole number of the largest possible unit of ns, us, ms and s."""
    for unit in ('s', 'ms', 'us'):
        if nanoseconds % NANOSECONDS[unit] == 0:
            return f'{nanoseconds // NANOSECONDS[unit]} {unit}'
    return f'{nanoseconds} ns'


def round_duration(nanoseconds: int, unlike: int | None = None) -> str:
    """Return a duration for people to read, with at least three digits: `314 ms`, `12.3 s`.

    It has more digits if it would otherwise look like `unlike`, another duration.
    """
    digits = 3
    if unlike is not None and unlike != nanoseconds:
        while _rounded(nanoseconds, digits) == _rounded(unlike, digits):
            digits += 1
    amount, unit = _rounded(nanoseconds, digits)
    return f'{amount:f} {unit}'


def _rounded(nanoseconds: int, digits: int) -> tuple[Decimal, str]:
    for unit in ('s', 'ms', 'us'):
        amount = Decimal(nanoseconds) / NANOSECONDS[unit]
        rounded = Decimal(f'{amount:.{max(digits, len(str(abs(int(amount)))))}g}')
        if abs(rounded) >= 1:
            return rounded, unit
    return Decimal(nanoseconds), 'ns'


def format_time(nanoseconds: int) -> str:
    """Return a point in time in seconds, exactly, with at least three decimals: `12.300 s`."""
    sign = '-' if nanoseconds < 0 else ''
    seconds, fraction = divmod(abs(nanoseconds), SECOND_NS)
    decimals = f'{fraction:09d}'
    return f'{sign}{seconds}.{decimals[:3]}{decimals[3:].rstrip("0")} s'


def round_time(nanoseconds: int, *unlike: int) -> str:
    """Return a point in time in seconds, rounded down to milliseconds: `12.300 s`.

    It is rounded less if it would otherwise look like another one of `unlike`.
    """
    step = 10 ** (9 - _decimals(nanoseconds, unlike))
    return format_time(nanoseconds // step * step)


def _decimals(nanoseconds: int, unlike: Iterable[int]) -> int:
    """Return the decimals of seconds, at least 3, by which a time differs from others."""
    others = [each for each in unlike if each != nanoseconds]
    for decimals in (3, 6):
        step = 10 ** (9 - decimals)
        if all(each // step != nanoseconds // step for each in others):
            return decimals
    return 9


def clock_time(nanoseconds: int, *unlike: int) -> str:
    """Return a point in time on the wall clock of this machine, down to ms: `14:31:32.521`.

    One that does not count from 1970 is as from `round_time`, and so are the decimals.
    """
    if nanoseconds < UNIX_TIMES:
        return round_time(nanoseconds, *unlike)
    seconds, fraction = divmod(nanoseconds, SECOND_NS)
    moment = datetime.fromtimestamp(seconds).astimezone()
    return f'{moment:%H:%M:%S}.{f"{fraction:09d}"[: _decimals(nanoseconds, unlike)]}'


def date_time(nanoseconds: int, *unlike: int) -> str:
    """Return a date and time as `clock_time`, with the zone: `2024-03-18 14:49:09.911 UTC`."""
    if nanoseconds < UNIX_TIMES:
        return round_time(nanoseconds, *unlike)
    moment = datetime.fromtimestamp(nanoseconds // SECOND_NS).astimezone()
    return f'{moment:%Y-%m-%d} {clock_time(nanoseconds, *unlike)} {moment:%Z}'


def time_since(nanoseconds: int, start: int) -> str:
    """Return a point in time as an offset and on the clock: `13.662 s, 14:31:32.521`."""
    offset = round_time(nanoseconds - start)
    return offset if nanoseconds < UNIX_TIMES else f'{offset}, {clock_time(nanoseconds)}'


def near_time(nanoseconds: int, now: int | None, *unlike: int) -> str:
    """Return a point in time as `clock_time`, or as `date_time` if it is a day or more from now."""
    is_near = now is None or abs(nanoseconds - now) < DAY_NS
    return clock_time(nanoseconds, *unlike) if is_near else date_time(nanoseconds, *unlike)


def with_readable_times(text: str, start: int | None = None, *, now: int | None = None) -> str:
    """Return a text for people with its times as offsets from a start on the same clock.

    Different times look different; one without a fraction of a millisecond may be a rounded one.

    Args:
        text: a text, such as an explanation, with times as from `format_time`.
        start: the start in nanoseconds; None if unknown. Times on the clock are shown without a
            start, or more than MAX_OFFSET_NS from it, as for a time on another (simulated) clock.
        now: if it is given, times on the clock that are a day or more away have a date.
    """

    def readable(found: re.Match[str]) -> str:
        nanoseconds = _nanoseconds(found)
        times = exact if nanoseconds in exact else ()
        if start is None or abs(nanoseconds - start) > MAX_OFFSET_NS:
            return near_time(nanoseconds, now, *times)
        return round_time(nanoseconds - start, *(each - start for each in times))

    if start is not None and start < UNIX_TIMES:
        text = _MOMENT.sub(lambda moment: _with_offsets(moment[0], start), text)
    found = map(_nanoseconds, _UNIX_TIME.finditer(text))
    exact = {each for each in found if each % NANOSECONDS['ms']}
    return _UNIX_TIME.sub(readable, text)


def with_changed_times(text: str, change: Callable[[int], int]) -> str:
    """Return a text for people with other times.

    Args:
        text: a text with times as from `format_time`; times before UNIX_TIMES stay as they are.
        change: returns the new time of a time, in nanoseconds.
    """
    return _UNIX_TIME.sub(lambda found: format_time(change(_nanoseconds(found))), text)


def _nanoseconds(found: re.Match[str]) -> int:
    """Return a time that _UNIX_TIME has found."""
    return int(found[1]) * SECOND_NS + int(found[2].ljust(9, '0'))


def _with_offsets(text: str, start: int) -> str:
    """Return a text with its times that do not count from 1970 as offsets from a start."""

    def offset(found: re.Match[str]) -> str:
        time = int(f'{found[1]}{found[2]}{found[3].ljust(9, "0")}')
        return format_time(time - start) if time < UNIX_TIMES else found[0]

    return _TIME.sub(offset, text)


class _UseUtc(argparse.Action):
    def __call__(self, *_: Any) -> None:
        os.environ['TZ'] = 'UTC'
        if hasattr(time, 'tzset'):  # Not on Windows.
            time.tzset()


def add_utc_option(parser: argparse.ArgumentParser) -> None:
    """Add the option `--utc`, which sets the zone of this process, also for `clock_time`."""
    parser.add_argument(
        '--utc', action=_UseUtc, nargs=0, help='show times in UTC, not in the zone of this machine'
    )
