"""The standby of a formula group: states of other sources, ready to replace the states in use.

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

from collections.abc import Callable
from typing import Final

from rclpy.task import Future

from dyknow_common import DyKnowError, StreamConstraints
from dyknow_coordinator.grounding.feature_sources import Candidates, FeatureSource
from dyknow_coordinator.grounding.source_session import StandbySources
from dyknow_coordinator.ros.context import CoordinatorContext
from dyknow_coordinator.ros.evaluation.state_stream import StateStream
from dyknow_stream_processing import Violation

LOOK_PERIOD_S: Final = 2.0
"""The period of looks at the available sources, and the least age of a standby without a change."""


class Standby:
    """Keeps a state stream of alternative sources ready, for features with several sources.

    Args:
        sources: decides which, as over recordings.
        group_id: at the reasoning engine.
        constraints: the constraints of the state streams.
        new_stream: returns a stream with a name; its violations reach `note_violation`.
    """

    def __init__(
        self,
        context: CoordinatorContext,
        sources: StandbySources,
        group_id: int,
        constraints: StreamConstraints,
        new_stream: Callable[[str], StateStream],
    ) -> None:
        self._context = context
        self._sources = sources
        self._group_id = group_id
        self._constraints = constraints
        self._new_stream = new_stream
        self._stream: StateStream | None = None
        # True once the reasoning engine keeps the states of the stream.
        self._is_ready = False
        self._kept_topic = ''
        self._created_at_s = 0.0
        self._look: Future | None = None
        self._has_ended = False

    def follow(self, in_use: tuple[FeatureSource, ...], candidates: Candidates) -> None:
        """Stand by for the sources in use, with others among the candidates."""
        sources = self._sources
        has_changed = (in_use, candidates) != (sources.in_use, sources.candidates)
        sources.in_use, sources.candidates = in_use, candidates
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

    def note_violation(self, stream: StateStream, violation: Violation) -> None:
        """Use no sources that a violation concerns, in whatever stream it was reported."""
        now = self._context.wall_time()
        self._sources.note_violation(violation, now, is_own=stream is self._stream)
        if self._sources.is_broken:
            self._drop()

    def note_engine_lost(self, stream: StateStream) -> None:
        """Drop the stream if its engine is lost."""
        if stream is self._stream:
            self._drop()

    def take(self) -> StateStream | None:
        """Return the stream, which is then the caller's; None if it is not ready or not well."""
        stream = self._stream
        if stream is None or not self._is_ready:
            return None
        reported = self._context.streams.known.get(stream.name)
        has_samples = reported is not None and not reported.waits_for
        if not (has_samples and self._sources.is_well(self._context.wall_time())):
            return None
        self._stream, self._is_ready, self._kept_topic = None, False, ''
        self._sources.give_up()
        return stream

    async def _run(self) -> None:
        """Look for another standby periodically, as long as there can be one."""
        while not self._has_ended:
            wanted = self._sources.wanted(self._context.wall_time())
            is_outdated = bool(self._kept_topic) and self._stream is None
            if wanted != self._sources.chosen or is_outdated:
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
        self._stream, self._sources.chosen = stream, chosen
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
                self._sources.exclude_unusable(chosen, self._context.wall_time())
                self._drop()

    def _drop(self) -> None:
        if self._stream is not None:
            self._stream.destroy()
        self._stream, self._is_ready = None, False
        self._sources.give_up()

    def _wake(self) -> None:
        if self._look is not None and not self._look.done():
            self._look.set_result(None)

    def _has_alternatives(self) -> bool:
        found = self._sources.candidates
        return any(len(found.of(each.feature)) > 1 for each in self._sources.in_use)
