"""The operators of `select ... from each ... where ...`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import COMPARISONS, Alternatives, Value, ValueType, shortened, value_text
from dyknow_stream_processing.dataflow.batches import (
    Planned,
    Refusal,
    SampleBatch,
    Times,
    refuse,
)
from dyknow_stream_processing.dataflow.operators import Operator, Wiring
from dyknow_stream_processing.dataflow.scheduler import BEGINNING, END
from dyknow_stream_processing.errors import StreamError, open_value
from dyknow_stream_processing.language.specification import Condition, Selection
from dyknow_stream_processing.language.type_rules import comparable_types
from dyknow_stream_processing.sample import (
    AbsentElement,
    PartialFields,
    missing_text,
    nearest_absence,
)
from dyknow_stream_processing.violation import Fault, ViolationKind

_MAX_VALUE: Final = 80
"""The length of a value in a message."""

_EXACT: Final = 1 << 53
"""Integers up to this one are floats, too."""

ABSENT: Final = 'absent'
"""The reason of the drop of a message without the element that a key names."""

_MAX_ABSENCES: Final = 16
"""The different reasons for such drops that are kept: several publishers share a topic."""


class SelectOperator(Operator):
    """Some fields of the samples of its source that satisfy all conditions."""

    def __init__(
        self, wiring: Wiring, selections: Sequence[Selection], conditions: Sequence[Condition]
    ) -> None:
        super().__init__(wiring)
        self._tests = [(condition.field, condition_test(condition)) for condition in conditions]
        self._selections = [(_namer(each), _reader(each)) for each in selections]
        self._constant_names: Mapping[str, str] | None = None
        if not any(each.embedded_fields for each in selections):
            self._constant_names = {each.name: each.field for each in selections}
        # The selections with values that are NaN in samples that satisfy a condition.
        self._doubted = [(each.name, each.unless) for each in selections if each.unless is not None]
        self._emitted = BEGINNING
        self._conditions = tuple(conditions)
        self._rejected: tuple[str, Value] | None = None
        """The latest value for which a sample was not selected, and its field."""
        self._absent: dict[str, None] = {}
        """Why the latest incomplete messages lack an element, without repetitions."""

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Emit the selected fields of a sample that satisfies the conditions."""
        try:
            for field, test in self._tests:
                if not test(fields[field]):
                    self._rejected = field, fields[field]
                    self.promise(port, watermark, now)
                    return
            selected = self._select(fields)
        except KeyError as error:
            if isinstance(error.args[-1], AbsentElement):
                self._note_absence(str(error.args[-1]))
                self._drop(ABSENT)
                self.promise(port, watermark, now)
                return
            known = ', '.join(fields) or 'nothing'
            message = missing_text(error, f' in the sample (it has: {known})')
        except StreamError as error:
            message = error.message
        else:
            self._emitted = valid_time
            self._emit(valid_time, selected, self._promised(watermark, valid_time), now)
            return
        self._reject(Fault(ViolationKind.FIELDS, valid_time, message))
        self.promise(port, watermark, now)

    def _note_absence(self, reason: str) -> None:
        self._absent[reason] = None
        if len(self._absent) > _MAX_ABSENCES:
            del self._absent[next(iter(self._absent))]

    def promise(self, port: int, watermark: int, now: int) -> None:  # noqa: ARG002
        """Promise the same, except for a time at which nothing has been selected.

        Many samples may share a valid time, such as one of each robot of a fleet. The next sample
        may be selected, so consumers must wait for it.
        """
        self._promise(self._promised(watermark, self._emitted), now)

    def step_many(self, inputs: Sequence[SampleBatch], end: int) -> Planned:  # noqa: ARG002
        """Plan to emit the selected fields of the samples that satisfy the conditions."""
        (batch,) = inputs
        chosen, rejected = self._chosen(batch)
        emitted = int(chosen.valid_times[-1]) if len(chosen) else self._emitted

        def adopt() -> None:
            self._emitted, self._rejected = emitted, rejected or self._rejected

        known = np.append(chosen.valid_times, END)

        def settled(times: Times, clock: Times) -> Times:
            is_emitted = known[np.searchsorted(known, times)] == times
            return batch.settled(times + ~is_emitted, clock)

        promised = self._promised(self.inputs[0].watermark, emitted)
        return Planned(replace(chosen, settled=settled), promised, adopt)

    def obstacle(self, name: Callable[[Operator], str]) -> str:
        """Return the conditions, if samples fail them, and how the last one did."""
        if self._absent:
            reason = nearest_absence(self._absent)
            return f'no sample of {name(self.inputs[0])} has what is selected: {reason}'
        if self._rejected is None:
            return super().obstacle(name)
        source, (field, value) = name(self.inputs[0]), self._rejected
        rejected = f'{field} = {shortened(value_text(value), _MAX_VALUE)}'
        conditions = ' and '.join(map(str, self._conditions))
        return f'no sample of {source} satisfies {conditions} (the last has {rejected})'

    def certain_at(self, valid_time: int) -> int | None:
        """Return the time from which not even a second sample of a valid time can arrive."""
        if valid_time <= self.watermark:
            return BEGINNING
        certain = super().certain_at(valid_time + 1)
        return None if certain is None else certain - 1

    def covered_until(self) -> int:
        """Return the time before which no second sample of a valid time can arrive."""
        return max(self.watermark, super().covered_until() - 1) if self.vouched else END

    def certain_until(self, now: int) -> int:
        """Return the time until which not even a second sample of a valid time can arrive."""
        return max(self.watermark, self.inputs[0].certain_until(now + 1) - 1)

    def _promised(self, watermark: int, emitted: int) -> int:
        is_covered = watermark == emitted or (self.in_order and watermark < emitted)
        return watermark if is_covered else watermark - 1

    def _chosen(self, batch: SampleBatch) -> tuple[SampleBatch, tuple[str, Value] | None]:
        """Return the selected fields of samples, and a field and value of the last one dropped."""
        if self._constant_names is None:
            refuse(Refusal.FIELDS)
        if not len(batch):
            return replace(batch, columns={}), None
        columns = batch.columns
        try:
            masks = [satisfied(each, columns[each.field]) for each in self._conditions]
            selected = {name: columns[field] for name, field in self._constant_names.items()}
            for name, unless in self._doubted:
                is_unknown = satisfied(unless, columns[unless.field])
                selected[name] = np.where(is_unknown, np.nan, as_floats(selected[name]))
        except KeyError:
            refuse(Refusal.FIELDS)
        except StreamError:
            refuse(Refusal.VALUE)
        chosen = replace(batch, columns=selected)
        found = np.logical_and.reduce(masks) if masks else np.ones(1, np.bool_)
        if found.all():
            return chosen, None
        last = int(np.flatnonzero(~found)[-1])
        failed = next(index for index, mask in enumerate(masks) if not mask[last])
        field = self._conditions[failed].field
        return chosen.rows(found), (field, columns[field][last : last + 1].tolist()[0])

    def _select(self, fields: Mapping[str, Value]) -> Mapping[str, Value]:
        if self._constant_names is not None and not self._doubted:
            return {name: fields[field] for name, field in self._constant_names.items()}
        selected: dict[str, Value] = {}
        for namer, read in self._selections:
            name = namer(fields)
            if name in selected:
                raise StreamError(f"two selected fields are both named '{name}'; rename one")
            selected[name] = read(fields)
        return selected


