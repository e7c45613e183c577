"""Recordings: many states at once, as columns of values."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.vectors.atom_vectors import Array, Columns, column_vector, is_masked
from dyknow_reasoning.execution.vectors.instance_vectors import MAX_VECTOR_TIME
from dyknow_reasoning.progression.atoms import Values

_BLOCK: Final = 1 << 12
"""The states whose values are read together."""


@dataclass(frozen=True, slots=True)
class Recording:
    """Many states.

    Args:
        times: the valid times of the states, in nanoseconds: 64-bit integers, or objects if they
            or their differences are larger.
        columns: for each field, its values at these states.
    """

    times: Array
    columns: Columns

    def __len__(self) -> int:
        return len(self.times)

    @classmethod
    def read(cls, times: Iterable[int], columns: Mapping[str, Iterable[Any]]) -> Recording:
        """Return the recording of times and columns, which may be numpy arrays.

        Raises:
            ReasoningError: for times that are not integers, or a column that does not have a value
                for each state.
        """
        found = _vector(times)
        vectors = {name: column_vector(column) for name, column in columns.items()}
        for name, vector in vectors.items():
            if vector.ndim != 1:
                raise ReasoningError(
                    f"the column '{name}' has {vector.ndim} dimensions; give one value a state"
                )
            if len(vector) != len(found):
                raise ReasoningError(
                    f"the column '{name}' has {len(vector)} values for {len(found)} states"
                )
        return cls(found, vectors)

    def time(self, index: int) -> int:
        """Return the valid time of a state, in nanoseconds."""
        return int(self.times[index])

    def values(self, index: int) -> Values:
        """Return the values of a state as plain Python objects."""
        return {name: column.item(index) for name, column in self.columns.items()}

    def rows(self, names: AbstractSet[str]) -> Iterator[tuple[int, dict[str, Any]]]:
        """Yield the valid time of each state, and its values of some fields."""
        used = [(name, column) for name, column in self.columns.items() if name in names]
        for first in range(0, len(self), _BLOCK):
            block = slice(first, first + _BLOCK)
            columns = [(name, column[block].tolist()) for name, column in used]
            for index, time in enumerate(self.times[block].tolist()):
                yield time, {name: column[index] for name, column in columns}

    def part(self, first: int, end: int) -> Recording:
        """Return the states from one index to before another."""
        columns = {name: column[first:end] for name, column in self.columns.items()}
        return Recording(self.times[first:end], columns)

    def increasing(self, latest: int | None) -> Recording:
        """Return the states before the first one whose valid time is not later than the previous.

        Args:
            latest: the valid time of the state before the recording; None if there is none.
        """
        steps = self.steps(latest)
        first = 1 if latest is None else 0
        late = np.flatnonzero(steps[first:] <= 0)
        if not late.size:
            return self
        return self.part(0, int(late[0]) + first)

    def steps(self, latest: int | None) -> Array:
        """Return the nanoseconds from the previous state to each state; `latest` as above."""
        if not len(self.times):
            return self.times
        is_large = latest is not None and abs(latest) > MAX_VECTOR_TIME
        times = self.times.astype(object) if is_large else self.times
        first = 0 if latest is None else times[0] - latest
        return np.concatenate((np.array([first], times.dtype), times[1:] - times[:-1]))


def _vector(times: Iterable[Any]) -> Array:
    """Return valid times as a vector; raise ReasoningError unless they are integers."""
    if not isinstance(times, np.ndarray):
        times = np.fromiter(_integers(times), object)
    if times.ndim != 1:
        raise ReasoningError(f'the valid times have {times.ndim} dimensions; give one time a state')
    if times.size and times.dtype.kind not in 'iuO':
        raise _not_integers(times.dtype.name)
    if times.dtype.kind == 'O' or is_masked(times):
        times = np.fromiter(_integers(times.tolist()), object)
    small = times.min(initial=0) >= -MAX_VECTOR_TIME and times.max(initial=0) <= MAX_VECTOR_TIME
    return times.astype(int if small else object)


def _integers(times: Iterable[Any]) -> list[int]:
    """Return integers of any type as Python's; raise ReasoningError for other values."""
    found = list(times)
    if set(map(type, found)) <= {int}:
        return found
    for time in found:
        if isinstance(time, bool) or not isinstance(time, int | np.integer):
            raise _not_integers(type(time).__name__)
    return list(map(int, found))


def _not_integers(type_name: str) -> ReasoningError:
    return ReasoningError(f'the valid times are of type {type_name}; give integers, in nanoseconds')
