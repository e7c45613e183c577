"""Topics as sources of a dataflow, without ROS."""

from __future__ import annotations

from unittest import mock

import pytest

from dyknow_stream_processing.ros.topics import topic_sources
from dyknow_stream_processing.ros.topics.topic_sources import TopicSources


@pytest.mark.parametrize('is_simulated', [False, True])
def test_streams_restart_once_the_clock_of_the_host_was_set_back(is_simulated: bool) -> None:  # noqa: FBT001
    """ROS tells jumps of simulated time alone."""
    dataflow, node = mock.MagicMock(), mock.MagicMock()
    dataflow.sources.return_value, dataflow.next_deadline.return_value = {}, None
    with mock.patch.object(topic_sources, 'NodeTopics') as topics:
        topics.of.return_value.is_time_simulated = is_simulated
        sources = TopicSources(node, dataflow)
    for now in (100, 101, 41, 42):
        node.get_clock.return_value.now.return_value.nanoseconds = now
        sources.end_period(now * 10**9)
    told = [call.args[0].message for call in dataflow.restart.call_args_list]
    text = 'the clock was set back by 60 s; all streams restart'
    assert told == ([] if is_simulated else [text])
