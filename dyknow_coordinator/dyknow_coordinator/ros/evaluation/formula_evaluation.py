"""The evaluation of one formula, from the request to the answer: section VII of the paper.

The steps of that section are numbered in the code; two of them change places. The reasoning engine
must know the domains (7) before it can report which ground features a state must hold, so that
step precedes the choice of the state stream (6). And it must subscribe before the state stream
exists (9), or it would miss the first states.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Final

from dyknow_interfaces.msg import SymbolGrounding as SymbolGroundingMessage
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.task import Future

from dyknow_common import (
    DyKnowError,
    ExitCode,
    Margin,
    StandingVerdicts,
    StreamConstraints,
    Symbol,
    Verdict,
    listed,
    one_line,
    without_generated_text,
)
from dyknow_common.ros import from_message, to_message
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation import (
    Answer,
    Evaluation,
    EvaluationPhase,
    EvaluationRequest,
    History,
    Progress,
)
from dyknow_coordinator.grounding.candidate_search import check_symbols, sort_names
from dyknow_coordinator.grounding.compared_objects import check_compared_objects
from dyknow_coordinator.grounding.completion import completed
from dyknow_coordinator.grounding.declared_properties import unknown_features
from dyknow_coordinator.grounding.feature_sources import Grounding, SymbolGrounding, with_caveat
from dyknow_coordinator.grounding.region_relations import ground_features
from dyknow_coordinator.grounding.state_specification import FormulaInputs, PreparedFormula
from dyknow_coordinator.grounding.units import (
    feature_units,
    with_unit,
    with_units_of_margins,
)
from dyknow_coordinator.reporting.evaluation_status import EvaluationStatus
from dyknow_coordinator.reporting.peer_reasons import with_reasons_of_peers
from dyknow_coordinator.ros.context import CoordinatorContext, check_domains
from dyknow_coordinator.ros.evaluation.evaluation_group import (
    EvaluationGroup,
    EvaluationGroups,
    find_candidates,
)
from dyknow_coordinator.ros.evaluation.last_report import (
    LAST_REPORT_S,
    LATE_STATES_S,
    LastReport,
)

RETRY_DELAY_S: Final = 1.0
"""The time until it is tried again to restart a formula with other objects."""

_MAX_SHOWN: Final = 100
"""The most groundings in the status of an evaluation, which is published each second."""


class FormulaEvaluation(Evaluation):
    """Grounds a formula, lets the reasoning engine evaluate it, and cleans up.

    Args:
        request: the formula and the options of its client.
        on_change: called when its status has changed.

    Attributes:
        outcome: a future of the `Answer`.
        progress: the latest of the reasoning engine.
        margin: the latest one, if it was asked for.
        episodes: the verdicts, if the formula is asked at every state.
        needs_peers: True if peers evaluate parts of it.
        on_progress: called for each FormulaProgress and FormulaEpisodes, and when the evaluation
            begins to wait.
        on_topics: called before its first state if it has a black box: the recorder must subscribe.
    """

    def __init__(
        self,
        context: CoordinatorContext,
        groups: EvaluationGroups,
        request: EvaluationRequest,
        on_change: Callable[[], None],
    ) -> None:
        super().__init__(self._set_outcome)
        self.name = next(context.names)
        self.request = request
        self.canonical_formula = ''
        # With its units, for guards, black boxes and pages, which explain it themselves.
        self._formula = ''
        self.outcome: Future = Future()
        self.progress = Progress()
        self.margin: Margin | None = None
        self.on_progress: Callable[[], None] = lambda: None
        self.on_topics: Callable[[], None] = lambda: None
        self.history = History()
        self.episodes = StandingVerdicts()
        self._last_report = LastReport(context.node)
        self._context = context
        self._groups = groups
        self._on_change = on_change
        self._started = context.node.now()
        self._group: EvaluationGroup | None = None
        # Changes of semantics: in total, and before the latest look-up of the objects of its sorts.
        # While the evaluation starts, changes are only counted.
        self._changes, self._seen_changes, self._is_starting = 0, 0, True
        # Its verdict with the present objects of its sorts, if the verdict needs no state.
        self._standing_answer: Answer | None = None
        self._restart_fault = ''
        self._units: dict[str, str] = {}
        # The objects of its sorts, also of parts that peers evaluate.
        self._domains: Mapping[str, tuple[str, ...]] = {}
        self.needs_peers = False
        self._last_groundings: tuple[SymbolGrounding, ...] = ()
        self._last_topics: tuple[str, ...] = ()

    def groundings(self, limit: int | None = None) -> tuple[SymbolGrounding, ...]:
        """Return the streams of its first ground features; after the end, the last ones."""
        if self._group is None:
            return self._last_groundings[:limit]
        states = self._group.states
        return states.inputs.candidates.symbol_groundings(states.chosen[:limit])

    def _topics(self) -> tuple[str, ...]:
        """Return the topics that its states are made from; after the end, the last ones."""
        return self._last_topics if self._group is None else self._group.states.topics

    @property
    def title(self) -> str:
        """The name that operators see: without one of its own, the formula as it was written."""
        return self.request.name or one_line(self.request.formula)

    @property
    def names(self) -> tuple[str, ...]:
        """The names that end it: its own, or without one, the formula as sent and in full."""
        formulas = (self.title, self.request.formula, self.canonical_formula)
        return (self.request.name,) if self.request.name else tuple(filter(None, formulas))

    @property
    def answer(self) -> Answer | None:
        """The answer; None before the end."""
        return self.outcome.result() if self.outcome.done() else None

    @property
    def waits_for(self) -> str:
        """Why no state comes, or it leaves out objects; empty if it does not wait."""
        if self._restart_fault:
            return self._restart_fault
        if self._standing_answer is not None:
            return f'{self._standing_answer.explanation}; it begins again with other objects'
        return self._group.waits_for if self._group is not None else ''

    @property
    def silence(self) -> str:
        """Why its states do not come; empty if they come or that is unknown."""
        return '' if self._group is None else self._group.states.waits_for

    async def run(self) -> None:
        """Take all steps, wait for the outcome and clean up; never raises."""
        expiry: Future = Future()
        if (timeout_s := self.request.timeout_s) is not None:
            remaining_s = max(timeout_s - self.request.delay_s, 0.0)
            expiry = self._context.node.deadlines.after(remaining_s)
            expiry.add_done_callback(
                lambda done: None if done.cancelled() else self.expire(timeout_s)
            )
        try:
            await self._start(await self._prepare())
            self._is_starting = False
            if self.request.restart_on_change:  # Objects may have come meanwhile.
                await self.update_domains()
            await self.outcome
        except DyKnowError as error:
            self.fail(error)
        except Exception as error:  # noqa: BLE001 - the client must get an answer
            self._context.node.log_fault(self.name, error)
            self.fail(self._context.fault(error))
        expiry.cancel()
        await self._last_report.wait()
        self._leave()

    async def update_domains(self) -> None:
        """Restart if a sort in the formula has other objects now."""
        self._changes += 1
        if self._is_starting:
            return
        self._is_starting = True
        try:
            while self._seen_changes != self._changes and not self.has_ended:
                self._seen_changes = self._changes
                await self._follow_domains()
        finally:
            self._is_starting = False

    async def _follow_domains(self) -> None:
        """Restart if its sorts have other objects, once streams carry all their features."""
        node = self._context.node
        try:
            is_same = await self._context.clients.domains(self._domains) == self._domains
            prepared = None if is_same else await self._prepare()
        except DyKnowError as error:
            former = self._restart_fault
            self._restart_fault = f'it cannot restart with other objects yet: {error}'
            if self._restart_fault != former:
                self.add_event(self._restart_fault)
            if error.code is not ExitCode.NOT_FOUND:  # It may pass without a change of semantics.
                due = node.deadlines.after(RETRY_DELAY_S)
                due.add_done_callback(lambda _: node.spawn(self.update_domains))
            return
        self._restart_fault = ''
        if prepared is None:
            return
        if self.outcome.done():
            self._context.cleanup.destroy_group(prepared.group_id)
            return
        self._leave()
        objects = '; '.join(
            f'{sort}: {listed(found) or "none"}' for sort, found in self._domains.items()
        )
        self.add_event(f'restarted with {objects}')
        self.progress, self.episodes = Progress(), StandingVerdicts()
        self.margin = self._standing_answer = None
        self._last_report.has_come = False
        try:
            await self._start(prepared)
        except DyKnowError as error:
            self.fail(error)

    def receive_result(self, result: Any) -> None:
        """End with a FormulaResult of the reasoning engine (step 8)."""
        answer = from_message(Answer, result)
        self._note_margin(answer.margin)
        if answer.error or answer.decided_at is not None:
            self._last_report.expect(LAST_REPORT_S)
        if (error := answer.error) is None:
            # With other objects, one that needs no state now may need some.
            if self.request.restart_on_change and self._domains and answer.decided_at is None:
                self._standing_answer = answer
                self.set_phase(self.phase)
            else:
                self.decide(answer.verdict, answer.decided_at, answer.explanation)
            return
        fault = self._group.states.fault if self._group else ''
        if fault and error.code is ExitCode.CONSTRAINT_VIOLATION:
            text = f'{error.message}; the streams were replaced: {fault}'
            error = CoordinationError(text, error.code)
        self.fail(error)

    def receive_progress(self, message: Any) -> None:
        """Record a FormulaProgress of the reasoning engine."""
        before, progress = self.progress, from_message(Progress, message)
        self.progress = progress = progress.of_remainder() if self.needs_peers else progress
        self._note_margin(progress.margin)
        for event in progress.events:
            self.add_event(event)
        is_last = self._last_report.has_come = bool(message.is_last)
        if is_last or progress.presumably_false != before.presumably_false:
            self._on_change()
        if is_last:
            self._note_last_report()
            return
        # Before the first state that counts, others may come.
        if self._group is not None and (progress.states_progressed or not self.request.since):
            self._group.states.note_progress(progress.latest_valid_time)
        self.on_progress()

    @property
    def _is_up_to_date(self) -> bool:
        """True if the last reports on the formula have come; they are on two topics."""
        states = self.episodes.states if self.request.every_state else None
        return self._last_report.has_come and states in {None, self.progress.states_progressed}

    def _note_last_report(self) -> None:
        if self._last_report.has_come if self.has_ended else self._is_up_to_date:
            self._last_report.end_wait()

    async def _end_after_last_report(self, end: Callable[[], None]) -> None:
        """Have the formula removed, and end with the last report on it; a verdict may be first."""
        if self._group is not None and self._group.remove(self):
            self._last_report.expect(LAST_REPORT_S)
        await self._last_report.wait()
        end()

    def _note_margin(self, margin: Margin | None) -> None:
        if margin is not None:
            self.margin = with_unit(margin, self._units)

    def receive_episodes(self, episodes: Any) -> None:
        """Record a FormulaEpisodes of the reasoning engine, and report what has changed."""
        if self.has_ended:
            return
        before = self.episodes
        verdicts = from_message(StandingVerdicts, episodes)
        self.episodes = with_units_of_margins(verdicts, self._units)
        if change := self.episodes.change(before):
            self.history.add(change)
            self._log_change(change)
            self._on_change()
        self._note_last_report()
        self.on_progress()

    @property
    def logger(self) -> RcutilsLogger:
        """The logger of what people are told of it."""
        return self._context.outcome_logger(is_followed=self.request.is_followed)

    def _log_change(self, change: str) -> None:
        # A logger of rclpy has one severity for each call in the code.
        logger, text = self.logger, f'{self.title}: {change}'
        if self.episodes.is_violated:
            logger.warning(text)
        else:
            logger.info(text)

    def expire(self, timeout_s: float) -> None:
        """End because the timeout has passed: with a verdict, if one is known from all states."""
        self._context.node.spawn(self._end_after_last_report, partial(self._expire, timeout_s))

    def cancel(self, reason: str | Callable[[], str] = 'cancelled by the caller') -> None:
        """End because the client needs no answer any more; the reason may need the last report."""
        cancel = super().cancel
        self._context.node.spawn(
            self._end_after_last_report,
            lambda: cancel(reason if isinstance(reason, str) else reason()),
        )

    def withdraw(self, until: int, reason: Callable[[int | None], str]) -> None:
        """End like a cancellation, once the states until a valid time are known.

        A verdict from these states may be first. They are awaited for LATE_STATES_S.

        Args:
            until: the valid time in nanoseconds.
            reason: called with this time if not all states until then are known, else with None.
        """
        self._context.node.spawn(self._withdraw, until, reason)

    async def _withdraw(self, until: int, reason: Callable[[int | None], str]) -> None:
        is_complete, group = False, self._group
        if group is not None and group.remove(self, until):
            self._last_report.expect(LATE_STATES_S)
            await self._last_report.wait()
            if self.has_ended:
                return
            if is_complete := self._last_report.has_come:
                group.note_removed(self)
        cancel = super().cancel
        await self._end_after_last_report(lambda: cancel(reason(None if is_complete else until)))

    def _expire(self, timeout_s: float) -> None:
        verdict, text = self.episodes.verdict, self.episodes.text
        # Later states may be undecided.
        is_known = self._is_up_to_date or verdict is Verdict.FALSE
        if (answer := self._standing_answer) is not None:
            self.decide(answer.verdict, None, answer.explanation)
        elif verdict is not Verdict.UNDECIDED and is_known:
            episodes = self.episodes.latest_episodes
            self.decide(verdict, episodes[0].decided_at if episodes else None, text)
        elif self.episodes.holds:
            last = '' if self._is_up_to_date else '; the last states are not known'
            late = f'no verdict from some states within {timeout_s:g} s: it {text}{last}'
            self.fail(CoordinationError(late, ExitCode.TIMEOUT))
        else:
            super().expire(timeout_s)

    def set_phase(self, phase: EvaluationPhase) -> None:
        """Set the phase, unless the evaluation has ended, and report it."""
        if self._standing_answer is not None:
            phase = EvaluationPhase.WAITING
        super().set_phase(phase)
        self._on_change()
        if phase is EvaluationPhase.WAITING:
            self.on_progress()

    def add_event(self, event: str) -> None:
        """Record an event, and report it at once: the verdict may be the next thing."""
        self.history.add(event)
        self._context.node.get_logger().info(f'{self.name}: {event}')
        self._on_change()
        self.on_progress()

    def report(self) -> Progress:
        """Return the progress for its client, with the events since the last report."""
        return replace(
            self.progress.with_episodes(self.episodes if self.request.every_state else None),
            streams=tuple(each.stream for each in self.groundings()),
            events=tuple(self.history.read()),
            waits_for=self.waits_for,
            margin=self.margin,
        )

    def status(self) -> EvaluationStatus:
        """Return the status for operators."""
        answer = self.answer or Answer()
        group, request = self._group, self.request
        progress = self.progress.with_episodes(self.episodes if request.every_state else None)
        # Simulated time is 0 until /clock comes; then it begins anywhere.
        self._started = self._started or self._context.node.now()
        return EvaluationStatus(
            name=self.title,
            formula=self._formula or self.canonical_formula or request.formula,
            formula_text=one_line(request.formula),
            phase=self.phase,
            started=self._started,
            plan=request.plan,
            action=request.action,
            formula_group_id=group.group_id if group else 0,
            state_stream=group.states.stream.topic if group else '',
            groundings=self.groundings(_MAX_SHOWN),
            topics=self._topics(),
            record=request.record,
            events=self.history.latest,
            states_progressed=progress.states_progressed,
            latest_valid_time=progress.latest_valid_time or None,
            residual_formula=progress.residual_formula,
            presumably_false=progress.presumably_false,
            episodes=progress.episodes,
            waits_for=self.waits_for,
            margin=self.margin,
            probability=None if self.has_ended else progress.probability,
            verdict=answer.verdict,
            decided_at=answer.decided_at,
            explanation=answer.explanation,
            error=answer.error,
        )

    def missing_states(self) -> str:
        """Return that no state comes, and why; empty if states come or that is unknown."""
        reason = self.silence
        if not reason:
            return ''
        since = ' for a while' if self.progress.states_progressed else ''
        return f'no state has come{since}: {reason}'

    async def _prepare(self) -> PreparedFormula:
        """Find the inputs of what is evaluated here, with a formula group of its own."""
        request = self.request
        prepared = await self._grounded(request.formula, request.grounding)
        domains, canonical = prepared.inputs.domains, self.canonical_formula
        remaining, parts = await self._pushed_down(prepared)
        if remaining:
            self._context.cleanup.destroy_group(prepared.group_id)
            for part in parts:
                self.add_event(part)
            try:  # It names the streams of verdicts.
                prepared = await self._grounded(remaining, Grounding.AUTO)
            finally:
                self.canonical_formula = canonical
            self._formula = prepared.formula
        self._domains, self.needs_peers = domains, bool(remaining)
        return prepared

    async def _pushed_down(self, prepared: PreparedFormula) -> tuple[str, tuple[str, ...]]:
        """Return what peers leave of a formula, empty for all of it, and what they evaluate."""
        request, inputs, clients = self.request, prepared.inputs, self._context.clients
        period = request.constraints.sample_period
        has_others = request.constraints != StreamConstraints(sample_period=period)
        needs_values = request.margin or request.every_state or request.record is not None
        if needs_values or has_others or inputs.unknown or not clients.federation.alive:
            return '', ()
        chosen = inputs.candidates.choose(inputs.features)
        groundings = inputs.candidates.symbol_groundings(chosen)
        return await clients.pushed_down(
            prepared.formula,
            inputs.domains,
            [to_message(each, SymbolGroundingMessage()) for each in groundings],
            period,
        )

    async def _grounded(self, text: str, grounding: Grounding) -> PreparedFormula:
        """Find the inputs of a formula, with a formula group of its own."""
        clients, request = self._context.clients, self.request
        # Step 1 is the client's request. Step 2: a formula group with the formula in it.
        name = next(self._context.names)
        group_id = await clients.create_group(name)
        try:
            formula_id, formula, symbols = await self._add_formula(text, grounding, group_id, name)
            # Step 4: the domain of each sort.
            domains = await clients.domains(sort_names(symbols))
            check_domains(self._context.limits, symbols, domains)
            await check_compared_objects(self.canonical_formula, domains, clients.query)
            unknown: dict[str, tuple[float, float]] = {}
            if grounding is not Grounding.SYNTACTIC:
                unknown = await unknown_features(symbols, clients.query)
            # Step 5: the streams that match each feature.
            candidates = await find_candidates(self._context, symbols, grounding)
            # Step 7: the reasoning engine subscribes before the first state is published. Given
            # the domains, it knows the ground features that each state must hold.
            topic = self._context.state_topic(name)
            results = self._context.results.topic
            await clients.evaluate_group(group_id, domains, topic, results, unknown=unknown)
            features = ground_features(await clients.symbols(group_id))
            candidates.choose(features)
        except BaseException:
            self._context.cleanup.destroy_group(group_id)
            raise
        inputs = FormulaInputs(
            symbols, grounding, features, candidates, domains, request.constraints, unknown
        )
        return PreparedFormula(name, group_id, formula_id, formula, inputs)

    async def _add_formula(
        self, formula: str, grounding: Grounding, group_id: int, name: str
    ) -> tuple[int, str, tuple[Symbol, ...]]:
        """Add a formula to a group; return its id, its text with all sorts, its symbols."""
        clients, request = self._context.clients, self.request
        added = await clients.add_formula(group_id, name, formula, request)
        formula_id, self.canonical_formula = added
        # Step 3: the symbols of the formula.
        symbols = await clients.symbols(group_id)
        check_symbols(symbols, grounding)
        if request.margin and grounding is not Grounding.SYNTACTIC:
            self._units = await feature_units(symbols, clients.query)
        formula = await completed(self.canonical_formula, symbols, clients.domains, clients.query)
        if formula == self.canonical_formula:
            return formula_id, formula, symbols
        await clients.remove_formula(group_id, formula_id)
        try:
            added = await clients.add_formula(group_id, name, formula, request)
            formula_id, self.canonical_formula = added
        except DyKnowError as error:  # At a position in a text that nobody wrote.
            plain = without_generated_text(error.message, 'formula')
            raise CoordinationError(plain, error.code) from None
        self._formula = formula
        return formula_id, formula, await clients.symbols(group_id)

    async def _start(self, prepared: PreparedFormula) -> None:
        """Start the evaluation of the formula, in its own group or another one."""
        # Step 6: one state stream from the streams of the ground features. Formulas over the same
        # streams share it, and the group. A formula without features needs no states.
        try:
            group = self._groups.find(prepared.inputs) if prepared.inputs.features else None
            self._group = group or self._groups.create(
                prepared.group_id, prepared.name, prepared.inputs
            )
        except DyKnowError:
            self._context.cleanup.destroy_group(prepared.group_id)
            raise
        if self.request.record is not None:
            self.on_topics()
        if group is not None:
            self._context.cleanup.destroy_group(prepared.group_id)
            await group.join(self, prepared.formula)
        else:
            # Steps 9 to 11: the stream manager has a stream processing engine make the states.
            await self._group.start(self, prepared.formula_id)
        if self.outcome.done():
            # The evaluation has ended meanwhile.
            await self._last_report.wait()
            self._leave()
        # Step 12 happens in the reasoning engine; step 8 is `receive_result`, step 13 is in
        # `StateSupervisor`.

    def _leave(self) -> None:
        if self._group is not None:
            self._last_groundings, group = self.groundings(), self._group
            self._last_topics = self._topics()
            self._group = None
            group.leave(self)

    def _set_outcome(self, answer: Answer) -> None:
        if self.request.every_state:
            answer = replace(answer, episodes=self.episodes)
            if self.episodes.fails:
                answer = replace(answer, verdict=Verdict.FALSE)
        groundings = self.groundings()
        if answer.error is None:
            explanation = answer.explanation
            if self.needs_peers:
                explanation = with_reasons_of_peers(explanation)
            answer = replace(answer, explanation=with_caveat(explanation, groundings))
        self.outcome.set_result(
            replace(
                answer,
                canonical_formula=self.canonical_formula,
                groundings=groundings,
                margin=self.margin,
            )
        )
        self._on_change()
