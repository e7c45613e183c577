"""The standby of a formula group: states of other sources, which can replace those in use at once.

Example: the streams `a` (best), `b` and `c` carry `Power[uav1]`.

     0.0 s  states_1, made from a, is in use; states_2, made from b, becomes the standby: the
            reasoning engine keeps its latest states
     4.0 s  a breaks max_delay: the supervisor takes states_2, whose kept states follow the last
            one of states_1 without a gap; states_3, made from c, becomes the standby
     9.0 s  c breaks a constraint: states_3 is destroyed, as states of it may be missing. c is
            excluded for EXCLUSION_NS, and so is a still: there is no standby
    14.0 s  a is no longer excluded: states_4, made from a, becomes the standby
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

from rclpy.task import Future

from dyknow_common import DyKnowError, StreamConstraints
from dyknow_coordinator.grounding.feature_sources import Candidates, FeatureSource
from dyknow_coordinator.grounding.source_choice import SourceChoice
from dyknow_coordinator.ros.context import CoordinatorContext
from dyknow_coordinator.ros.evaluation.state_stream import StateStream
from dyknow_stream_processing import Violation

LOOK_PERIOD_S: Final = 2.0
"""The period of looks at the available sources, and the least age of a standby without a change."""


class Standby:
    """Keeps a state stream ready over other sources than those in use, for features that have some.

    Args:
        group_id: at the reasoning engine.
        constraints: of the state streams.
        new_stream: returns a stream with a name; its violations reach `note_violation`.
    """

    def __init__(
        self,
        context: CoordinatorContext,
        group_id: int,
        constraints: StreamConstraints,
        new_stream: Callable[[str], StateStream],
    ) -> None:
        self._context = context
        self._group_id = group_id
        self._constraints = constraints
        self._new_stream = new_stream
        self._choice = SourceChoice()
        self._in_use: tuple[FeatureSource, ...] = ()
        self._candidates = Candidates(())
        self._stream: StateStream | None = None
        # True once the reasoning engine keeps the states of the stream.
        self._is_ready = False
        self._kept_topic = ''
        self._created_at_s = 0.0
        self._look: Future | None = None
        self._has_ended = False

    def follow(self, in_use: tuple[FeatureSource, ...], candidates: Candidates) -> None:
        """Stand by for the sources in use, with others among the candidates."""
        has_changed = (in_use, candidates) != (self._in_use, self._candidates)
        self._in_use, self._candidates = in_use, candidates
        if self._look is None and (self._has_alternatives() or self._stream is not None):
            self._look = Future()
            self._context.node.spawn(self._run)
        elif has_changed or self._context.wall_time_s() - self._created_at_s > LOOK_PERIOD_S:
            self._wake()

    def end(self) -> None:
        """Destroy the stream."""
        self._has_ended = True
        self._drop()
        self._wake()

    def exclude(self, sources: Iterable[FeatureSource], now: int) -> None:
        """Use no states of sources that have failed."""
        self._choice.exclude(sources, now)

    def note_violation(self, stream: StateStream, violation: Violation) -> None:
        """Use no sources that a violation concerns, in whatever stream it was reported."""
        known = self._context.streams.known
        affected = known.affected((*self._in_use, *self._chosen), violation.stream_name)
        is_own = stream is self._stream
        now = self._context.wall_time()
        self.exclude(affected or (self._chosen if is_own else ()), now)
        # Without a name, it concerns all streams: the clock was set back.
        if is_own or not violation.stream_name or set(affected) & set(self._chosen):
            self._drop()

    def note_engine_lost(self, stream: StateStream) -> None:
        """Drop the stream if its engine is lost."""
        if stream is self._stream:
            self._drop()

    def take(self) -> StateStream | None:
        """Return the stream, which is then the caller's; None if it is not ready or not well.

        A stream without samples is not: its sources may never have any.
        """
        known, now = self._context.streams.known, self._context.wall_time()
        failed = any(self._choice.is_excluded(each, now) for each in self._chosen)
        if self._stream is None or not self._is_ready or failed:
            return None
        reported = known.get(self._stream.name)
        if reported is None or reported.waits_for or not all(map(known.is_available, self._chosen)):
            return None
        taken = self._stream
        self._stream, self._is_ready, self._kept_topic = None, False, ''
        return taken

    async def _run(self) -> None:
        """Look for another standby periodically, as long as there can be one."""
        while not self._has_ended:
            known, now = self._context.streams.known, self._context.wall_time()
            wanted = self._choice.stand_ins(
                self._in_use, self._candidates, known, now, self._chosen
            )
            is_outdated = bool(self._kept_topic) and self._stream is None
            if wanted != self._chosen or is_outdated:
                await self._replace(wanted)
            self._look = self._context.node.deadlines.after(LOOK_PERIOD_S)
            if self._look.done() or not self._has_alternatives():
                break  # If it is done already, the node ends, and no wait lasts any more.
            await self._look
        self._look = None

    async def _replace(self, chosen: tuple[FeatureSource, ...]) -> None:
        """Have the reasoning engine keep the states of some sources; of none if there are none."""
        self._drop()
        stream = self._new_stream(next(self._context.names)) if chosen else None
        self._stream = stream
        self._created_at_s = self._context.wall_time_s()
        try:
            if stream is not None:
                await stream.create(chosen, self._constraints)
            if not self._has_ended:
                self._kept_topic = stream.topic if stream is not None else ''
                await self._context.clients.keep_states(self._group_id, self._kept_topic)
            self._is_ready = stream is not None and stream is self._stream
        except DyKnowError as error:
            self._context.node.get_logger().info(f'no standby: {error}')
            if stream is not None and stream is self._stream:
                self.exclude(set(chosen) - set(self._in_use), self._context.wall_time())
                self._drop()

    def _drop(self) -> None:
        if self._stream is not None:
            self._stream.destroy()
        self._stream, self._is_ready = None, False

    @property
    def _chosen(self) -> tuple[FeatureSource, ...]:
        """The sources of the stream; none without it."""
        return self._stream.chosen if self._stream else ()

    def _wake(self) -> None:
        if self._look is not None and not self._look.done():
            self._look.set_result(None)

    def _has_alternatives(self) -> bool:
        return any(len(self._candidates.of(each.feature)) > 1 for each in self._in_use)
