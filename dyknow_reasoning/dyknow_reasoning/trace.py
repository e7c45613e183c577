"""Recorded traces: one state per row, read from comma-separated values."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Context, Decimal, Inexact, Overflow
from typing import Any

from dyknow_common import (
    MAX_LINE,
    SECOND_NS,
    LanguageError,
    Value,
    ValueType,
    cached_by_text,
    shortened,
    unknown,
)
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.language.parsing import parse_formula
from dyknow_reasoning.language.terms import Feature, FieldReference

_UNITS = {
    'time_s': Decimal(SECOND_NS),
    'time_ms': Decimal(10**6),
    'time_us': Decimal(10**3),
    'time_ns': Decimal(1),
}
_EXACT = Context(prec=60, traps=[Inexact, Overflow])
_LATEST = 2**63
_DECIMAL = re.compile(r'[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?')

_TEXTS = {
    ValueType.BOOLEAN: re.compile('true|false', re.IGNORECASE),
    ValueType.INT: re.compile('[+-]?[0-9]+'),
    ValueType.FLOAT: re.compile(f'{_DECIMAL.pattern}|nan|[+-]?inf', re.IGNORECASE),
    ValueType.STRING: re.compile('.*', re.DOTALL),
}
_NUMBER = (ValueType.INT, ValueType.FLOAT)
_INFERRED = ((ValueType.BOOLEAN,), _NUMBER, (ValueType.STRING,))
# A text may be as long as a line.
csv.field_size_limit(MAX_LINE)

_LONGEST_INTEGER = len(str(-(2**63)))


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

    The first line names the columns: `time_s` (or `_ms`, `_us`, `_ns`), and one column for each
    ground feature, optionally with its type: `mode: string`. Without one, the first value of
    the column decides if it holds booleans (`true`, `false`), numbers, or strings. Quotes around a
    value have no meaning, and neither has a `#` at the beginning of the first line.

    Args:
        lines: the lines of a file of comma-separated values.

    Raises:
        ReasoningError: for an invalid trace, with the line and the column.
    """
    rows = csv.reader(lines, skipinitialspace=True, strict=True)
    columns = _columns(next(_cells(rows), []))
    clock = next(column for column in columns if column.name in _UNITS)
    previous: int | None = None
    for row in _cells(rows):
        line = f'line {rows.line_num}'
        if len(row) != len(columns):
            lacking = f", none for '{columns[len(row)].name}'" if len(row) < len(columns) else ''
            raise ReasoningError(f'{line}: {len(row)} values for {len(columns)} columns{lacking}')
        values = {}
        for column, cell in zip(columns, row, strict=True):
            if cell:
                values[column.name] = column.value(cell, line)
        valid_time = values.pop(clock.name, None)
        if not isinstance(valid_time, int):
            raise ReasoningError(f"{line}, column '{clock.name}': the time is missing")
        if previous is not None and valid_time <= previous:
            raise ReasoningError(
                f"{line}, column '{clock.name}': the time is not later than that of the row "
                'before; times must increase'
            )
        previous = valid_time
        yield RecordedState(valid_time, values)


def declared_types(lines: Iterable[str]) -> dict[str, ValueType]:
    """Return the types that the first line of a trace declares; `float` for the other columns.

    Raises:
        ReasoningError: for an invalid first line.
    """
    columns = _columns(next(_cells(csv.reader(lines, skipinitialspace=True, strict=True)), []))
    features = (each for each in columns if each.name not in _UNITS)
    return {each.name: each.declared or ValueType.FLOAT for each in features}


