"""Topics as they were observed, live or in a recording."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import ValueType, listed
from dyknow_configuration.proposals.message_types import proposals_of
from dyknow_configuration.proposals.timing import TopicTimes

MAX_MESSAGES: Final = 1_000_000
"""The number of messages of a topic that are measured: the first observed messages."""

MAX_TEXTS_SEEN: Final = 100
"""The number of different texts in a field that are kept."""

FRAME: Final = 'header.frame_id'
"""The field that names the frame of a message."""

_COORDINATE: Final = re.compile(r'(?:.*\.)?(?:position|translation|point)\.[xyz]')

ReadFields = Callable[[str, Mapping[str, ValueType] | None], Collection[str]]
"""Returns the fields whose values are wanted, given a message type with its fields."""


@dataclass(slots=True)
class SeenValues:
    """The values of a field that were seen.

    Args:
        least: the least number; None if there was none.
        greatest: the greatest number.
        has_nan: True if there was NaN.
        texts: at most MAX_TEXTS_SEEN different texts.
    """

    least: float | None = None
    greatest: float | None = None
    has_nan: bool = False
    texts: set[str] = field(default_factory=set)

    def add_array(self, values: NDArray[np.generic]) -> None:
        """Add the values of an array: a few stand for all of its numbers."""
        if not len(values) or values.dtype == np.object_:
            self.add(values.tolist())
            return
        missing = np.isnan(values) if values.dtype.kind == 'f' else np.zeros(len(values), np.bool_)
        self.has_nan |= bool(missing.any())
        present = values[~missing]
        if len(present):
            self.add([present.min().item(), present.max().item()])

    def add(self, values: Iterable[Any]) -> None:
        """Add values: numbers, booleans or texts."""
        for value in values:
            if isinstance(value, str):
                if len(self.texts) < MAX_TEXTS_SEEN:
                    self.texts.add(value)
            elif math.isnan(value):
                self.has_nan = True
            else:
                self.least = value if self.least is None else min(self.least, value)
                self.greatest = value if self.greatest is None else max(self.greatest, value)


@dataclass(frozen=True, slots=True)
class ObservedTopic:
    """A topic and its messages in some time.

    Args:
        name: the absolute name.
        message_type: such as `nav_msgs/msg/Odometry`.
        fields: the fields of the messages with their types, see `dyknow_common.field_paths`; None
            if they are not known.
        times: the times of the messages.
        values: the values of the fields that were read, by their paths.
        publishers: the number of publishers; None if it is unknown, as in a recording.
        absent: the requested fields that no message had, with the reasons.
    """

    name: str
    message_type: str
    fields: Mapping[str, ValueType] | None
    times: TopicTimes
    values: Mapping[str, SeenValues] = field(default_factory=dict)
    publishers: int | None = None
    absent: Mapping[str, str] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """The number of messages."""
        return len(self.times.receipt_times)


def fields_of_interest(
    message_type: str, fields: Mapping[str, ValueType] | None
) -> tuple[str, ...]:
    """Return the fields of a message type whose values proposals are made from."""
    proposals = proposals_of(message_type, fields)
    found = dict.fromkeys(path for each in proposals for path in each.read_fields)
    has_frame = FRAME in (fields or ()) and any(map(is_coordinate, found))
    return (*found, FRAME) if has_frame else tuple(found)


def is_coordinate(field: str) -> bool:
    """Return True if a field of a message is a coordinate of a position."""
    return _COORDINATE.fullmatch(field) is not None


def frames_of(topics: Iterable[ObservedTopic]) -> dict[str, list[str]]:
    """Return the frames that the messages of topics name, as far as these were read."""
    found = {
        each.name: sorted(each.values[FRAME].texts - {''})
        for each in topics
        if FRAME in each.values
    }
    return {name: frames for name, frames in found.items() if frames}


def frame_difference(frames: Mapping[str, Iterable[str]]) -> str:
    """Return how the frames of topics differ, with the mend; empty if they are not several."""
    if len({each for found in frames.values() for each in found}) <= 1:
        return ''
    named = [f'{name} is in {listed(frames[name])}' for name in sorted(frames)]
    return f'{"; ".join(named)}; let tf transform them, or publish them in one frame'
