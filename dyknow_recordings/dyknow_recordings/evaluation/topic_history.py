"""The latest messages of a topic, as columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dyknow_recordings.reading.columns import MessageColumns


def _no_times() -> NDArray[np.int64]:
    return np.zeros(0, np.int64)


@dataclass(frozen=True, slots=True)
class TopicHistory:
    """Messages of a topic without a fault, with increasing valid times.

    Args:
        valid_times: in nanoseconds; of shape (n,), like all vectors.
        log_times: in nanoseconds.
        positions: the number of each message among all messages.
        values: by the path of the field.
        is_whole: True if no message of the topic has come before these.
    """

    valid_times: NDArray[np.int64] = field(default_factory=_no_times)
    log_times: NDArray[np.int64] = field(default_factory=_no_times)
    positions: NDArray[np.int64] = field(default_factory=_no_times)
    values: Mapping[str, NDArray[np.generic]] = field(default_factory=dict)
    is_whole: bool = True

    def __len__(self) -> int:
        return len(self.valid_times)

    def followed_by(self, other: TopicHistory) -> TopicHistory:
        """Return these messages and some that have come after them."""
        if not len(self):
            return replace(other, is_whole=self.is_whole)
        return TopicHistory(
            np.concatenate([self.valid_times, other.valid_times]),
            np.concatenate([self.log_times, other.log_times]),
            np.concatenate([self.positions, other.positions]),
            {
                path: concatenated([self.values[path], column])
                for path, column in other.values.items()
            },
            self.is_whole,
        )

    def rows(self, found: NDArray[np.bool_]) -> TopicHistory:
        """Return some of the messages."""
        return TopicHistory(
            self.valid_times[found],
            self.log_times[found],
            self.positions[found],
            {path: column[found] for path, column in self.values.items()},
            self.is_whole and bool(found.all()),
        )


def concatenated(columns: Sequence[NDArray[np.generic]]) -> NDArray[np.generic]:
    """Return the values of several columns, each of one type."""
    if len({each.dtype for each in columns}) > 1:
        columns = [each.astype(object) for each in columns]
    return np.concatenate(columns)


def history_of(parts: Sequence[MessageColumns]) -> TopicHistory:
    """Return the messages of a topic in a batch; all have the same fields."""
    log_times = np.concatenate([part.log_times for part in parts])
    positions = np.concatenate([part.positions for part in parts])
    stamps = [part.log_times if part.stamps is None else part.stamps for part in parts]
    values = {path: concatenated([part.values[path] for part in parts]) for path in parts[0].values}
    found = TopicHistory(np.concatenate(stamps), log_times, positions, values)
    return found if len(parts) == 1 else _in_order(found)


def _in_order(history: TopicHistory) -> TopicHistory:
    order = np.argsort(history.positions)
    return TopicHistory(
        history.valid_times[order],
        history.log_times[order],
        history.positions[order],
        {path: column[order] for path, column in history.values.items()},
    )
