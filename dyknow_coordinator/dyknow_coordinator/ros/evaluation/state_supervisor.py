"""The states of a formula group, made of the best streams that there are.

When those fail, others are taken (step 13); when better ones come, so are these (section IX).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Protocol

from dyknow_common import DyKnowError, ExitCode, round_duration
from dyknow_common.ros import time_to_nanoseconds
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation.evaluation import EvaluationPhase
from dyknow_coordinator.grounding.ground import GroundedFormula
from dyknow_coordinator.grounding.grounding import Candidates, FeatureSource, state_specification
from dyknow_coordinator.grounding.known_streams import suspects
from dyknow_coordinator.ros.context import CoordinatorContext
from dyknow_coordinator.ros.evaluation.state_stream import StateStream

RESUME_LIMIT: Final = 1.5
"""Seconds within which other streams must flow when those in use have failed."""

REST: Final = 10.0
"""Seconds for which a stream that failed is not taken again."""

ABSENCE: Final = 1.0
"""Seconds for which there may be no annotation of a feature."""

NEXT_REPORT: Final = 1.2
"""Seconds until the stream manager has told how streams are now."""

POLL: Final = 0.1
"""Seconds between two attempts."""

# What befell samples on their way: the stream itself broke nothing, and may be taken again.
_PASSING: Final = frozenset({'lost', 'source'})


class StateObserver(Protocol):
    """Who is told what becomes of the states."""

    def note_phase(self, phase: EvaluationPhase) -> None:
        """They flow now, or are interrupted."""

    def tell(self, event: str) -> None:
        """Something that people should know has happened to them."""

    def fail(self, error: DyKnowError) -> None:
        """There can be no more of them."""


@dataclass(frozen=True, slots=True)
class StateFault:
    """Why states cannot be made of the streams in use any more.

    Args:
        error: what the callers are told if there is no other way.
        passing: whether the streams themselves are not at fault, and may be taken again.
    """

    error: CoordinationError
    passing: bool


class StateSupervisor:
    """The states of a formula group.

    Args:
        group_id: at the reasoning engine, which listens already to the first stream of states.
        name: of that stream.
        ground: what the formulas of the group are evaluated over.
    """

    def __init__(
        self,
        facilities: CoordinatorContext,
        group_id: int,
        name: str,
        ground: GroundedFormula,
        observer: StateObserver,
    ) -> None:
        self.ground = ground
        self._facilities = facilities
        self._group_id = group_id
        self._observer = observer
        self._failed: dict[FeatureSource, float] = {}
        self._troubles: list[StateFault] = []
        self._missing_since: float | None = None
        self._is_changing = False
        self._has_ended = False
        self.chosen = self._choose()
        self._stream = self._new_stream(name)
        # Those that are to be used, or were used and are still listened to.
        self._others: list[StateStream] = []

    @property
    def stream(self) -> str:
        """The name of the stream of states."""
        return self._stream.name

    @property
    def topic(self) -> str:
        """The topic of the states."""
        return self._stream.topic

    def suits(self, candidates: Candidates) -> bool:
        """Whether these candidates would lead to the same streams now."""
        return self._chosen_of(candidates) == self.chosen

    async def begin(self) -> None:
        """Has the states made (steps 9 to 11).

        Raises:
            DyKnowError: when they cannot be made.
        """
        if self.chosen:
            await self._request(self._stream, self.chosen, gap=False)
        self._observer.note_phase(EvaluationPhase.RUNNING)

    def end(self) -> None:
        """Has no more states made."""
        self._has_ended = True
        self._end_streams()

    def take(self, candidates: Candidates) -> None:
        """Goes over to better streams, where there are any among these, without losing a state.

        Where nothing carries a feature any more, it goes on for a while: annotations are replaced
        one after the other.
        """
        try:
            candidates.choose(self.ground.features)
        except CoordinationError as error:
            self._miss(error)
            return
        self._missing_since = None
        self.ground = replace(self.ground, candidates=candidates)
        self.improve()

    def improve(self) -> None:
        """Goes over to better streams, where any have come, without losing a state."""
        if not (self._is_changing or self._has_ended) and self.chosen:
            self._is_changing = True
            self._facilities.node.spawn(self._improve)

    def replace_silent(self, silent: Sequence[FeatureSource], why: str) -> None:
        """Goes over to other streams, where they are there, since nothing comes of some."""
        self._avoid(silent)
        others = set(self._choose()) - set(self.chosen)
        are_there = all(map(self._facilities.streams.known.is_there, others))
        # Those that have failed themselves would be left again at once, and so for ever.
        if others and are_there and not any(map(self._rests, others)):
            error = CoordinationError(why, ExitCode.UNAVAILABLE)
            self._interrupt(StateFault(error, passing=True))

    def _miss(self, error: CoordinationError) -> None:
        now = self._facilities.wall_time()
        if self._missing_since is None:
            self._missing_since = now
        elif now - self._missing_since > ABSENCE:
            self._observer.fail(error)

    def _new_stream(self, name: str) -> StateStream:
        node, disposal = self._facilities.node, self._facilities.disposal
        return StateStream(node, disposal, name, self._violated, self._engine_lost)

    def _choose(self) -> tuple[FeatureSource, ...]:
        return self._chosen_of(self.ground.candidates)

    def _chosen_of(self, candidates: Candidates) -> tuple[FeatureSource, ...]:
        return candidates.choose(
            self.ground.features,
            lambda source: not self._rests(source),
            self._facilities.streams.known.is_there,
        )

    def _avoid(self, sources: Iterable[FeatureSource]) -> None:
        self._failed.update(dict.fromkeys(sources, self._facilities.wall_time()))

    def _violated(self, stream: StateStream, violation: Any) -> None:
        if self._has_ended or stream not in (self._stream, *self._others):
            return
        if violation.constraint in _PASSING:
            error = CoordinationError(_text(violation), ExitCode.UNAVAILABLE)
            self._interrupt(StateFault(error, passing=True))
        elif violation.stream_name == stream.name:
            self._facilities.node.spawn(self._look_for_silent, stream, violation)
        else:
            known = self._facilities.streams.known
            self._blame(suspects(self.chosen, violation.stream_name, known), violation)

    async def _look_for_silent(self, stream: StateStream, violation: Any) -> None:
        """Finds out which streams have made the states break the caller's constraints."""
        self._observer.note_phase(EvaluationPhase.INTERRUPTED)
        # The stream manager tells each second of which topics something has come.
        await self._facilities.node.deadlines.after(NEXT_REPORT)
        if not self._has_ended and stream is self._stream:
            known = self._facilities.streams.known
            allowed = time_to_nanoseconds(violation.allowed)
            silent = known.silent_topics(stream.name, allowed)
            blamed = [each for topic in silent for each in suspects(self.chosen, topic, known)]
            self._blame(blamed, violation)

    def _blame(self, sources: Sequence[FeatureSource], violation: Any) -> None:
        error = CoordinationError(_text(violation), ExitCode.CONSTRAINT_VIOLATION)
        # Where it cannot be told which of them failed, none is taken as if nothing had been.
        self._avoid(sources or self.chosen)
        self._interrupt(StateFault(error, passing=False))

    def _engine_lost(self, stream: StateStream) -> None:
        if self._has_ended or stream not in (self._stream, *self._others):
            return
        known = self._facilities.streams.known.get(stream.name)
        maker = 'the stream_processing_engine that made the states'
        if known is not None and known.engine:
            maker = f'node {known.engine}, the stream processing engine that made the states,'
        error = CoordinationError(f'{maker} is gone', ExitCode.UNAVAILABLE)
        self._interrupt(StateFault(error, passing=True))

    def _interrupt(self, trouble: StateFault) -> None:
        self._troubles.append(trouble)
        self._observer.note_phase(EvaluationPhase.INTERRUPTED)
        if not self._is_changing:
            self._is_changing = True
            self._facilities.node.spawn(self._recover)

    async def _recover(self) -> None:
        """Goes on with other streams, or fails."""
        limit = self._facilities.node.deadlines.after(RESUME_LIMIT)
        limit.add_done_callback(lambda _: self._give_up())
        while self._troubles and not self._has_ended:
            trouble, count = _worst(self._troubles), len(self._troubles)
            chosen = self._choose()
            if not trouble.passing and any(map(self._rests, chosen)):
                self._observer.fail(trouble.error)
                break
            try:
                await self._go_over(chosen, gap=True)
            except DyKnowError as error:
                self._facilities.node.get_logger().info(f'{self.stream}: {error}')
                await self._facilities.node.deadlines.after(POLL)
            else:
                del self._troubles[:count]
                self._observer.tell(f'{trouble.error.message}; {self._now_used()}')
        limit.cancel()
        self._is_changing = False
        if not self._has_ended:
            self._observer.note_phase(EvaluationPhase.RUNNING)

    def _give_up(self) -> None:
        if self._troubles and not self._has_ended:
            self._observer.fail(_worst(self._troubles).error)

    async def _improve(self) -> None:
        try:
            chosen = self._choose()
            if chosen != self.chosen:
                await self._go_over(chosen, gap=False)
                self._observer.tell(f'other streams are better now; {self._now_used()}')
        except DyKnowError as error:
            self._observer.tell(f'a better stream cannot be used: {error}')
        await self._recover()

    def _rests(self, source: FeatureSource) -> bool:
        """Whether a source has failed of late."""
        limit = self._facilities.wall_time() - REST
        return self._failed.get(source, limit) > limit

    async def _go_over(self, chosen: tuple[FeatureSource, ...], *, gap: bool) -> None:
        """Has the reasoning engine take states of other streams."""
        stream = self._new_stream(next(self._facilities.names))
        if gap:
            # What else befalls the former streams is of no interest any more.
            self._end_streams()
            self._stream = stream
        else:
            self._others.append(stream)
        try:
            await self._listen(stream, gap=gap)
            await self._request(stream, chosen, gap=gap)
        except DyKnowError:
            stream.end()
            if not gap and stream in self._others:
                self._others.remove(stream)
                await self._listen(self._stream, gap=False)
            raise
        self.chosen = chosen
        if not gap and stream in self._others:
            self._others.remove(stream)
            self._others.append(self._stream)
            self._facilities.node.spawn(self._retire, self._stream)
            self._stream = stream

    def _end_streams(self) -> None:
        for stream in (self._stream, *self._others):
            stream.end()
        self._others.clear()

    async def _request(
        self, stream: StateStream, chosen: tuple[FeatureSource, ...], *, gap: bool
    ) -> None:
        specification = state_specification(chosen)
        as_expected = await stream.request(
            self._facilities.clients, specification, self.ground.constraints
        )
        if not as_expected:
            await self._listen(stream, gap=gap)

    async def _listen(self, stream: StateStream, *, gap: bool) -> None:
        await self._facilities.clients.evaluate_group(
            self._group_id,
            self.ground.domains,
            stream.topic,
            self._facilities.results.topic,
            gap=gap,
        )

    async def _retire(self, former: StateStream) -> None:
        """Ends a stream once the reasoning engine does not listen to it any more."""
        while former in self._others and self._is_listened_to(former.topic):
            await self._facilities.node.deadlines.after(POLL)
        if former in self._others:
            self._others.remove(former)
            former.end()

    def _is_listened_to(self, topic: str) -> bool:
        name = self._facilities.clients.stream_reasoning_engine.name.rpartition('/')[2]
        infos = self._facilities.node.get_subscriptions_info_by_topic(topic)
        return any(info.node_name == name for info in infos)

    def _now_used(self) -> str:
        return f'states are made of {", ".join(sorted(map(str, self.chosen)))}'


def _worst(troubles: Sequence[StateFault]) -> StateFault:
    """The latest, and one that streams are to be blamed for before others."""
    return next((each for each in reversed(troubles) if not each.passing), troubles[-1])


def _text(violation: Any) -> str:
    """What a caller is told of a violation."""
    observed, allowed = map(time_to_nanoseconds, (violation.observed, violation.allowed))
    measured = (
        f' ({violation.constraint}: {round_duration(observed)} observed, '
        f'{round_duration(allowed)} allowed)'
        if observed or allowed
        else f' ({violation.constraint})'
    )
    return f'{violation.message}{measured}'
