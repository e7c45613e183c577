"""Intervals of time of temporal operators."""

from __future__ import annotations

from dataclasses import dataclass

from dyknow_common import NANOSECONDS, format_duration

_MICROSECOND = NANOSECONDS['us']


@dataclass(frozen=True, slots=True)
class Interval:
    """The times from `start` to `end`, both included, in nanoseconds; no end is infinite."""

    start: int = 0
    end: int | None = None

    def __str__(self) -> str:
        opening, closing = '(' if self.excludes_start else '[', ')' if self.excludes_end else ']'
        start = format_duration(self.start - self.excludes_start)
        end = 'inf' if self.end is None else format_duration(self.end + self.excludes_end)
        return f'{opening}{start}, {end}{closing}'

    @property
    def excludes_start(self) -> bool:
        """True if the text excludes the start with a round bracket: 1 ns after a whole us."""
        return self.start % _MICROSECOND == 1

    @property
    def excludes_end(self) -> bool:
        """True if the text excludes the end with a round bracket: 1 ns before a whole us."""
        return self.end is not None and self.end % _MICROSECOND == _MICROSECOND - 1

    @property
    def suffix(self) -> str:
        """The text after an operator; empty if the interval is all the future."""
        return '' if self == ALL_FUTURE else str(self)


ALL_FUTURE = Interval()
"""The interval of an operator without one."""
