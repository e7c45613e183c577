"""One state stream of a formula group, from its creation to its destruction."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from dyknow_interfaces.msg import ConstraintViolation

from dyknow_common import ExitCode, StreamConstraints
from dyknow_common.ros import VIOLATIONS, PublisherWatch, only_from, only_publishers_of
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.ros.context import CoordinatorContext


class StateStream:
    """A state stream, monitored for violations and for the loss of its engine.

    Args:
        name: unique in the system.
        on_violation: called for each violation in the stream or its origins.
        on_lost: called when the engine that makes the stream has died.
    """

    def __init__(
        self,
        context: CoordinatorContext,
        name: str,
        on_violation: Callable[[StateStream, Any], None],
        on_lost: Callable[[StateStream], None],
    ) -> None:
        self.name = name
        self.topic = context.state_topic(name)
        self.created_at_s = context.wall_time_s()
        self._context = context
        self._on_violation = on_violation
        self._on_lost = on_lost
        self._subscription: Any = None
        self._watch: PublisherWatch | None = None
        self._is_created = False
        self._is_destroyed = False

    async def create(
        self, specification: str, constraints: StreamConstraints, sources: Mapping[str, int]
    ) -> bool:
        """Create the stream (steps 9 to 11); return True if it has the expected topic.

        Args:
            specification: of the stream.
            constraints: added to those of the specification.
            sources: the ids of the streams that it is made from, by their topics.

        Raises:
            DyKnowError: if it cannot be created, or was destroyed before that.
        """
        self._check_is_needed()
        self._context.cleanup.keep_stream(self.name)
        try:
            topic, violations = await self._context.clients.create_stream(
                self.name, specification, constraints, sources
            )
        finally:
            self._is_created = True
            if self._is_destroyed:
                self.destroy()
        expected, self.topic = self.topic, topic
        if not self._is_destroyed:
            self._subscribe(violations)
        return topic == expected

    def destroy(self) -> None:
        """Destroy the stream; if it is being created, after that.

        A request to destroy it might overtake the one to create it.
        """
        self._is_destroyed = True
        if self._watch is not None:
            self._watch.stop()
            self._context.node.destroy_subscription(self._subscription)
            self._watch = self._subscription = None
        if self._is_created:
            self._is_created = False
            self._context.cleanup.destroy_stream(self.name)

    def _check_is_needed(self) -> None:
        if self._is_destroyed:
            text = f"stream '{self.name}' is not needed any more"
            raise CoordinationError(text, ExitCode.CANCELLED)

    def _subscribe(self, violations: str) -> None:
        self._subscription = self._context.node.create_subscription(
            ConstraintViolation,
            violations,
            lambda violation: self._on_violation(self, violation),
            VIOLATIONS,
            callback_group=self._context.node.reentrant,
            refusal=self._refusal,
        )
        self._watch = PublisherWatch(
            self._context.node.heartbeats, violations, lambda: self._on_lost(self)
        )

    def _refusal(self, topic: str, sender: str) -> str:
        """Refuse violations that are not of the engine which makes the stream."""
        known = self._context.streams.known.get(self.name)
        if known is not None and known.engine:
            return only_from(known.engine)(topic, sender)
        return only_publishers_of(self._context.node, self.topic)(topic, sender)
