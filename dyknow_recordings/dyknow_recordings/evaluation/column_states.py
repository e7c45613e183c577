"""States that are made as columns: many at once, by numpy.

A batch is processed as columns if nothing happens in it but states: no operator refuses its part,
no group is to be given other streams, and no topic is silent. Any other batch goes message by
message through the same operators.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Final

import numpy as np

from dyknow_common import SECOND_NS
from dyknow_recordings.evaluation.state_group import StateGroup
from dyknow_recordings.evaluation.states.standby import GroupStream
from dyknow_recordings.evaluation.streams import RecordedStreams
from dyknow_recordings.reading.columns import MessageColumns

MAX_STEP_NS: Final = 30 * SECOND_NS
"""The longest time without a message: after a longer one, the clock may have been stopped."""

_TopicParts = Mapping[str, Sequence[MessageColumns]]


class ColumnStates:
    """The states of groups, made as columns where that gives the same ones.

    Args:
        streams: of the recording.
        start: the log time at which it begins, in nanoseconds.
        silence_limit: the time without a message after which a topic is silent, in nanoseconds.
    """

    def __init__(self, streams: RecordedStreams, start: int, silence_limit: int) -> None:
        self._streams, self._start = streams, start
        self._silence_limit = silence_limit

    def progress(self, batch: Sequence[MessageColumns], groups: Sequence[StateGroup]) -> bool:
        """Progress groups over a batch; return False, without an effect, if that needs messages."""
        used = [group.group_streams for group in groups]
        times = np.sort(np.concatenate([part.log_times for part in batch]))
        before, end = max(self._start, self._streams.latest_receipt), int(times[-1])
        longest = max(int(times[0]) - before, int(np.diff(times).max(initial=0)))
        if not all(used) or longest > MAX_STEP_NS:
            return False
        parts: dict[str, list[MessageColumns]] = defaultdict(list)
        for part in batch:
            parts[part.topic].append(part)
        streams = list(chain(*used))
        if self._begins_others(streams, parts):
            return False
        if any(self._may_change(each, parts, end) for each in streams):
            return False
        states = self._streams.step_many(parts, end)
        if states is None:
            return False
        for each in streams:
            each.receive_many(states[each.name])
        return True

    def _begins_others(self, streams: Sequence[GroupStream], parts: _TopicParts) -> bool:
        """Return True if sources begin that may be better than those in use."""
        topics = {topic for each in streams for topic in self._streams.topics(each.name)}
        have_begun = all(map(self._streams.received_at, parts.keys() - topics))
        return not have_begun and any(each.is_replaceable for each in streams)

    def _may_change(self, state: GroupStream, parts: _TopicParts, end: int) -> bool:
        """Return True if a group may be given another stream, or fail, until a time."""
        if state.until is not None and end >= state.until:
            return True
        if not (state.is_replaceable or self._streams.is_regular(state.name)):
            return False
        for topic in self._streams.topics(state.name):
            latest = max(self._streams.received_at(topic), state.created_at)
            log_times = np.sort(
                np.concatenate(
                    [[latest], *(part.log_times for part in parts.get(topic, ())), [end]]
                )
            )
            if np.diff(log_times).max() > self._silence_limit:
                return True
        return False
