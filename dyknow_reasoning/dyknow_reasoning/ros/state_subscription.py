"""A stream of states that a formula group is progressed over, and what breaks in it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

from dyknow_interfaces.msg import ConstraintViolation, Sample
from rclpy.exceptions import InvalidTopicNameException
from rclpy.validate_topic_name import validate_topic_name

from dyknow_common.ros import (
    NO_SUBSCRIPTION_EVENTS,
    STREAM,
    VIOLATIONS,
    DyKnowNode,
    time_to_nanoseconds,
)
from dyknow_reasoning.errors import ReasoningError
from dyknow_stream_processing.ros import SequenceGaps, publishers_of


@dataclass(frozen=True, slots=True)
class State:
    """A state as it came.

    Args:
        valid_time: in nanoseconds.
        message: the `Sample`.
        lost: says so if states before it may be missing; empty otherwise.
    """

    valid_time: int
    message: Any
    lost: str


@dataclass(frozen=True, slots=True)
class Breach:
    """A violation of a constraint of a stream of states.

    Args:
        valid_time: of what broke the constraint, in nanoseconds.
        message: says what was broken.
    """

    valid_time: int
    message: str


class StateSubscription:
    """Listens to states, and to violations on the topic that belongs to theirs.

    Args:
        topic: that of the states.
        on_state: is told each state, and by which stream.
        on_breach: is told each violation, and by which stream.
    """

    def __init__(
        self,
        node: DyKnowNode,
        topic: str,
        on_state: Callable[[StateSubscription, State], None],
        on_breach: Callable[[StateSubscription, Breach], None],
    ) -> None:
        self.topic = topic
        self.breach: Breach | None = None
        self._node = node
        self._on_state = on_state
        self._on_breach = on_breach
        self._begun = node.now()
        self._numbering = SequenceGaps(lambda: publishers_of(node, topic), self._missed)
        self._lost = ''
        # The first one is served first where both have messages: no state is taken that comes
        # after a violation.
        self._violations = node.create_subscription(
            ConstraintViolation,
            f'{topic}/violations',
            self._violated,
            VIOLATIONS,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
        )
        self._states = node.create_subscription(
            Sample,
            topic,
            # rclpy is typed as if no callback could ask for the message's info.
            cast('Any', self._receive),
            STREAM,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
        )

    def destroy(self) -> None:
        """Stops listening."""
        self._node.destroy_subscription(self._states)
        self._node.destroy_subscription(self._violations)

    def _receive(self, message: Any, info: Mapping[str, int | None]) -> None:
        self._lost = ''
        self._numbering.note(info.get('publication_sequence_number'))
        self._on_state(self, State(time_to_nanoseconds(message.valid_time), message, self._lost))

    def _missed(self, count: int) -> None:
        self._lost = f'{count} states were lost' if count else 'the stream of states was made anew'

    def _violated(self, message: Any) -> None:
        # The topic is latched: what was broken before anybody here cared is kept in it.
        if time_to_nanoseconds(message.available_time) >= self._begun:
            self.breach = Breach(time_to_nanoseconds(message.valid_time), message.message)
            self._on_breach(self, self.breach)


def check_topic(field: str, topic: str) -> None:
    """Asserts that a topic has a valid name.

    Raises:
        ReasoningError: if it has not; names the field of the request.
    """
    try:
        validate_topic_name(topic)
    except InvalidTopicNameException as error:
        raise ReasoningError(f'{field}: {error}') from None
