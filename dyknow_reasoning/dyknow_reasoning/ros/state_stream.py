"""A stream of states that a formula group is progressed over, and what breaks in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

from dyknow_interfaces.msg import ConstraintViolation, Sample
from rclpy.exceptions import InvalidTopicNameException
from rclpy.validate_topic_name import validate_topic_name

from dyknow_reasoning import ReasoningError
from dyknow_stream_processing import ExitCode
from dyknow_stream_processing.ros import (
    NO_SUBSCRIPTION_EVENTS,
    STREAM,
    VIOLATIONS,
    DyKnowNode,
    time_to_nanoseconds,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping


@dataclass(frozen=True, slots=True)
class State:
    """A state as it came.

    Args:
        valid_time: in nanoseconds.
        message: the `Sample`.
        lost: says so if states before it were lost.
    """

    valid_time: int
    message: Any
    lost: ReasoningError | None


@dataclass(frozen=True, slots=True)
class Breach:
    """A violation of a constraint of a stream of states.

    Args:
        valid_time: of what broke the constraint, in nanoseconds.
        message: says what was broken.
    """

    valid_time: int
    message: str


class StateStream:
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
        on_state: Callable[[StateStream, State], None],
        on_breach: Callable[[StateStream, Breach], None],
    ) -> None:
        self.topic = topic
        self.breach: Breach | None = None
        self._node = node
        self._on_state = on_state
        self._on_breach = on_breach
        self._begun = node.now()
        self._next_number: int | None = None
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
        lost = self._states_lost(info.get('publication_sequence_number'))
        self._on_state(self, State(time_to_nanoseconds(message.valid_time), message, lost))

    def _violated(self, message: Any) -> None:
        # The topic is latched: what was broken before anybody here cared is kept in it.
        if time_to_nanoseconds(message.available_time) >= self._begun:
            self.breach = Breach(time_to_nanoseconds(message.valid_time), message.message)
            self._on_breach(self, self.breach)

    def _states_lost(self, number: int | None) -> ReasoningError | None:
        """A verdict would be a guess if a state were missing, or came from another publisher."""
        if number is None:
            return None  # Not all middleware numbers its messages.
        expected, self._next_number = self._next_number, number + 1
        if expected in {None, number}:
            return None
        return ReasoningError(
            f'states were lost: number {expected} of the state stream should have come, and '
            f'number {number} came',
            ExitCode.UNAVAILABLE,
        )


def check_topic(field: str, topic: str) -> None:
    """Asserts that a topic has a valid name.

    Raises:
        ReasoningError: if it has not; names the field of the request.
    """
    try:
        validate_topic_name(topic)
    except InvalidTopicNameException as error:
        raise ReasoningError(f'{field}: {error}') from None
