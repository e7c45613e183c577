"""The fields of the messages of a topic, and their values as columns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dyknow_common import ValueType


@dataclass(frozen=True, slots=True)
class MessageColumns:
    """A part of the messages of a topic, in the order of their log times.

    Args:
        topic: its name.
        message_type: such as `nav_msgs/msg/Odometry`.
        log_times: the time of recording of each message, in nanoseconds since the epoch; of
            shape (n,).
        stamps: the stamp of the header of each message in nanoseconds, 0 where it is unset; without
            a header, the time at which it was sent; of shape (n,). None if neither is known.
        values: the values by the path of the field, such as `pose.pose.position.z`; of shape (n,).
            Numbers keep their type, texts are objects.
        positions: the number of each message among all messages that are read, in the order of
            their log times; of shape (n,).
        absent: for each path of a field, the messages without this field, by their number in this
            part, with the reason, such as `'ranges' has 3 elements, not one at [5]`.
    """

    topic: str
    message_type: str
    log_times: NDArray[np.int64]
    stamps: NDArray[np.int64] | None
    values: Mapping[str, NDArray[np.generic]]
    positions: NDArray[np.int64]
    absent: Mapping[str, Mapping[int, str]] = field(default_factory=dict)

    def rows(self, found: NDArray[np.bool_]) -> MessageColumns:
        """Return the messages for which a vector of shape (n,) is True."""
        return replace(
            self,
            log_times=self.log_times[found],
            stamps=None if self.stamps is None else self.stamps[found],
            values={path: column[found] for path, column in self.values.items()},
            positions=self.positions[found],
            absent=absent_rows(self.absent, found),
        )


def absent_rows(
    absent: Mapping[str, Mapping[int, str]], found: NDArray[np.bool_]
) -> dict[str, dict[int, str]]:
    """Return the reasons for absent fields, by the new numbers of the messages that are kept."""
    numbers = {row: number for number, row in enumerate(np.flatnonzero(found).tolist())}
    return {
        path: {numbers[row]: reason for row, reason in rows.items() if row in numbers}
        for path, rows in absent.items()
    }


@dataclass(frozen=True, slots=True)
class TopicContent:
    """The messages of a topic; if it changes its type, only messages of the first one.

    Args:
        message_type: such as `nav_msgs/msg/Odometry`.
        fields: the paths to the single values with their types, see `dyknow_common.field_paths`;
            None if they cannot be read.
        has_stamp: True if the messages have a stamp.
        count: the number of messages, of all types.
        publishers: their number when the recording began; None if it is unknown.
        has_sent_times: True if messages without a stamp are valid from their time of sending, False
            if from their time of recording.
        is_kept: True if its publishers kept messages for late subscribers.
    """

    message_type: str
    fields: Mapping[str, ValueType] | None
    has_stamp: bool
    count: int
    publishers: int | None = None
    has_sent_times: bool = False
    is_kept: bool = False
