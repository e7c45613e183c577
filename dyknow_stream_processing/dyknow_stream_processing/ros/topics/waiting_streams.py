"""The streams of an engine that have no samples, and what they wait for."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Sequence
from typing import Final

from rclpy.node import Node

from dyknow_common import format_duration, with_readable_times
from dyknow_common.ros import DyKnowNode, LogOnce
from dyknow_stream_processing.dataflow.dataflow import Dataflow
from dyknow_stream_processing.dataflow.operators import NormalWait
from dyknow_stream_processing.reporting.silence import (
    MAX_LAG_NS,
    SILENT_PERIODS,
    ActivityMeter,
    joined_reasons,
)
from dyknow_stream_processing.reporting.stream_report import is_hidden
from dyknow_stream_processing.ros.topics.topic_sources import TopicSources

_MAX_LISTED: Final = 5
"""The number of streams that a warning names."""


class WaitingStreams:
    """Finds the reason why a stream has no samples, and warns of each reason once."""

    def __init__(self, node: DyKnowNode, dataflow: Dataflow, sources: TopicSources) -> None:
        self._node = node
        self._dataflow = dataflow
        self._sources = sources
        self._clock = ClockWatch(node)
        self._meters: dict[str, ActivityMeter] = {}
        self._topic_reasons: dict[str, str] = {}
        self._backlog = ''
        self._log = LogOnce()

    def add(self, name: str) -> None:
        """Watch a new stream."""
        self._meters[name] = ActivityMeter()

    def remove(self, name: str) -> None:
        """Watch a stream no more."""
        del self._meters[name]

    def end_period(self) -> None:
        """End a second of the wall clock, and warn of new reasons."""
        # Otherwise, a topic would be taken for silent whose messages wait for this node.
        lag = self._node.now() - self._sources.processed_until()
        self._backlog = self._lag_reason() if lag > MAX_LAG_NS else ''
        self._clock.end_period()
        self._topic_reasons.clear()
        waiting: defaultdict[str, list[str]] = defaultdict(list)
        for name, meter in self._meters.items():
            meter.measure(self._dataflow.statistics(name).samples)
            if meter.is_overdue:
                for reason in self._reasons(name):
                    waiting[reason].append(name)
        for reason in self._log.new(waiting):
            self._report(reason, waiting[reason])

    def _report(self, reason: str, names: Sequence[str]) -> None:
        visible = [each for each in names if not is_hidden(each)]
        shown = visible or names
        more = ', ...' if len(shown) > _MAX_LISTED else ''
        text = f'{with_readable_times(reason)}; this delays: {", ".join(shown[:_MAX_LISTED])}{more}'
        if visible and not isinstance(reason, NormalWait):
            self._node.get_logger().warning(text)
        else:
            # The coordinator warns of the formulas that no state comes for.
            self._node.get_logger().info(text)

    def reason(self, name: str) -> str:
        """Return what a stream waits for; empty while it has samples."""
        return joined_reasons(self._reasons(name))

    def _reasons(self, name: str) -> tuple[str, ...]:
        samples = self._dataflow.statistics(name).samples
        if not self._meters[name].is_silent(samples):
            return ()
        if self._backlog:
            return (self._backlog,)
        clock = self._clock.reason()
        found = self._dataflow.waits_for(name, self._clock.since, self._topic_reason)
        reasons = tuple(filter(None, (clock, *found)))
        # A topic whose publishers keep their messages may be silent.
        return reasons if reasons or samples else ('no sample has come yet',)

    def _lag_reason(self) -> str:
        return (
            f'{self._node.get_fully_qualified_name()} has not run, or cannot keep up: it is more '
            f'than {format_duration(MAX_LAG_NS)} behind its topics'
        )

    def _topic_reason(self, topic: str) -> str:
        # The graph is asked once a second: many streams may be made of one topic.
        if topic not in self._topic_reasons:
            since = None if self._clock.reason() else self._clock.since
            self._topic_reasons[topic] = self._sources.reason(topic, since)
        return self._topic_reasons[topic]


class ClockWatch:
    """The times of a node's ROS clock at the last few seconds of the wall clock."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._times = deque([self._now()], maxlen=SILENT_PERIODS + 1)

    @property
    def since(self) -> int:
        """The time some seconds ago, or the earliest one if it was set back; nanoseconds."""
        return min(self._times)

    def end_period(self) -> None:
        """Note the time; called each second of the wall clock."""
        self._times.append(self._now())

    def reason(self) -> str:
        """Return why time does not pass; empty if it does."""
        if not self._node.get_parameter('use_sim_time').value:
            return ''
        now = self._now()
        if now == 0:
            if self._node.count_publishers('/clock'):
                return 'simulated time is 0: /clock has a publisher, but time has not started'
            return 'no /clock has come: nobody publishes it, but use_sim_time is true'
        if len(self._times) == self._times.maxlen and now == self._times[0]:
            return f'simulated time stands still: /clock has not advanced for {SILENT_PERIODS} s'
        return ''

    def _now(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)
