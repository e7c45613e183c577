"""Supervision of the states of a formula group.

The states are made from the best available source of each ground feature. When a source fails,
another source replaces it (step 13); when a better source appears, it replaces the source in use
(section IX). Example: two streams carry `Power[uav1]`, `a` (better) and `b`.

With a gap, because a stream breaks and no `Standby` is ready:

     0.0 s  state stream states_1, made from a, is created; the phase is RUNNING
     4.0 s  a breaks max_delay: states_1 is destroyed, a is excluded for EXCLUSION_NS, INTERRUPTED
     4.1 s  the reasoning engine is switched to states_2, with a gap
     4.2 s  states_2, made from b, is created: RUNNING. If this is not achieved RESUME_TIMEOUT_S
            after the violation, the formulas fail

Without a gap, because a better stream is available:

    20.0 s  the set of published streams changes; a is published and no longer excluded
    20.1 s  states_3, made from a, is created
    20.3 s  a has had a message: the reasoning engine is switched to states_3, without a gap: it
            progresses states_2 until states_3 has caught up
    20.5 s  the engine has unsubscribed from states_2, which is destroyed
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Collection, Iterable, Mapping
from dataclasses import replace
from typing import Final, Protocol

from rclpy.impl.rcutils_logger import RcutilsLogger

from dyknow_common import SECOND_NS, DyKnowError, ExitCode, with_readable_times
from dyknow_common.ros import full_name
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation import EvaluationPhase
from dyknow_coordinator.grounding.feature_sources import Candidates, FeatureSource
from dyknow_coordinator.grounding.known_streams import KnownStreams
from dyknow_coordinator.grounding.source_session import (
    EXCLUSION_NS,
    TRANSIENT,
    SourceSession,
    describe_sources,
)
from dyknow_coordinator.grounding.state_specification import FormulaInputs
from dyknow_coordinator.ros.context import CoordinatorContext
from dyknow_coordinator.ros.evaluation.standby import Standby
from dyknow_coordinator.ros.evaluation.state_stream import (
    POLL_PERIOD_S,
    SETTLING_S,
    StateStream,
)
from dyknow_stream_processing import Violation, ViolationKind

RESUME_TIMEOUT_S: Final = 2.0
"""Time within which other streams must replace failed streams."""

ABSENCE_TIMEOUT_S: Final = 1.0
"""Time for which a feature may have no annotation: they are replaced one after the other."""

RETRY_NS: Final = SECOND_NS
"""Time after which better streams are tried again whose messages, or whose engine, were lost."""


class StateObserver(Protocol):
    """Receiver of changes of the states."""

    def set_phase(self, phase: EvaluationPhase) -> None:
        """Set the phase: RUNNING or INTERRUPTED."""

    def add_event(self, event: str) -> None:
        """Record an event, for people."""

    def fail(self, error: DyKnowError) -> None:
        """Record that there are no more states."""


class StateUsers(StateObserver, Protocol):
    """Formulas over the same states."""

    @property
    def titles(self) -> str:
        """The names of the formulas, for people."""

    @property
    def logger(self) -> RcutilsLogger:
        """The logger of what people are told of the states."""


class StateSupervisor:
    """Supervisor of the states of a formula group, which replaces their streams.

    Args:
        group_id: at the reasoning engine, which has subscribed to the first state stream.
        name: the name of that stream.
    """

    def __init__(
        self,
        context: CoordinatorContext,
        group_id: int,
        name: str,
        inputs: FormulaInputs,
        observer: StateUsers,
    ) -> None:
        self._context = context
        self._group_id = group_id
        self._observer = observer
        self._session = SourceSession(inputs, lambda: context.streams.known)
        self._standby = Standby(
            context, self._session.standby, group_id, inputs.constraints, self._new_stream
        )
        self._doubtful_from: int | None = None
        self._settled_at_s = 0.0
        # No better streams are tried before: their states were lost, or no engine could make them.
        self._next_try = 0
        self._missing_since: float | None = None
        self._is_changing = False
        self._has_ended = False
        self._session.chosen = self._session.choose(inputs.candidates, context.wall_time())
        self.stream = self._new_stream(name)
        self.used_since = context.node.now()
        """The time since which the streams in use are."""
        # A better stream that may have no samples.
        self._next: StateStream | None = None
        # Streams that were used, and that the reasoning engine has not unsubscribed from.
        self._left: list[StateStream] = []
        self._topics: tuple[str, ...] = ()
        self._topics_of: tuple[KnownStreams, tuple[FeatureSource, ...]] | None = None

    @property
    def inputs(self) -> FormulaInputs:
        """The inputs of the formulas."""
        return self._session.inputs

    @property
    def chosen(self) -> tuple[FeatureSource, ...]:
        """The sources in use."""
        return self._session.chosen

    @property
    def fault(self) -> str:
        """Why states may be missing; empty if they never were."""
        return self._session.cause.message

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics that the streams in use are made from."""
        known = self._context.streams.known
        # The status is read more often than streams change.
        if self._topics_of != (known, self.chosen):
            self._topics_of, self._topics = (known, self.chosen), known.topics(self.chosen)
        return self._topics

    @property
    def waits_for(self) -> str:
        """Why the state stream has no samples; empty if they come or that is unknown."""
        if not self.chosen:
            return 'the formula depends on no feature'
        stream = self._context.streams.known.get(self.stream.name)
        return '' if stream is None else self._context.explained_wait(stream.waits_for)

    def would_choose_from(self, candidates: Candidates) -> bool:
        """Return True if the same streams would be chosen from other candidates now."""
        return self._session.choose(candidates, self._context.wall_time()) == self.chosen

    async def start(self) -> None:
        """Create the state stream (steps 9 to 11).

        Raises:
            DyKnowError: if it cannot be created.
        """
        if self.chosen:
            await self._create(self.stream, self.chosen, gap=False)
        self.used_since = self._context.node.now()
        self._run_on()

    def end(self) -> None:
        """Destroy the state stream."""
        self._has_ended = True
        self._standby.end()
        self._destroy_streams()

    def update_candidates(self, candidates: Candidates) -> None:
        """Use new candidates, and switch to better streams among them without a gap."""
        try:
            candidates.choose(self.inputs.features)
        except CoordinationError as error:
            self._on_missing(error)
            return
        self._missing_since = None
        self._session.inputs = replace(self.inputs, candidates=candidates)
        self.improve()

    def improve(self) -> None:
        """Switch to better streams, if any have samples now, without a gap."""
        if self._is_changing or self._has_ended or self._better() == self.chosen:
            return
        if self._context.wall_time() < self._next_try:
            return
        self._start_change(self._improve)

    def look(self, silence_limit: int) -> None:
        """Find sources at fault, and better ones; periodically.

        Args:
            silence_limit: the time without a message after which a topic is silent, in nanoseconds.
        """
        streams, session = self._context.streams, self._session
        session.silence_limit = silence_limit
        session.look(
            self.stream.name,
            self._received(),
            self.used_since,
            self._context.wall_time(),
            known_until=streams.known_until,
        )
        if session.faults:
            self._interrupt()
        self.improve()

    def note_progress(self, latest: int) -> None:
        """Note a report on the latest state, and make the states anew if they do not arrive.

        Args:
            latest: its valid time in nanoseconds; 0 before the first.
        """
        if self._is_changing or self._has_ended or not self.chosen:
            return
        if fault := self.stream.arrival_fault(latest):
            self._session.note_loss(fault)
            self._interrupt()

    def _on_missing(self, error: CoordinationError) -> None:
        now = self._context.wall_time_s()
        if self._missing_since is None:
            self._missing_since = now
        elif now - self._missing_since > ABSENCE_TIMEOUT_S:
            self._observer.fail(error)

    def _new_stream(self, name: str) -> StateStream:
        return StateStream(self._context, name, self._on_violation, self._on_engine_lost)

    def _received(self) -> Mapping[str, int]:
        """Return when the latest message of each topic of the states was received, or 0."""
        made = self._context.streams.known.get(self.stream.name)
        return made.received if made else {}

    def _better(self) -> tuple[FeatureSource, ...]:
        """Return the best sources that have samples; they may be the sources in use."""
        now = self._context.wall_time()
        return self._session.better(self._received(), self._context.streams.known_until, now)

    def _exclude(self, sources: Iterable[FeatureSource]) -> None:
        self._session.exclude(sources, self._context.wall_time())

    def _is_in_use(self, stream: StateStream) -> bool:
        return not self._has_ended and stream is self.stream

    def _give_up_next(self, stream: StateStream) -> None:
        if stream is self._next:
            self._next = None

    def _on_violation(self, stream: StateStream, violation: Violation) -> None:
        self._standby.note_violation(stream, violation)
        if stream in (self._next, *self._left) and violation.constraint not in TRANSIENT:
            # The reasoning engine leaves it at once by itself, or does not read it yet.
            known = self._context.streams.known
            self._exclude(known.affected(stream.chosen, violation.stream_name))
            # For streams at fault, the better streams may be the only replacement.
            if stream is self._next and not self._session.faults:
                self._exclude(set(stream.chosen) - set(self.chosen))
        self._give_up_next(stream)
        if not self._is_in_use(stream):
            return
        begin = violation.doubtful_from
        if self._doubtful_from is None or begin < self._doubtful_from:
            self._doubtful_from = begin
        if violation.constraint == ViolationKind.SOURCE:
            self._settled_at_s = self._context.wall_time_s() + SETTLING_S
        now = self._context.wall_time()
        self._session.note_violation(violation, stream.name, stream.chosen, now)
        self._observer.set_phase(EvaluationPhase.INTERRUPTED)
        if self._session.faults:
            self._interrupt()

    def _on_engine_lost(self, stream: StateStream) -> None:
        self._standby.note_engine_lost(stream)
        self._give_up_next(stream)
        if not self._is_in_use(stream):
            return
        known = self._context.streams.known.get(stream.name)
        engine = 'the stream_processing_engine that made the states'
        if known is not None and known.engine:
            engine = f'node {known.engine}, the stream processing engine that made the states,'
        self._session.note_loss(f'{engine} is gone')
        self._interrupt()

    def _interrupt(self) -> None:
        self._observer.set_phase(EvaluationPhase.INTERRUPTED)
        if not self._is_changing:
            self._start_change(self._recover)

    def _start_change(self, change: Callable[[], Awaitable[None]]) -> None:
        self._is_changing = True
        self._context.node.spawn(self._change, change)

    async def _change(self, change: Callable[[], Awaitable[None]]) -> None:
        try:
            await change()
        except Exception as error:  # Otherwise, the formulas would wait for other states for ever.
            self._observer.fail(self._context.fault(error))
            raise

    async def _recover(self) -> None:
        """Switch to other streams because of faults, or fail."""
        session = self._session
        limit = self._context.node.deadlines.after(RESUME_TIMEOUT_S)
        limit.add_done_callback(lambda _: self._give_up())
        while session.faults and not self._has_ended:
            standby = self._standby.take()
            if standby is None and await self._settle():
                continue
            chosen = session.react(self._context.wall_time(), standby.chosen if standby else ())
            if chosen is None:
                self._give_up()
                break
            try:
                await (self._take_over(standby) if standby else self._switch(chosen))
            except DyKnowError as error:
                session.note_obstacle(chosen, error, self._context.wall_time())
                self._context.node.get_logger().info(f'{self.stream.name}: {error}')
                await self._context.node.deadlines.after(POLL_PERIOD_S)
            else:
                self.used_since = self._context.node.now()
                event = session.note_replaced(self.chosen)
                self._observer.add_event(event)
                text = f'{self._observer.titles}: {with_readable_times(event)}'
                self._observer.logger.warning(text)
        limit.cancel()
        self._is_changing = False
        if not self._has_ended:
            self._run_on()
        # The standby avoids all sources in use, including healthy ones, and streams may have
        # changed meanwhile.
        self.improve()

    def _run_on(self) -> None:
        self._observer.set_phase(EvaluationPhase.RUNNING)
        self._standby.follow(self.chosen, self.inputs.candidates)

    async def _settle(self) -> bool:
        """Wait until the replacements of failed streams are known; return False if they were."""
        wait_s = self._settled_at_s - self._context.wall_time_s()
        is_open = wait_s > 0 and not self._are_replaced()
        if is_open:
            await self._context.node.deadlines.after(min(wait_s, POLL_PERIOD_S))
        return is_open

    async def _take_over(self, standby: StateStream) -> None:
        """Switch to the standby; without a gap if its states allow it and former ones are right."""
        doubtful = self._doubtful_from
        self._destroy_streams()
        self.stream, self._session.chosen = standby, standby.chosen
        await self._evaluate(self.stream, gap=doubtful is not None, doubtful_from=doubtful or 0)

    def _give_up(self) -> None:
        if self._session.faults and not self._has_ended:
            self._observer.fail(self._session.failure())

    async def _improve(self) -> None:
        while await self._settle():
            pass
        chosen = self._better()
        # If it has ended since this was spawned, nobody would destroy another stream.
        if chosen != self.chosen and not self._has_ended:
            await self._prefer(chosen)
        await self._recover()

    async def _prefer(self, chosen: tuple[FeatureSource, ...]) -> None:
        """Switch to better streams without a gap, once they have samples."""
        others = set(chosen) - set(self.chosen)
        stream = self._next = self._new_stream(next(self._context.names))
        try:
            since = self._context.node.now()
            await stream.create(chosen, self.inputs.constraints)
            silent = await self._silent(stream.name, others, since)
            if stream is not self._next:
                # Lost messages or a lost engine are no fault of the sources: they are tried again.
                silent, self._next_try = (), self._context.wall_time() + RETRY_NS
            elif not (silent or self._session.faults):
                await self._hand_over(stream)
        except DyKnowError as error:
            silent = others
            if error.code is ExitCode.UNAVAILABLE:  # It is no fault of the sources.
                silent, self._next_try = (), self._context.wall_time() + EXCLUSION_NS
            if stream is self.stream:
                self._session.note_loss(error.message)
            elif not self._has_ended:
                self._observer.add_event(f'a better stream cannot be used: {error}')
        if stream is not self.stream:
            self._next = None
            stream.destroy()
            # For streams at fault, the better streams may be the only replacement.
            if not self._session.faults:
                self._exclude(silent)

    async def _silent(
        self, name: str, others: Iterable[FeatureSource], since: int
    ) -> Collection[FeatureSource]:
        """Wait for messages of all topics of better sources; return the sources without any.

        Nobody may have listened to them before: a publisher alone does not make samples.
        """
        streams, deadlines = self._context.streams, self._context.node.deadlines
        limit = deadlines.after(self._session.silence_limit / SECOND_NS)
        while True:
            silent = [each for each in others if not streams.known.are_received(name, each, since)]
            is_over = self._next is None or bool(self._session.faults) or limit.done()
            if is_over or not silent:
                limit.cancel()
                return silent
            await deadlines.after(POLL_PERIOD_S)

    async def _hand_over(self, stream: StateStream) -> None:
        """Have the reasoning engine read another stream as soon as it has caught up."""
        former = self.stream
        self._left.append(former)
        self.stream, self._next, self._session.chosen = stream, None, stream.chosen
        self.used_since, self._doubtful_from = self._context.node.now(), None
        await self._evaluate(stream, gap=False)
        self._context.node.spawn(self._retire, former)
        self._observer.add_event(f'other streams are better now; {describe_sources(self.chosen)}')

    async def _switch(self, chosen: tuple[FeatureSource, ...]) -> None:
        """Switch the reasoning engine to a new state stream, with a gap."""
        # Further faults of the former streams do not matter.
        self._destroy_streams()
        stream = self.stream = self._new_stream(next(self._context.names))
        try:
            await self._evaluate(stream, gap=True)
            await self._create(stream, chosen, gap=True)
        except DyKnowError:
            stream.destroy()
            raise
        self._session.chosen = chosen

    def _destroy_streams(self) -> None:
        for stream in filter(None, (self.stream, self._next, *self._left)):
            stream.destroy()
        self._next = None
        self._left.clear()
        self._doubtful_from = None

    async def _create(
        self, stream: StateStream, chosen: tuple[FeatureSource, ...], *, gap: bool
    ) -> None:
        as_expected = await stream.create(chosen, self.inputs.constraints)
        if not as_expected:
            await self._evaluate(stream, gap=gap)

    def _are_replaced(self) -> bool:
        """Return True if the stream manager knows other streams in place of the streams in use."""
        try:
            return self._context.streams.known.identities(self.chosen) != self.stream.sources
        except CoordinationError:
            return False

    async def _evaluate(self, stream: StateStream, *, gap: bool, doubtful_from: int = 0) -> None:
        """Have the reasoning engine evaluate the group over a state stream."""
        await self._context.clients.evaluate_group(
            self._group_id,
            self.inputs.domains,
            stream.topic,
            self._context.results.topic,
            gap=gap,
            doubtful_from=doubtful_from,
        )

    async def _retire(self, former: StateStream) -> None:
        """Destroy a stream once the reasoning engine has unsubscribed from it."""
        while former in self._left and self._is_subscribed(former.topic):
            await self._context.node.deadlines.after(POLL_PERIOD_S)
        if former in self._left:
            self._left.remove(former)
            former.destroy()

    def _is_subscribed(self, topic: str) -> bool:
        node = self._context.node
        name = node.resolve_service_name(self._context.clients.stream_reasoning_engine.name)
        infos = node.get_subscriptions_info_by_topic(topic)
        return any(full_name(info) == name for info in infos)
