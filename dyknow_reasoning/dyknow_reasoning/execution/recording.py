"""Recordings: many states at once, as columns of values."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.vectors.atom_vectors import Columns, column_vector
from dyknow_reasoning.progression.atoms import Values


@dataclass(frozen=True, slots=True)
class Recording:
    """Many states.

    Args:
        times: the valid times of the states, in nanoseconds.
        columns: for each field, its values at these states.
    """

    times: list[int]
    columns: Columns

    @classmethod
    def read(cls, times: Iterable[int], columns: Mapping[str, Iterable[Any]]) -> Recording:
        """Return the recording of times and columns, which may be numpy arrays.

        Raises:
            ReasoningError: for a column of another length than the times.
        """
        found = times.tolist() if isinstance(times, np.ndarray) else list(times)
        vectors = {name: column_vector(column) for name, column in columns.items()}
        for name, vector in vectors.items():
            if len(vector) != len(found):
                raise ReasoningError(
                    f"the column '{name}' has {len(vector)} values for {len(found)} states"
                )
        return cls(found, vectors)

    def values(self, index: int) -> Values:
        """Return the values of a state as plain Python objects."""
        return {name: column.item(index) for name, column in self.columns.items()}

    def increasing(self, latest: int | None) -> Recording:
        """Return the states before the first one whose valid time is not later than the previous.

        Args:
            latest: the valid time of the state before the recording; None if there is none.
        """
        steps = self.steps(latest)
        first = 1 if latest is None else 0
        end = next((index for index in range(first, len(steps)) if steps[index] <= 0), len(steps))
        columns = {name: column[:end] for name, column in self.columns.items()}
        return Recording(self.times[:end], columns)

    def steps(self, latest: int | None) -> list[int]:
        """Return the nanoseconds from the previous state to each state; `latest` as above."""
        if not self.times:
            return []
        previous = self.times[0] if latest is None else latest
        return list(map(operator.sub, self.times, [previous, *self.times[:-1]]))
