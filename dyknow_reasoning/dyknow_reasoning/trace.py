"""Recorded traces: one state per row, read from comma-separated values."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation

from dyknow_common import MAX_DIGITS, SECOND_NS, LanguageError, Value, shortened
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.language.parsing import parse_formula

_UNITS = {'time_ns': Decimal(1), 'time_s': Decimal(SECOND_NS)}
_INTEGER = re.compile(rf'[+-]?[0-9]{{1,{MAX_DIGITS}}}')
_DECIMAL = re.compile(
    r'[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)(e[+-]?[0-9]+)?|nan|[+-]?inf', re.IGNORECASE
)
_BOOLEANS = {'true': True, 'false': False}


@dataclass(frozen=True, slots=True)
class RecordedState:
    """A row of a trace.

    Args:
        valid_time: the valid time in nanoseconds.
        values: the values by the canonical texts of features; empty cells are left out.
    """

    valid_time: int
    values: Mapping[str, Value]


def read_trace(lines: Iterable[str]) -> Iterator[RecordedState]:
    """Return the states of a trace, one by one.

    The first line names the columns: `time_ns` or `time_s`, and one column for each ground feature.
    A value is `true` or `false`, an integer, a decimal, or else a string.

    Args:
        lines: the lines of a file of comma-separated values.

    Raises:
        ReasoningError: for an invalid trace, with the line.
    """
    rows = csv.reader(lines, skipinitialspace=True)
    try:
        columns = _columns(next(rows, []))
        for row in rows:
            if row:
                yield _state(row, columns, f'line {rows.line_num}')
    except csv.Error as error:
        raise ReasoningError(f'line {rows.line_num}: {error}') from None


def _columns(header: Sequence[str]) -> list[str]:
    """Return the canonical names of the columns."""
    names = [name.strip() for name in header]
    if sum(name in _UNITS for name in names) != 1:
        raise ReasoningError(
            'line 1: a trace has one column of times, time_ns or time_s; '
            f'this one has the columns: {shortened(", ".join(names)) or "none"}'
        )
    columns: list[str] = []
    known: set[str] = set()
    for name in names:
        try:
            column = str(parse_formula(name))
        except LanguageError:
            raise ReasoningError(f"line 1: the column '{shortened(name)}' is not a ground feature") from None
        if column in known:
            raise ReasoningError(f"line 1: there are two columns '{shortened(column)}'; remove one")
        known.add(column)
        columns.append(column)
    return columns


def _state(row: Sequence[str], columns: Sequence[str], where: str) -> RecordedState:
    if len(row) != len(columns):
        raise ReasoningError(f'{where}: {len(row)} values for {len(columns)} columns')
    cells = dict(zip(columns, map(str.strip, row), strict=True))
    clock = next(name for name in columns if name in _UNITS)
    valid_time = _nanoseconds(cells.pop(clock), clock, where)
    return RecordedState(valid_time, {name: _value(cell) for name, cell in cells.items() if cell})


def _nanoseconds(cell: str, clock: str, where: str) -> int:
    try:
        time = Decimal(cell) * _UNITS[clock]
        if time.adjusted() < MAX_DIGITS and time == int(time):
            return int(time)
    except (InvalidOperation, ValueError, OverflowError):
        pass
    raise ReasoningError(f"{where}: '{shortened(cell)}' is not a whole number of nanoseconds, in {clock}")


def _value(cell: str) -> Value:
    if cell in _BOOLEANS:
        return _BOOLEANS[cell]
    if _INTEGER.fullmatch(cell):
        return int(cell)
    return float(cell) if _DECIMAL.fullmatch(cell) else cell
