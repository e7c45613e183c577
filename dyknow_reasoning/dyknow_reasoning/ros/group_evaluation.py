"""The evaluation of one formula group, over one state stream after another."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Any, Final, TypeVar

from dyknow_interfaces.msg import FormulaEpisodes, FormulaProgress
from dyknow_interfaces.msg import FormulaResult as FormulaResultMessage
from dyknow_interfaces.msg import Symbol as SymbolMessage
from rclpy.task import Future

from dyknow_common import SECOND_NS, DyKnowError, ExitCode, listed, shortened
from dyknow_common.ros import (
    LATCHED_HISTORY,
    Background,
    DirectPublisher,
    DyKnowNode,
    absolute_topic,
    to_message,
)
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.formula_group import FormulaGroup
from dyknow_reasoning.progression.gaps import Gap
from dyknow_reasoning.progression.unknown_features import ALL_KNOWN, UnknownFeatures
from dyknow_reasoning.results import FormulaResult
from dyknow_reasoning.ros.result_messages import (
    EpisodeReports,
    progress_to_message,
    result_to_message,
)
from dyknow_reasoning.ros.state_subscription import (
    VIOLATIONS_SUFFIX,
    State,
    StateSubscription,
)
from dyknow_reasoning.state_line import Breach, StateLine
from dyknow_stream_processing import OTHER_CLOCK_NS
from dyknow_stream_processing.ros import sample_fields

_MAX_EVENTS = 20


class GroupEvaluation:
    """One formula group and the state streams that it is progressed over.

    A `StateLine` decides which states count. Another stream replaces the one in use as soon as no
    state between them is missing; a stream on standby replaces it on request.

    Long work for requests, states and reports happens in the background.
    """

    def __init__(
        self,
        node: DyKnowNode,
        group_id: int,
        name: str,
        group: FormulaGroup,
        background: Background,
        progress: Any,
        episodes: Any,
    ) -> None:
        self.group = group
        self._reports = progress
        self._episodes = EpisodeReports(node, group_id, group, episodes)
        self.name = name
        self._node = node
        self._id = group_id
        self._work = GroupWork(node, background)
        self._is_destroyed = False
        self._reserved_parts = 0
        self._step_s = 0.0
        self._states = 0
        # For each formula, the number of states before its first one.
        self._states_before: dict[int, int] = {}
        # For each formula that was added while others had kept states, these streams.
        self._had_kept: dict[int, list[StateSubscription]] = {}
        self._loss = ''  # Before a state that does not count, if it leaves a gap.
        # For each formula that is removed later, the valid time until which states count.
        self._ends: dict[int, int] = {}
        self._events: deque[str] = deque(maxlen=_MAX_EVENTS)
        # Those of the evaluation.
        self._domains: Mapping[str, Sequence[str]] = {}
        self._result_topic = ''
        self._results: DirectPublisher | None = None
        self._line: StateLine[StateSubscription] = StateLine(lambda _: group.gap())
        self._standby: StateSubscription | None = None
        # For each stream, the states that were dropped since the latest one that was accepted.
        self._dropped: Counter[StateSubscription] = Counter()
        self._requested_at = self._wall_time()

    @property
    def has_begun(self) -> bool:
        """True if the evaluation has begun."""
        return self._line.stream is not None

    @property
    def parts(self) -> int:
        """The parts of all formulas, including formulas in preparation."""
        return max(self.group.parts, self._reserved_parts)

    @property
    def idle_s(self) -> float:
        """The time since the latest request, in seconds."""
        return (self._wall_time() - self._requested_at) / SECOND_NS

    async def add_formula(self, name: str, text: str, **options: Any) -> int:
        """Add a formula and return its id; arguments and errors as of the formula group."""
        # The first state of the formula is a later one, also of another stream that takes over.
        others = [each for each in (self._line.next, self._standby) if each and each.kept]
        is_next = bool(others) and options.get('since') is None
        if is_next:
            options['since'] = max(each.kept.latest for each in others) + 1

        def add() -> tuple[int, Sequence[FormulaResult]]:
            formula_id = self.group.add_formula(name, text, **options)
            self._states_before[formula_id] = self._states
            if is_next:
                self._had_kept[formula_id] = others
            return formula_id, self.group.decided_at_once() if self.has_begun else ()

        def is_heavy() -> bool:
            return len(text) > HEAVY_TEXT or (self.has_begun and self._is_large())

        # Before it returns, states may be progressed that have waited.
        formula_id, known = await self._work.run(add, is_heavy)
        if known:
            self.publish(known)
        return formula_id

    async def remove_formula(self, formula_id: int, until: int = 0) -> None:
        """Remove a formula, after the last reports on it if it is undecided.

        Args:
            formula_id: the formula.
            until: a valid time in nanoseconds. An undecided formula still gets states up to this
                time, and is removed before the first later state. If states have another clock,
                which cannot be compared, it is removed at once.

        Raises:
            ReasoningError: for an unknown formula.
        """
        latest = self._line.latest
        is_early = until > 0 if latest is None else 0 < until - latest <= OTHER_CLOCK_NS
        if formula_id in self.group.undecided and is_early:
            self._ends[formula_id] = until
            return
        # While states wait, it is not known how the formula stands.
        reports = await self._work.run(
            lambda: self._remove(formula_id, is_last=not self._work.waiting_states), self._is_large
        )
        self._publish_last(*reports)

    def _remove(
        self, formula_id: int, *, is_last: bool, latest: int | None = None
    ) -> tuple[FormulaProgress | None, FormulaEpisodes | None]:
        """Remove a formula; return its last reports. A decided formula has no progress report."""
        progress = None
        if formula_id in self.group.undecided:
            progress = self._report(formula_id, is_last=is_last, latest=latest)
        episodes = self._episodes.report(formula_id)
        self.group.remove_formula(formula_id)
        for each in (self._states_before, self._had_kept, self._ends):
            each.pop(formula_id, None)
        return progress, episodes

    def _publish_last(
        self, progress: FormulaProgress | None, episodes: FormulaEpisodes | None
    ) -> None:
        self._episodes.publish(episodes)
        if progress is not None:
            self._reports.publish(progress)

    def _end_before(self, valid_time: int, latest: int | None) -> None:
        """Remove the formulas whose states end before a valid time, after a last report on each.

        Args:
            valid_time: the valid time of a state that counts, in nanoseconds.
            latest: the valid time of the state before it.
        """
        ends = self._ends.items()
        ended = [each for each, at in ends if not 0 <= at - valid_time <= OTHER_CLOCK_NS]
        for formula_id in filter(self.group.undecided.__contains__, ended):
            self._publish_last(*self._remove(formula_id, is_last=True, latest=latest))

    async def symbols(self) -> list[SymbolMessage]:
        """Return the symbols of the formulas."""
        return await self._work.run(
            lambda: [to_message(each, SymbolMessage()) for each in self.group.symbols()],
            self._is_large,
        )

    async def begin(
        self,
        domains: Mapping[str, Sequence[str]],
        state_stream: str,
        result_topic: str,
        unknown: UnknownFeatures = ALL_KNOWN,
    ) -> None:
        """Fix the domains and the features that may be unknown, and subscribe to the states.

        Raises:
            ReasoningError: for an invalid topic name, a sort without a domain, or a formula that
                is too large for the domains.
        """
        states = absolute_topic(self._node, state_stream, 'state_stream', VIOLATIONS_SUFFIX)
        if absolute_topic(self._node, result_topic, 'result_topic') == states:
            raise ReasoningError(f"'{shortened(states)}' cannot be both states and results")
        self._reserved_parts = self.group.parts_for(domains)
        try:
            await self._work.run(lambda: self.group.begin(domains, unknown), self._is_large)
        finally:
            self._reserved_parts = 0
        if self._is_destroyed:
            raise ReasoningError('the formula group was destroyed meanwhile', ExitCode.NOT_FOUND)
        self._domains, self._result_topic = domains, result_topic
        node = self._node
        self._results = DirectPublisher(node, FormulaResultMessage, result_topic, LATCHED_HISTORY)
        self.publish(self.group.decided_at_once())
        self._line.change(self._subscribe(state_stream), self._wall_time())

    async def change_stream(
        self,
        domains: Mapping[str, Sequence[str]],
        state_stream: str,
        result_topic: str,
        *,
        gap: bool,
        doubtful_from: int = 0,
    ) -> None:
        """Change to another state stream, or cancel a change by naming the present one.

        Args:
            domains: empty, or the domains of the evaluation.
            state_stream: the topic of the new states.
            result_topic: empty, or the result topic of the evaluation.
            gap: True if states may be missing between the two streams; for the standby,
                if the present stream is violated.
            doubtful_from: the valid time from which on states of a violated stream are doubtful.

        Raises:
            ReasoningError: for an invalid topic name, or other domains or another result topic.
        """
        absolute_topic(self._node, state_stream, 'state_stream', VIOLATIONS_SUFFIX)
        self._check_inputs(domains, result_topic)
        await self._work.run(
            lambda: self._change_stream(state_stream, doubtful_from if gap else None)
        )

    def _check_inputs(self, domains: Mapping[str, Sequence[str]], result_topic: str) -> None:
        """Check that a request gives the domains and the topic of the evaluation, or none."""
        for sort, objects in domains.items():
            if objects != self._domains.get(sort):
                was = listed(self._domains.get(sort, ())) or 'none'
                raise ReasoningError(
                    f"domains: the objects of the sort '{sort}' are fixed while the group is "
                    f'evaluated ({was}); make a new group for others'
                )
        if result_topic not in {'', self._result_topic}:
            raise ReasoningError(
                f"result_topic: the group publishes its results on '{self._result_topic}' as long "
                f"as it is evaluated, not on '{result_topic}'"
            )

    def _change_stream(self, state_stream: str, doubtful_from: int | None) -> None:
        if self._is_destroyed:
            return
        line, gap = self._line, doubtful_from is not None
        if line.next and line.next.topic == state_stream and gap:
            if line.next.kept:
                self._change(line.next)
            return
        if line.next:
            line.next.destroy()
        line.next = None
        if line.stream and line.stream.topic == state_stream and not (gap or line.pause):
            return
        if self._standby and self._standby.topic == state_stream:
            # The request may come before the message of the violation.
            if line.stream and doubtful_from is not None:
                line.stream.doubt(doubtful_from)
            taken, self._standby = self._standby, None
            self._change(taken)
            return
        stream, now = self._subscribe(state_stream), self._wall_time()
        line.hand_over(stream, now)
        if gap or line.is_due(now):
            self._change(stream)

    def change_if_due(self) -> None:
        """Change to the next stream if it is time to; see `StateLine.is_due`."""
        if self._line.next and not self._work.is_busy and self._line.is_due(self._wall_time()):
            self._change(self._line.next)

    def _change(self, stream: StateSubscription) -> None:
        """Change to a stream now, and receive the states that were kept of it."""
        if self._line.stream:
            self._line.stream.destroy()
        self._line.change(stream, self._wall_time())
        self._log_pause()
        # States of this stream that wait for a slow step came later.
        kept = stream.kept.take()
        self._work.receive_first([partial(self._handle, stream, each) for each in kept])

    async def set_standby(self, topic: str) -> None:
        """Keep the states of a stream on standby; an empty topic ends the standby.

        Raises:
            ReasoningError: for an invalid topic name.
        """
        if topic:
            absolute_topic(self._node, topic, 'standby', VIOLATIONS_SUFFIX)
        # A change to the present standby may wait.
        await self._work.run(lambda: self._set_standby(topic))

    def _set_standby(self, topic: str) -> None:
        if self._standby:
            self._standby.destroy()
        self._standby = self._subscribe(topic) if topic and not self._is_destroyed else None

    def destroy(self) -> None:
        """Destroy the subscriptions and the publisher."""
        self._is_destroyed = True
        for stream in filter(None, (self._line.stream, self._line.next, self._standby)):
            stream.destroy()
        if self._results is not None:
            self._results.destroy()

    def note_request(self) -> None:
        """Record that a service was called for the group."""
        self._requested_at = self._wall_time()

    def is_orphan(self, limit_s: float) -> bool:
        """Return True if there was no request and no subscriber to the results for some time."""
        if self._results is not None and self._results.get_subscription_count() > 0:
            self.note_request()
        return self.idle_s > limit_s and not self._work.is_busy

    def fail_after_pause(self, limit_s: float) -> None:
        """Fail all formulas if the group has been paused for longer than the limit."""
        pause = None if self._work.is_busy else self._line.pause
        paused_ns = self._wall_time() - self._line.paused_at
        if pause and self.group.undecided and paused_ns > limit_s * SECOND_NS:
            error = ReasoningError(pause.message, ExitCode.CONSTRAINT_VIOLATION)
            self.publish(self.group.fail(error, pause.valid_time))

    async def progress_reports(self) -> Sequence[FormulaProgress]:
        """Return a report on each undecided formula, with the events since the last reports.

        Return none if the group is busy.
        """
        if self._work.is_busy:
            return ()
        return await self._work.run(self._progress_reports, self._is_large)

    def _progress_reports(self) -> Sequence[FormulaProgress]:
        reports = [self._report(each) for each in sorted(self.group.undecided)]
        self._events.clear()
        return reports

    def _report(
        self, formula_id: int, *, is_last: bool = False, latest: int | None = None
    ) -> FormulaProgress:
        states = self._states - self._states_before.get(formula_id, 0)
        latest = (latest or self._line.latest) if states else None
        report = progress_to_message(self.group, formula_id, latest)
        report.formula_group_id, report.states_progressed = self._id, states
        report.events, report.is_last = list(self._events), is_last
        return report

    def publish(self, results: Iterable[FormulaResult]) -> None:
        """Publish the results of formulas."""
        if self._is_destroyed or self._results is None:
            return
        stamp = self._node.get_clock().now().to_msg()
        for result in results:
            self._results.publish(result_to_message(result, self._id, stamp))
            self._reports.publish(self._report(result.formula_id, is_last=True))
        self._episodes.publish_changes()

    def report_episodes(self) -> None:
        """Publish what is due on the formulas that are asked at every state."""
        if not (self._is_destroyed or self._work.is_busy):
            self._episodes.publish_changes()

    def _wall_time(self) -> int:
        return int(self._node.wall_clock.now().nanoseconds)

    def _subscribe(self, topic: str) -> StateSubscription:
        return StateSubscription(self._node, topic, self._on_state, self._on_breach)

    def _is_large(self) -> bool:
        return self._step_s > HEAVY_STEP_S or self.parts > HEAVY_PARTS

    def _on_state(self, stream: StateSubscription, state: State) -> None:
        """Receive a state; if too many wait, drop it, and note the loss with the next one."""
        is_crowded = self._work.waiting_states >= MAX_QUEUED_STATES
        if stream is not self._line.stream:
            stream.kept.add(state, self._line.latest)
            if stream is self._line.next and not is_crowded:
                self._work.receive(self.change_if_due)
            return
        if is_crowded:
            self._dropped[stream] += 1
            return
        if dropped := self._dropped.pop(stream, 0):
            loss = f'{dropped} states were dropped, as the progression is too slow'
            state = replace(state, loss=loss)
        self._work.receive(lambda: self._handle(stream, state))

    def _handle(self, stream: StateSubscription, state: State) -> None:
        if stream is self._line.stream and not self._is_destroyed:
            self._receive(state)
        if self._line.next:
            # After the state, if that takes long.
            self._work.receive_first([self.change_if_due])

    def _on_breach(self, stream: StateSubscription, _breach: Breach) -> None:
        # The states before the violation may still wait.
        self._work.receive(lambda: self._handle_breach(stream))

    def _handle_breach(self, stream: StateSubscription) -> None:
        """Change to the next stream, or pause."""
        if not self._line.break_off(stream, self._wall_time()):
            return
        if self._line.next:
            self.change_if_due()
        else:
            self._log_pause()

    def _log_pause(self) -> None:
        if pause := self._line.pause:
            self._node.get_logger().info(f"the group '{self.name}' is paused: {pause.message}")

    def _receive(self, state: State) -> None:
        """Progress the group over a state of the stream in use, if it counts."""
        line, latest = self._line, self._line.latest
        caught_up, was_in_gap = line.catches_up, line.is_in_gap
        if not line.receive(state.valid_time, is_after_loss=bool(state.loss)):
            if line.is_in_gap and not was_in_gap:
                self._loss = state.loss
            return
        self._end_before(state.valid_time, latest)
        if caught_up:
            self._node.get_logger().info(
                f"the group '{self.name}' continues with another stream; "
                f'skipped {line.skipped} states that it had already processed'
            )
        loss, self._loss = state.loss or self._loss, ''
        if loss and latest is not None:
            gap = Gap(latest, state.valid_time)
            self._events.append(f'{loss}: states may be missing {gap}')
            self._node.get_logger().warning(f"the group '{self.name}': {self._events[-1]}")
        if self.group.undecided:
            self._progress(state)

    def _progress(self, state: State) -> None:
        self._states += 1
        for formula_id, since in self.group.waiting.items():
            had_kept = self._had_kept.get(formula_id)
            is_later = had_kept is not None and self._line.stream not in had_kept
            if is_later or since - state.valid_time > OTHER_CLOCK_NS:
                # States of another clock, as of a replayed recording, have no order with it.
                self.group.waiting[formula_id] = state.valid_time
            elif state.valid_time < since:
                self._states_before[formula_id] = self._states
        if self._is_large() or self._work.waiting_states:
            self._work.start(lambda: self._progressed(state), self.publish)
        else:
            self.publish(self._progressed(state))

    def _progressed(self, state: State) -> Sequence[FormulaResult]:
        """Progress the group over a state; return the new results."""
        begun = perf_counter()
        try:
            fields = sample_fields(state.message)
        except DyKnowError as error:
            failure = ReasoningError(error.message, error.code)
            return self.group.fail(failure, state.valid_time)
        results = self.group.progress(state.valid_time, fields)
        self._step_s = perf_counter() - begun
        return results


MAX_QUEUED_STATES: Final = 1000

HEAVY_PARTS: Final = 1000
"""With this many parts of formulas, work on all of them takes tens of milliseconds."""

HEAVY_TEXT: Final = 1000
"""With this many characters, parsing a formula takes tens of milliseconds."""

HEAVY_STEP_S: Final = 0.02
"""If the latest step took at least this long, the next one happens in the background."""

Result = TypeVar('Result')


class GroupWork:
    """Runs one piece of work of a group at a time: light work at once, heavy in the background.

    While heavy work runs, requests and states wait. Requests are served first.
    """

    def __init__(self, node: DyKnowNode, background: Background) -> None:
        self.is_busy = False
        self._node = node
        self._background = background
        self._requests: deque[Future] = deque()
        self._states: deque[Callable[[], None]] = deque()

    @property
    def waiting_states(self) -> int:
        """The number of states that wait."""
        return len(self._states)

    async def run(
        self, function: Callable[[], Result], is_heavy: Callable[[], bool] = lambda: False
    ) -> Result:
        """Run a function when it is its turn; return its result or raise its error.

        Args:
            function: the work; if it is heavy, it must not use rclpy.
            is_heavy: called before the work, when nothing else uses the group.
        """
        if self.is_busy:
            turn: Future = Future()
            self._requests.append(turn)
            await turn
        self.is_busy = True
        try:
            return await self._background.run(function, is_long=is_heavy())
        finally:
            self._next()

    def receive(self, process: Callable[[], None]) -> None:
        """Process a state now, or when the group is not busy any more.

        Args:
            process: processes the state; it may use `start` once, as its last step.
        """
        if self.is_busy:
            self._states.append(process)
        else:
            process()

    def receive_first(self, processes: Sequence[Callable[[], None]]) -> None:
        """Process states that came before all waiting ones, as `receive` does."""
        self._states.extendleft(reversed(processes))
        if not self.is_busy:
            self._next()

    def start(self, function: Callable[[], Result], finish: Callable[[Result], None]) -> None:
        """Run a function in the background for a state, and then pass on its result."""
        self.is_busy = True
        self._node.spawn(self._run_and_finish, function, finish)

    async def _run_and_finish(
        self, function: Callable[[], Result], finish: Callable[[Result], None]
    ) -> None:
        try:
            finish(await self._background.run(function))
        finally:
            self._next()

    def _next(self) -> None:
        self.is_busy = False
        while not self.is_busy and (self._requests or self._states):
            if self._requests:
                self.is_busy = True
                self._requests.popleft().set_result(None)
                continue
            process = self._states.popleft()
            try:
                process()
            except Exception as error:  # noqa: BLE001 - the states after it would wait for ever
                self._node.log_fault('a state that has waited', error)
