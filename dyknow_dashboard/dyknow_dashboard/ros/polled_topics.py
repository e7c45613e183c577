"""Topics whose messages a timer takes: the states of formulas, and the positions of objects.

A formula may have fifty states a second, and all are read of those that signals are kept of, so
states are taken many at a time, as bytes. A callback for each message, and rclpy's objects for its
fields, take five times as long. Positions are taken likewise: a single one may decide a formula.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final

from dyknow_interfaces.msg import Sample
from rclpy.callback_groups import CallbackGroup

from dyknow_common import DyKnowError
from dyknow_common.ros import NO_SUBSCRIPTION_EVENTS, STREAM, NodeAdapter, ros_errors
from dyknow_configuration import PositionFields
from dyknow_dashboard.model.board import State
from dyknow_dashboard.model.live_map import Position
from dyknow_stream_processing.ros import (
    SampleReader,
    extractor,
    find_publication,
    message_class,
    take_waiting,
    valid_time_reader,
)

PERIOD_S: Final = 0.2
"""The time between two looks at the topics; the middleware keeps up to 1000 states."""

MAX_WAITING: Final = 10
"""The positions of an object that the middleware keeps meanwhile: 50 a second."""


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
        on_states: called with the states that have come, those of a topic in their order.
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
                        Sample,
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


class PositionTopics:
    """Subscriptions to the topics of positions, which a timer reads.

    Args:
        adapter: of the node that reads; its methods are called in the thread of its executor.
        on_positions: called with the positions that have come.
    """

    def __init__(
        self, adapter: NodeAdapter, on_positions: Callable[[list[Position]], None]
    ) -> None:
        self._node = adapter.node
        self._on_positions = on_positions
        self._group = _NeverCalled()
        self._topics: dict[str, tuple[Any, Callable[[Any], Iterator[Position]]]] = {}
        """The subscription of each object, and a function that reads its messages."""
        adapter.create_timer(PERIOD_S, self._read, clock=adapter.wall_clock)

    def read(self, positions: Mapping[str, PositionFields]) -> None:
        """Read the positions of these objects from now on, and no others.

        A topic that is not published yet, or cannot be read, is tried again at the next call.
        """
        for name in self._topics.keys() - positions.keys():
            self._node.destroy_subscription(self._topics.pop(name)[0])
        for name in positions.keys() - self._topics.keys():
            with suppress(DyKnowError), ros_errors():
                self._subscribe(name, *positions[name])

    def _subscribe(self, name: str, topic: str, *axes: str) -> None:
        publication = find_publication(self._node, topic)
        if publication is None:
            return
        class_, quality = message_class(publication.type_name), publication.quality_of_service
        quality.depth = MAX_WAITING
        read_fields, read_time = extractor(class_, axes), valid_time_reader(class_)

        def read(message: Any) -> Iterator[Position]:
            x, y = map(read_fields(message).get, axes)
            if isinstance(x, float) and isinstance(y, float):
                now = self._node.get_clock().now().nanoseconds
                yield name, read_time(message) if read_time else now, x, y

        subscription = self._node.create_subscription(
            class_,
            topic,
            lambda _: None,
            quality,
            callback_group=self._group,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
        )
        self._topics[name] = subscription, read

    def _read(self) -> None:
        found = [
            position
            for subscription, read in self._topics.values()
            for message, _ in take_waiting(subscription)
            for position in read(message)
        ]
        if found:
            self._on_positions(found)
