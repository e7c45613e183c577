"""What pages draw: the states of formulas, and the streams of maps.

A formula may have fifty states a second. If its signals are kept, all states are read, so they are
taken many at a time, as bytes. A callback for each message, and rclpy's objects for its fields,
would take five times as long.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

from dyknow_interfaces.msg import Sample as SampleMessage
from rclpy.callback_groups import CallbackGroup

from dyknow_common import NO_CONSTRAINTS, DyKnowError
from dyknow_common.ros import NO_SUBSCRIPTION_EVENTS, STREAM, NodeAdapter, ros_errors
from dyknow_dashboard.model.board import State
from dyknow_dashboard.model.live_map import MapSample
from dyknow_stream_processing import Dataflow, Sample, load_units, parse_specification
from dyknow_stream_processing.ros import SampleReader, TopicSources, source_type, take_waiting

PERIOD_S: Final = 0.2
"""The time between two looks at the topics; the middleware keeps up to 1000 states."""


class _NeverCalled(CallbackGroup):
    """The group of subscriptions that no executor waits for."""

    def can_execute(self, _entity: Any) -> bool:
        return False

    def beginning_execution(self, _entity: Any) -> bool:
        return False


@dataclass(slots=True)
class _StateTopic:
    subscription: Any
    reader: SampleReader = field(default_factory=SampleReader)


class StateTopics:
    """Subscriptions to topics of states, which a timer reads.

    Args:
        adapter: of the node that reads; its methods are called in the thread of its executor.
        on_states: called with the states that have come; states of one topic are in their order.
    """

    def __init__(self, adapter: NodeAdapter, on_states: Callable[[list[State]], None]) -> None:
        self._node = adapter.node
        self._on_states = on_states
        self._group = _NeverCalled()
        self._topics: dict[str, _StateTopic] = {}
        adapter.create_timer(PERIOD_S, self._read, clock=adapter.wall_clock)

    def read(self, topics: frozenset[str]) -> None:
        """Read these topics from now on, and no others."""
        for topic in self._topics.keys() - topics:
            self._node.destroy_subscription(self._topics.pop(topic).subscription)
        for topic in topics - self._topics.keys():
            # A report may name a topic that cannot exist: there is nothing to show of it.
            with suppress(DyKnowError), ros_errors():
                self._topics[topic] = _StateTopic(
                    self._node.create_subscription(
                        SampleMessage,
                        topic,
                        lambda _: None,
                        STREAM,
                        callback_group=self._group,
                        event_callbacks=NO_SUBSCRIPTION_EVENTS,
                        raw=True,
                    )
                )

    def _read(self) -> None:
        if states := [each for topic in self._topics for each in self._states(topic)]:
            self._on_states(states)

    def _states(self, topic: str) -> Iterator[State]:
        held = self._topics[topic]
        for data, _ in take_waiting(held.subscription):
            # The reasoning engine has reported a state that cannot be used.
            with suppress(DyKnowError):
                yield (topic, *held.reader.read(data))


class MapStreams:
    """The streams of maps, which the node itself makes of topics and transforms.

    Args:
        adapter: of the node that reads; its methods are called in the thread of its executor.
        on_samples: called with the samples that have come.
    """

    def __init__(self, adapter: NodeAdapter, on_samples: Callable[[list[MapSample]], None]) -> None:
        self._on_samples = on_samples
        source = partial(source_type, adapter.node)
        self._dataflow = Dataflow.of_any_time(load_units(), source)
        self._sources = TopicSources(adapter.node, self._dataflow)
        self._found: list[MapSample] = []
        adapter.create_timer(PERIOD_S, self._deliver, clock=adapter.wall_clock)

    def read(self, streams: Mapping[str, str]) -> None:
        """Make only these streams from now on, given their texts by name."""
        made = {*self._dataflow.names()}
        if made == streams.keys():
            return
        for name in made - streams.keys():
            self._dataflow.destroy(name)
        for name in streams.keys() - made:
            # There is nothing to show of an object whose stream cannot be made.
            with suppress(DyKnowError):
                take, specification = partial(self._take, name), parse_specification(streams[name])
                self._dataflow.create(name, specification, NO_CONSTRAINTS, take)
        with suppress(DyKnowError), ros_errors():
            self._sources.refresh()

    def _take(self, name: str, sample: Sample) -> None:
        self._found.append((name, sample.valid_time, sample.fields))

    def _deliver(self) -> None:
        if self._found:
            found, self._found = self._found, []
            self._on_samples(found)
