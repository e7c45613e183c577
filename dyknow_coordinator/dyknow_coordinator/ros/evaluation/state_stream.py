"""One state stream of a formula group, from its creation to its destruction."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from dyknow_interfaces.msg import ConstraintViolation

from dyknow_common import DyKnowError, ExitCode, StreamConstraints
from dyknow_common.ros import (
    VIOLATIONS,
    PublisherWatch,
    from_message,
    only_from,
    only_publishers_of,
)
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.feature_sources import FeatureSource
from dyknow_coordinator.grounding.state_specification import state_specification
from dyknow_coordinator.ros.context import CoordinatorContext
from dyknow_stream_processing import Violation

SETTLING_S: Final = 0.5
"""Time within which the stream manager reports which streams have replaced others."""

POLL_PERIOD_S: Final = 0.1


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
        on_violation: Callable[[StateStream, Violation], None],
        on_lost: Callable[[StateStream], None],
    ) -> None:
        self.name = name
        self.topic = context.state_topic(name)
        self.chosen: tuple[FeatureSource, ...] = ()
        """The sources that it is made from."""
        self.sources: Mapping[str, int] = {}
        """The ids of the streams of the sources, by their topics."""
        self.created_at_s = context.wall_time_s()
        self._context = context
        self._on_violation = on_violation
        self._on_lost = on_lost
        self._subscription: Any = None
        self._watch: PublisherWatch | None = None
        self._is_created = False
        self._is_destroyed = False

    async def create(
        self, chosen: tuple[FeatureSource, ...], constraints: StreamConstraints
    ) -> bool:
        """Create the stream (steps 9 to 11); return True if it has the expected topic.

        Args:
            chosen: the sources that it is made from.
            constraints: added to the sources' own.

        Raises:
            DyKnowError: if it cannot be created, or was destroyed before that.
        """
        self._check_is_needed()
        self.chosen = chosen
        self.sources = await self._identities(chosen)
        try:
            return await self._create(chosen, constraints)
        except DyKnowError as error:
            # The stream manager may know by now that one of them is another stream.
            if error.code is not ExitCode.UNAVAILABLE or not self.sources:
                raise
            self.sources = await self._identities(chosen, error)
            return await self._create(chosen, constraints)

    async def _identities(
        self, chosen: tuple[FeatureSource, ...], refusal: DyKnowError | None = None
    ) -> Mapping[str, int]:
        """Return the ids of the sources, once the stream manager is certain of them.

        If the present ids were refused, wait for other ones.

        Raises:
            DyKnowError: the refusal, or the reason why an id is unknown, after SETTLING_S.
        """
        deadlines = self._context.node.deadlines
        limit = deadlines.after(SETTLING_S)
        while True:
            reason = refusal
            try:
                sources = self._context.streams.known.identities(chosen)
            except CoordinationError as error:
                reason = error
            else:
                if refusal is None or sources != self.sources:
                    limit.cancel()
                    return sources
            if reason is not None and (limit.done() or self._is_destroyed):
                raise reason
            await deadlines.after(POLL_PERIOD_S)

    async def _create(
        self, chosen: tuple[FeatureSource, ...], constraints: StreamConstraints
    ) -> bool:
        self._check_is_needed()
        self._context.cleanup.keep_stream(self.name)
        try:
            topic, violations = await self._context.clients.create_stream(
                self.name, state_specification(chosen), constraints, self.sources
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

        Otherwise the request to destroy it might overtake the request to create it.
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
            lambda message: self._on_violation(self, from_message(Violation, message)),
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
