"""Topics as sources of a dataflow, without ROS."""

from __future__ import annotations

from collections.abc import Callable
from unittest import mock

import pytest

from dyknow_common import NANOSECONDS, SECOND_NS
from dyknow_stream_processing.ros.topics import node_topics
from dyknow_stream_processing.ros.topics.node_topics import NodeTopics
from dyknow_stream_processing.ros.topics.topic_feed import ReceivedMessage
from dyknow_stream_processing.ros.topics.topic_sources import TopicSources

MS = NANOSECONDS['ms']
BEGIN = 1_000 * SECOND_NS


class Clocks:
    """The clocks of a host and of a node on it; reading one takes a while."""

    def __init__(self) -> None:
        self.steady, self.ahead = 100 * SECOND_NS, BEGIN
        self.reading = iter(range(0))
        """The times that the next reads take."""

    def monotonic_ns(self) -> int:
        self.steady += next(self.reading, 0)
        return self.steady

    @property
    def nanoseconds(self) -> int:
        return self.monotonic_ns() + self.ahead


def look(topics: NodeTopics, now: int) -> None:
    topics.catch_up(now)


def receive(topics: NodeTopics, now: int) -> None:
    topics.process(ReceivedMessage(mock.MagicMock(), None, None, now, 0), now)


def watch(topics: NodeTopics, _now: int) -> None:
    topics._watch()


@pytest.mark.parametrize('notice', [look, receive, watch])
@pytest.mark.parametrize(
    ('changes', 'told'),
    [
        ([0, -500 * MS, 0], ['500 ms']),
        ([0, -60 * SECOND_NS, 0, -20 * MS], ['60 s', '20 ms']),
        ([0, 5 * SECOND_NS, -4 * SECOND_NS], ['4 s']),
        ([-9 * MS, 9 * MS, -9 * MS], []),
    ],
)
@pytest.mark.parametrize('is_simulated', [False, True])
def test_streams_restart_once_the_clock_of_the_host_was_set_back(
    notice: Callable[[NodeTopics, int], None],
    changes: list[int],
    told: list[str],
    is_simulated: bool,  # noqa: FBT001
) -> None:
    """ROS tells jumps of simulated time alone."""
    dataflow, node, clocks = mock.MagicMock(), mock.MagicMock(), Clocks()
    dataflow.sources.return_value, dataflow.next_deadline.return_value = {}, None
    node.get_clock.return_value.now.return_value = clocks
    node.get_clock.return_value.ros_time_is_active = is_simulated
    with mock.patch.object(node_topics, 'time', clocks):
        sources, topics = TopicSources(node, dataflow), NodeTopics.of(node)
        for change in [0, *changes]:
            clocks.steady += SECOND_NS
            clocks.ahead += change
            # Other threads may run between two reads of the clocks.
            for durations in ([50 * MS, 0, 30 * MS], [], [50 * MS, 0, 30 * MS]):
                now = clocks.nanoseconds
                clocks.reading = iter(durations if change > -100 * MS else [])
                notice(topics, now)
                clocks.reading = iter(range(0))
    reports = [call.args[0].message for call in dataflow.restart.call_args_list]
    texts = [f'the clock was set back by {each}; all streams restart' for each in told]
    assert reports == ([] if is_simulated else texts)
    sources.destroy()
    node.get_clock.return_value.create_jump_callback.assert_called_once()


def test_the_graph_is_read_for_new_topics_and_periodically() -> None:
    """With thousands of topics, that takes longer than all else."""
    node = mock.MagicMock(resolve_topic_name=lambda topic: topic)
    node.get_clock.return_value.now.return_value = Clocks()
    node.get_publishers_info_by_topic.return_value = []
    topics, read = NodeTopics.of(node), node.get_publishers_info_by_topic

    def topics_read(refresh: Callable[[], None]) -> list[str]:
        read.reset_mock()
        refresh()
        return [call.args[0] for call in read.call_args_list]

    for topic in ('/a', '/b'):
        topics.listen(topic, mock.MagicMock())
        assert topics_read(topics.refresh) == [topic]
    topics.listen('/a', mock.MagicMock())
    assert topics_read(topics.refresh) == ['/a']
    assert topics_read(topics._watch) == ['/a', '/b']