class ElementsOperator(Operator):
    """A sample for each element of an array; all have the times of the message.

    Args:
        rows: the name under which the samples of the source hold fields of the elements.
    """

    def __init__(self, wiring: Wiring, rows: str) -> None:
        super().__init__(wiring)
        self._rows = rows

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Emit the elements, which may be none."""
        if isinstance(fields, PartialFields) and self._rows in fields.rows:
            for row in fields.rows[self._rows]:
                self._emit(valid_time, row, watermark, now)
        else:
            reasons = fields.reasons if isinstance(fields, PartialFields) else {}
            message = reasons.get(self._rows, 'the message has no such array')
            if isinstance(message, AbsentElement):
                self._drop(ABSENT)
            else:
                self._reject(Fault(ViolationKind.FIELDS, valid_time, message))
        self.promise(port, watermark, now)


def _reader(selection: Selection) -> Callable[[Mapping[str, Value]], Value]:
    """Return the function that reads the value of a selection."""
    field, unless = selection.field, selection.unless
    if unless is None:
        return lambda fields: fields[field]
    test, tested = condition_test(unless), unless.field
    return lambda fields: math.nan if test(fields[tested]) else as_float(fields[field])


def as_float(value: Value) -> float | Alternatives:
    """Return a number that may be unknown, as a float; one of several numbers as it is.

    Raises:
        StreamError: if it is no number.
    """
    for each in value.values if isinstance(value, Alternatives) else (value,):
        if isinstance(each, bool | str):
            found = f'{value_text(each)} ({ValueType.of(each)})'
            raise StreamError(f'{found} is not a number, and only numbers may be unknown')
    return value if isinstance(value, Alternatives) else float(value)


def as_floats(column: NDArray[np.generic]) -> NDArray[np.float64]:
    """Return numbers that may be unknown, as floats; see `as_float`.

    Raises:
        NeedsStepsError: if one is no number, or one of several.
    """
    if column.dtype.kind not in 'if' and not {*map(type, column.tolist())} <= {int, float}:
        refuse(Refusal.VALUE)
    return column.astype(np.float64)


def condition_test(condition: Condition) -> Callable[[Value], bool]:
    """Return a function that tests values; it raises a StreamError for one of another type."""
    compare, expected = COMPARISONS[condition.operator], condition.value
    comparable = comparable_types(condition)
    types = {each for each in (bool, int, float, str) if ValueType.of(each()) in comparable}

    def test(value: Value) -> bool:
        if isinstance(value, Alternatives):
            raise open_value({condition.field: value}, 'compared by a stream')
        if type(value) not in types:
            raise StreamError(
                f"field '{condition.field}' is {value_text(value)} ({ValueType.of(value)}), "
                f'which cannot be compared with {value_text(expected)}'
            )
        return compare(value, expected)

    return test


def satisfied(condition: Condition, column: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Return which values satisfy a condition, as its test compares them.

    Raises:
        StreamError: if a value cannot be compared.
    """
    compare, value = COMPARISONS[condition.operator], condition.value
    if type(value) in {int, float} and abs(value) <= _EXACT:  # type: ignore[arg-type]
        if column.dtype.kind == 'f':
            return np.asarray(compare(column, float(value)))
        if type(value) is int and column.dtype == np.int64:
            return np.asarray(compare(column, value))
    return np.array(list(map(condition_test(condition), column.tolist())), np.bool_)


def _namer(selection: Selection) -> Callable[[Mapping[str, Value]], str]:
    """Return the function that replaces the field names embedded in a new name by their values."""
    renaming = selection.renaming
    parts = [selection.field] if renaming is None else renaming.split('%')

    def name(fields: Mapping[str, Value]) -> str:
        texts = parts.copy()
        for index in range(1, len(parts), 2):
            value = fields[parts[index]] if parts[index] else '%'
            if isinstance(value, Alternatives):
                raise open_value({parts[index]: value}, 'part of a name')
            texts[index] = value if isinstance(value, str) else value_text(value)
        return ''.join(texts)

    return name
