"""Spans and points of time as whole nanoseconds, and how they are written."""

from __future__ import annotations

import re
from decimal import Decimal, InvalidOperation
from typing import Final

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
"""The units that a duration may be written in."""

DURATION_PATTERN: Final = r'\d+(\.\d+)?\s*(ns|us|ms|s|min|h)\b'
"""A duration with its unit, as a regular expression; the grammars repeat it."""

_DURATION = re.compile(r'(?P<number>-?\d+(?:\.\d+)?)\s*(?P<unit>[a-z]*)')


def parse_duration(text: str) -> int:
    """The nanoseconds that a text such as `200 ms`, `0.5s` or `1000` means.

    A bare number is in milliseconds, as in the paper.

    Raises:
        ValueError: for what is no duration, an unknown unit, or a part of a nanosecond.
    """
    match = _DURATION.fullmatch(text.strip())
    if match is None:
        raise ValueError(f"'{text}' is not a duration; write a number and a unit, such as 200 ms")
    unit = match['unit'] or 'ms'
    if unit not in NANOSECONDS:
        raise ValueError(f"unknown unit of time '{unit}'; the units are {', '.join(NANOSECONDS)}")
    try:
        nanoseconds = Decimal(match['number']) * NANOSECONDS[unit]
    except InvalidOperation:  # pragma: no cover - the pattern admits decimal numbers only
        raise ValueError(f"'{text}' is not a duration") from None
    if nanoseconds != int(nanoseconds):
        raise ValueError(f"'{text}' is not a whole number of nanoseconds")
    return int(nanoseconds)


def format_duration(nanoseconds: int) -> str:
    """A duration in the largest of ns, us, ms and s that holds it as a whole number."""
    for unit in ('s', 'ms', 'us'):
        if nanoseconds % NANOSECONDS[unit] == 0:
            return f'{nanoseconds // NANOSECONDS[unit]} {unit}'
    return f'{nanoseconds} ns'


def round_duration(nanoseconds: int) -> str:
    """A duration as people read it, with three digits at least: `314 ms`, `12.3 s`."""
    for unit in ('s', 'ms', 'us'):
        if abs(nanoseconds) >= NANOSECONDS[unit]:
            amount = Decimal(nanoseconds) / NANOSECONDS[unit]
            digits = max(3, len(str(abs(int(amount)))))
            return f'{amount:.{digits}g} {unit}'
    return f'{nanoseconds} ns'


def format_time(nanoseconds: int) -> str:
    """A point in time in seconds, exactly, with three decimals at least: `12.300 s`."""
    sign = '-' if nanoseconds < 0 else ''
    seconds, fraction = divmod(abs(nanoseconds), SECOND_NS)
    decimals = f'{fraction:09d}'
    return f'{sign}{seconds}.{decimals[:3]}{decimals[3:].rstrip("0")} s'


def round_time(nanoseconds: int) -> str:
    """A point in time in seconds as people read it, to the millisecond below: `12.300 s`."""
    return format_time(nanoseconds // NANOSECONDS['ms'] * NANOSECONDS['ms'])
