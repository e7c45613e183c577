"""Contents of the messages of a recorded topic."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dyknow_common import ValueType


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
        has_sent_times: True if messages without a stamp are valid from the time at which they were
            sent, False if from that of their recording.
        is_kept: True if its publishers kept messages for late subscribers.
    """

    message_type: str
    fields: Mapping[str, ValueType] | None
    has_stamp: bool
    count: int
    publishers: int | None = None
    has_sent_times: bool = False
    is_kept: bool = False
