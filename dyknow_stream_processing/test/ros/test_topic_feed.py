"""What a topic's watermarks say of its samples."""

from __future__ import annotations

from typing import Any, cast

import pytest
from dyknow_interfaces.msg import StreamWatermark

from dyknow_stream_processing.dataflow.received import PATIENCE, SPACING
from dyknow_stream_processing.ros.topics import topic_feed
from dyknow_stream_processing.ros.topics.topic_feed import TopicFeed

ID = 7


class Busy:
    """The topics of a node that has not processed all that it has received."""

    def catch_up(self, _now: int) -> bool:
        return False


class Idle:
    """The topics of a node that has."""

    def catch_up(self, _now: int) -> bool:
        return True


class Listener:
    """Notes what is lost."""

    def __init__(self) -> None:
        self.lost: list[tuple[str, int]] = []

    def on_dropped(self, reason: str, count: int) -> None:
        self.lost.append((reason, count))

    def on_watermark(self, watermark: int, now: int) -> None:
        """Do nothing."""


@pytest.mark.parametrize(('topics', 'lost'), [(Busy(), []), (Idle(), [('lost', 3)])])
def test_samples_that_wait_in_a_busy_node_are_not_lost(
    monkeypatch: pytest.MonkeyPatch, topics: Any, lost: list[tuple[str, int]]
) -> None:
    """They may be among the messages that it has received, and not processed."""
    times = iter(range(0, 4 * PATIENCE * SPACING, SPACING))
    monkeypatch.setattr(topic_feed, 'monotonic_ns', lambda: next(times))
    listener, node = Listener(), cast('Any', None)
    feed = TopicFeed(topics, node, '/far', None, None, (cast('Any', listener),))
    feed.watermarks.note_sample(ID, 1, now=0)
    for _ in range(PATIENCE):
        feed.vouch(StreamWatermark(stream_id=ID, number=4), 0)
    assert listener.lost == lost
