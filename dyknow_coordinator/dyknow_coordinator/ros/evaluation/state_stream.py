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

ARRIVAL_LIMIT_S: Final = 5.0
"""Time after which states do not arrive at the reasoning engine that an engine has made."""


class StateStream:
    """A state stream, monitored for violations, the loss of its engine, and states that get lost.

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
        self.created_at_s = self.arrived_at_s = context.wall_time_s()
        """When it was created; when its latest state arrived at the reasoning engine."""
        self._context = context
        self._on_violation = on_violation
        self._on_lost = on_lost
        self._subscription: Any = None
        self._watch: PublisherWatch | None = None
        self._is_created = False
        self._is_destroyed = False
        # The latest state that has arrived, the samples made by then, when the next was missed.
        self._arrived, self._made, self._missed_at_s = -1, 0, 0.0

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

    def arrival_fault(self, latest: int) -> str:
        """Return why states of it do not arrive at the reasoning engine; empty if none is missing.

        A stream may rightly have few samples, or be behind states of a former stream.

        Args:
            latest: the valid time of the latest state there, as just reported; 0 before the first.
        """
        streams, now_s = self._context.streams, self._context.wall_time_s()
        known = streams.known.get(self.name)
        if latest != self._arrived:
            self._arrived, self._made, self._missed_at_s = latest, 0, 0.0
            self.arrived_at_s = now_s
        if known is None:
            self._made, is_missed = 0, self._is_created and bool(streams.engines)
        else:
            self._made = self._made or known.samples
            # The report on the latest state may be later than the report on its sample.
            is_later = streams.known_until - known.max_delay > latest
            is_missed = is_later and known.samples > self._made + 1
        self._missed_at_s = (self._missed_at_s or now_s) if is_missed else 0.0
        if not is_missed or now_s - self._missed_at_s < ARRIVAL_LIMIT_S:
            return ''
        if known is None:
            return f"stream '{self.name}' is gone"
        return f'no state has come for {ARRIVAL_LIMIT_S:g} s, although states are made'

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
