"""What the times of a node's clock say of the topics that it reads."""

from __future__ import annotations

from unittest.mock import MagicMock

import pytest

from dyknow_stream_processing.ros.topics.waiting_streams import ClockWatch


@pytest.mark.parametrize(
    ('times', 'since', 'reason'),
    [
        ([10, 11, 12, 13, 14], 11, ''),
        ([10, 11, 12, 13, 5], 5, ''),
        ([9, 9, 9, 9, 9], 9, 'simulated time stands still: /clock has not advanced for 3 s'),
    ],
)
def test_topics_are_silent_since_a_time_that_is_not_ahead(
    times: list[int], since: int, reason: str
) -> None:
    """After a jump back, all topics seemed silent for some seconds."""
    node, (first, *later) = MagicMock(), times
    clock = node.get_clock.return_value.now.return_value
    clock.nanoseconds = first
    watch = ClockWatch(node)
    for time in later:
        clock.nanoseconds = time
        watch.end_period()
    assert (watch.since, watch.reason()) == (since, reason)
