"""Subscription to a state stream and to its violations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from dyknow_interfaces.msg import ConstraintViolation, Sample

from dyknow_common.ros import (
    STREAM,
    VIOLATIONS,
    DirectSubscription,
    DyKnowNode,
    TopicOwner,
    from_message,
)
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.state_line import Breach, ReadStream
from dyknow_stream_processing import OVERTAKEN, ReceivedViolations, Violation
from dyknow_stream_processing.ros import (
    SequenceGaps,
    publication_number,
    publishers_of,
    sample_valid_time,
    sample_violated_at,
)

VIOLATIONS_SUFFIX: Final = '/violations'
"""The end of the topic of the violations of a stream, after the topic of its samples."""


@dataclass(frozen=True, slots=True)
class State:
    """A received state.

    Args:
        valid_time: the valid time in nanoseconds.
        message: the Sample message, or the `Sample` itself if it comes from this process.
        loss: the reason why states before it may be missing; empty if there is none.
    """

    valid_time: int
    message: Any
    loss: str


class StateSubscription(ReadStream[State]):
    """Subscription to the states of one stream, and to its violations.

    The times of states are not compared with the clock: the engine that makes the states has
    checked the stamps that they are made from, and states of forecasts are ahead of the clock.

    Args:
        topic: the topic of the states.
        on_state: called with this subscription and each state.
        on_breach: called with this subscription and each violation.
    """

    def __init__(
        self,
        node: DyKnowNode,
        topic: str,
        on_state: Callable[[StateSubscription, State], None],
        on_breach: Callable[[StateSubscription, Breach], None],
    ) -> None:
        super().__init__()
        self.topic = topic
        self._on_state = on_state
        self._on_breach = on_breach
        self._received = ReceivedViolations(node.now())
        self._sequence = SequenceGaps(lambda: publishers_of(node, topic), self._on_loss)
        self._loss = ''
        self._owner = TopicOwner(node.heartbeats, node.resolve_topic_name(topic))
        # If both have messages, the subscription that is created first is served first.
        self._violations = DirectSubscription(
            node,
            ConstraintViolation,
            f'{topic}{VIOLATIONS_SUFFIX}',
            self._on_violation,
            VIOLATIONS,
            self._owner.refusal,
        )
        self._states = DirectSubscription(
            node, Sample, topic, self._on_sample, STREAM, self._owner.refusal
        )

    def destroy(self) -> None:
        """End both subscriptions."""
        self._owner.stop()
        self._states.destroy()
        self._violations.destroy()

    def _on_sample(self, message: Any, info: Mapping[str, int | None]) -> None:
        valid_time = sample_valid_time(message)
        if valid_time < 0:
            # The next state reveals by its sequence number that this one is missing.
            raise ReasoningError('its valid time is before 1970')
        self._violations.retry()
        if self._received.note_sample(sample_violated_at(message)):
            self._break(Breach(valid_time, f"state stream '{self.topic}': {OVERTAKEN}"))
        self._loss = ''
        self._sequence.note(publication_number(message, info))
        self._on_state(self, State(valid_time, message, self._loss))

    def _on_loss(self, count: int) -> None:
        self._loss = f'{count} states were lost' if count else 'the state stream was recreated'

    def _on_violation(self, message: Any, _info: object) -> None:
        # The topic is latched: violations before the subscription are ignored.
        violation = from_message(Violation, message)
        if self._received.note(violation.available_time):
            self.doubt(violation.doubtful_from)
            self._break(Breach(violation.valid_time, violation.message))

    def _break(self, breach: Breach) -> None:
        self.breach = breach
        self._on_breach(self, breach)
