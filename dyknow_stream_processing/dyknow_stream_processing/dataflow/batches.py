"""Samples as columns: what operators take and give when they process many at once.

`Operator.step_many` plans the same samples, and the same state afterwards, as `receive`, `promise`
and `wake` would give one by one. A plan changes nothing; all operators adopt theirs, or none does.
An operator refuses what it cannot plan, such as a sample that breaks a constraint: then all go by
steps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final, NoReturn

import numpy as np
from numpy.typing import NDArray

from dyknow_common import Value
from dyknow_stream_processing.dataflow.scheduler import BEGINNING, END

Times = NDArray[np.int64]
Columns = Mapping[str, NDArray[np.generic]]

Settled = Callable[[Times, Times], Times]
"""Returns when valid times become certain, like `Operator.certain_at`, but also by promises.

The first argument is for promises, the second one for the clock. They differ after a `select`: it
waits for a promise of a later time, as another sample of the same time may follow.
"""


class Refusal(StrEnum):
    """Why an operator needs steps."""

    OPERATOR = 'the operator processes single samples only'
    ANOTHER_ENGINE = 'a stream of another engine has watermarks'
    FIELDS = 'fields are missing, differ or collide'
    ORDER = 'samples are out of order, or simultaneous'
    LEAD = 'a sample is ahead of the clock'
    DELAY = 'a sample is late'
    DISTANCE = 'the distance of two samples is not allowed'
    RECEIPT = 'the times of receipt are unknown'
    VALUE = 'a value cannot be compared or computed with'
    BUFFER = 'too many samples wait'
    TICKS = 'too many ticks are due at once'


class NeedsStepsError(Exception):
    """Something happens in a batch that an operator can only process by steps."""

    def __init__(self, reason: Refusal) -> None:
        super().__init__(reason)
        self.reason = reason


@dataclass(frozen=True, slots=True)
class SampleBatch:
    """Samples that an operator emits.

    Args:
        valid_times: in nanoseconds, increasing except for a `merge`; of shape (n,).
        columns: the values by field, of shape (n,); of integers and floats with 64 bits, and of
            objects. Without samples, the fields may be unknown.
        settled: when valid times are certain for the consumers.
        receipts: when the samples are emitted, in nanoseconds, in this order; None: when their
            valid times are certain.
    """

    valid_times: Times
    columns: Columns
    settled: Settled
    receipts: Times | None

    def __len__(self) -> int:
        return len(self.valid_times)

    def emission_times(self) -> Times:
        """Return when the samples are emitted."""
        if self.receipts is not None:
            return self.receipts
        return self.settled(self.valid_times, self.valid_times)

    def rows(self, found: NDArray[np.bool_] | NDArray[np.intp] | slice) -> SampleBatch:
        """Return some of the samples."""
        columns = {name: column[found] for name, column in self.columns.items()}
        receipts = None if self.receipts is None else self.receipts[found]
        return replace(
            self, valid_times=self.valid_times[found], columns=columns, receipts=receipts
        )


@dataclass(frozen=True, slots=True)
class Planned:
    """The planned result of an operator for a batch.

    Args:
        watermark: its watermark afterwards.
        adopt: changes its state; the inputs have done so before.
    """

    output: SampleBatch
    watermark: int
    adopt: Callable[[], None] = lambda: None


def never(times: Times, clock: Times) -> Times:  # noqa: ARG001
    """Return when times are certain without any promise: never."""
    return np.full(len(times), END)


def by_clock(delay: int) -> Settled:
    """Return when the clock makes times certain: a delay, in nanoseconds, after them."""
    return lambda _, clock: clock + delay


def by_samples(valid_times: Times, receipts: Times) -> Settled:
    """Return when samples promise times: each sample, in order, promises times until its own."""
    known = np.append(receipts, END)
    return lambda times, _: known[np.searchsorted(valid_times, times)]


def earliest(*ways: Settled) -> Settled:
    """Return when times become certain in one of some ways."""
    return lambda times, clock: np.minimum.reduce([each(times, clock) for each in ways])


def latest(parts: Sequence[Settled]) -> Settled:
    """Return when times become certain for all of some inputs."""
    if len(parts) == 1:
        return parts[0]
    return lambda times, clock: np.maximum.reduce([each(times, clock) for each in parts])


def later_than(watermark: int, settled: Settled) -> Settled:
    """Return when times become certain, if times until a watermark are certain already."""
    return lambda times, clock: np.where(times <= watermark, BEGINNING, settled(times, clock))


_NOTHING: Final = np.zeros(0, np.int64)

NO_SAMPLES: Final = SampleBatch(_NOTHING, {}, never, _NOTHING)


def is_increasing(times: Times, after: int) -> bool:
    """Return True if times increase strictly, from one that is later than another time."""
    return not len(times) or (int(times[0]) > after and bool((np.diff(times) > 0).all()))


def followed_by(
    rows: Sequence[tuple[int, Mapping[str, Value]]], valid_times: Times, columns: Columns
) -> tuple[Times, Columns]:
    """Return samples that were received one by one, followed by the samples of a batch.

    Raises:
        NeedsStepsError: if not all have the same fields.
    """
    if not rows:
        return valid_times, columns
    names = rows[0][1].keys()
    is_mixed = any(fields.keys() != names for _, fields in rows)
    if is_mixed or (len(valid_times) and columns.keys() != names):
        refuse(Refusal.FIELDS)
    times = np.concatenate([np.array([time for time, _ in rows], np.int64), valid_times])
    found = {}
    for name in names:
        column = column_of([fields[name] for _, fields in rows], columns.get(name))
        if len(valid_times):
            column = concatenated([column, columns[name]])
        found[name] = column
    return times, found


def rows_of(times: Times, columns: Columns) -> Iterator[tuple[int, Mapping[str, Value]]]:
    """Yield samples one by one: their valid times and fields."""
    values = [column.tolist() for column in columns.values()]
    rows = zip(*values, strict=True) if values else iter([()] * len(times))
    for time, row in zip(times.tolist(), rows, strict=True):
        yield time, dict(zip(columns, row, strict=True))


def concatenated(columns: Sequence[NDArray[np.generic]]) -> NDArray[np.generic]:
    """Return the values of several columns, each of one type."""
    if len({each.dtype for each in columns}) > 1:
        columns = [each.astype(object) for each in columns]
    return np.concatenate(columns)


def refuse(reason: Refusal) -> NoReturn:
    """Leave a batch to steps.

    Raises:
        NeedsStepsError: always.
    """
    raise NeedsStepsError(reason)


def column_of(
    values: Sequence[Value | None], like: NDArray[np.generic] | None = None
) -> NDArray[np.generic]:
    """Return values as a column, integers with the type of another column if they fit."""
    types = {type(each) for each in values}
    dtype: type | np.dtype[np.generic] = object
    if types == {float}:
        dtype = np.dtype(np.float64)
    elif types == {bool}:
        dtype = np.dtype(np.bool_)
    elif types == {int}:
        dtype = np.dtype(np.int64) if like is None or like.dtype.kind not in 'iu' else like.dtype
    try:
        return np.array(values, dtype)
    except OverflowError:
        return np.array(values, object)