class _Column:
    """A column of a trace.

    Args:
        header: its name, and optionally its type.
    """

    def __init__(self, header: str) -> None:
        name, _, kind = (part.strip() for part in header.rpartition(':'))
        self.declared = ValueType(kind) if kind in set(ValueType) and name else None
        self.name = _canonical(name if self.declared else header)
        self._types: tuple[ValueType, ...] = (self.declared,) if self.declared else ()

    def value(self, cell: str, line: str) -> Value:
        """Return the value in a cell; for the column of times, in nanoseconds.

        Raises:
            ReasoningError: if the cell is not of the column's type.
        """
        try:
            return self._time(cell) if self.name in _UNITS else self._value(cell)
        except ValueError as error:
            message = f"{line}, column '{self.name}': {shortened(cell)!r} {error}"
            raise ReasoningError(message) from None

    def _time(self, cell: str) -> int:
        unit = _UNITS[self.name]
        try:
            if _DECIMAL.fullmatch(cell):
                time = _EXACT.multiply(Decimal(cell), unit)
                # 1.000000000000000056e-01 is how numpy.savetxt writes the float nearest to 0.1.
                if abs(time) < _LATEST and (
                    time == (whole := round(time)) or float(whole / unit) == float(cell)
                ):
                    return whole
        except ArithmeticError:
            pass
        raise ValueError(f'is not a whole number of nanoseconds within 64 bits, in {self.name}')

    def _value(self, cell: str) -> Value:
        if '\0' in cell:
            raise ValueError('has a NUL character')
        if not self._types:
            self._types = next(
                types for types in _INFERRED if any(_TEXTS[kind].fullmatch(cell) for kind in types)
            )
        for kind in self._types:
            if _TEXTS[kind].fullmatch(cell):
                return _CONVERSIONS[kind](cell)
        expected = 'number' if self._types == _NUMBER else self._types[0]
        if self.declared:
            raise ValueError(f'is not of the type of the column, {expected}')
        raise ValueError(
            f'is not a {expected}, as the first value of the column is; leave cells without a '
            f"value empty, and declare a column of strings as '{self.name}: string'"
        )


def _cells(rows: Any) -> Iterator[list[str]]:
    """Yield the cells of the rows that are not empty, without the spaces around them."""
    while True:
        try:
            row = [cell.strip() for cell in next(rows)]
        except StopIteration:
            return
        except csv.Error as error:
            message = f'line {rows.line_num}: {error}; is a quote missing?'
            raise ReasoningError(message) from None
        if row not in ([], ['']):
            yield row


def _columns(header: Sequence[str]) -> list[_Column]:
    columns: dict[str, _Column] = {}
    names = [*header]
    names[:1] = [each.removeprefix('#').lstrip() for each in names[:1]]  # As numpy.savetxt has it.
    for text in names:
        column = _Column(text)
        if column.name in columns:
            raise ReasoningError(
                f"line 1: there are two columns '{shortened(column.name)}'; remove one"
            )
        columns[column.name] = column
    if sum(name in _UNITS for name in columns) != 1:
        raise ReasoningError(
            f'line 1: a trace has one column of times, named by their unit: {", ".join(_UNITS)}; '
            f'rename it; this trace has the columns: {shortened(", ".join(names)) or "none"}'
        )
    return list(columns.values())


@cached_by_text
def _canonical(name: str) -> str:
    """Return the canonical text of a ground feature.

    Raises:
        ReasoningError: if something else has the name.
    """
    try:
        formula = parse_formula(name)
    except LanguageError:
        formula = None
    if not isinstance(formula, Feature | FieldReference):
        if (kind := name.rpartition(':')[2].strip()) != name and kind.isidentifier():
            message = unknown('type', kind, [*ValueType])
            raise ReasoningError(f"line 1, column '{shortened(name)}': {message}")
        separators = any(each in name for each in ';\t')
        mend = 'separate columns by commas' if separators else 'name it as in x or Power[uav1]'
        raise ReasoningError(
            f"line 1: the column '{shortened(name)}' is not a ground feature; {mend}"
        )
    return str(formula)


def _integer(cell: str) -> int:
    digits = cell.lstrip('+-').lstrip('0')
    if len(digits) < _LONGEST_INTEGER and -(2**63) <= int(cell) < 2**63:
        return int(cell)
    raise ValueError('is an integer of more than 64 bits')


def _float(cell: str) -> float:
    value = float(cell)
    if math.isinf(value) and _DECIMAL.fullmatch(cell):
        raise ValueError('is too large for a float')
    return value


_CONVERSIONS: Mapping[ValueType, Callable[[str], Value]] = {
    ValueType.BOOLEAN: lambda cell: cell.lower() == 'true',
    ValueType.INT: _integer,
    ValueType.FLOAT: _float,
    ValueType.STRING: str,
}
