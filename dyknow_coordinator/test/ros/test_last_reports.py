"""Evaluations that end before a verdict: with the last report of the reasoning engine."""

from __future__ import annotations

from collections.abc import Coroutine
from dataclasses import replace
from typing import Any
from unittest.mock import AsyncMock, MagicMock, patch

import pytest
from dyknow_interfaces.msg import FormulaEpisodes, FormulaProgress, FormulaResult
from rclpy.task import Future

from dyknow_common import NO_CONSTRAINTS, ExitCode, Verdict
from dyknow_common.ros import nanoseconds_to_time
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation import Answer, EvaluationPhase, EvaluationRequest, Progress
from dyknow_coordinator.grounding.feature_sources import Grounding
from dyknow_coordinator.plan import Event, Plan, PlanAction, PlanFormula, PlanPhase, PlanVerdict
from dyknow_coordinator.ros.evaluation.formula_evaluation import FormulaEvaluation
from dyknow_coordinator.ros.plan_monitoring import MonitoredPlan


class World:
    """An evaluation that runs, and the limit of its wait for the last report."""

    def __init__(self, *, every_state: bool = True) -> None:
        context = MagicMock()
        context.names = iter(['states_1'])
        context.node.spawn = self._spawn
        self.limit: Future = Future()
        context.node.deadlines.after.return_value = self.limit
        self._work: list[Coroutine[Any, Any, None]] = []
        request = EvaluationRequest('F', every_state=every_state)
        self.evaluation = FormulaEvaluation(context, MagicMock(), request, lambda: None)
        self.group = self.evaluation._group = MagicMock()
        self.group.remove.side_effect = [True, False]
        self.evaluation.set_phase(EvaluationPhase.RUNNING)

    def _spawn(self, work: Any, *arguments: Any) -> None:
        self._work.append(work(*arguments))
        self.run()

    def run(self) -> None:
        """Run what waits for the last report, as far as it comes."""
        for each in self._work:
            try:
                each.send(None)
            except StopIteration:
                self._work.remove(each)

    def report(self, states: int, *, is_last: bool = False, presumably_false: bool = False) -> None:
        self.evaluation.receive_progress(
            FormulaProgress(
                states_progressed=states,
                residual_formula='F',
                is_last=is_last,
                presumably_false=presumably_false,
            )
        )
        self.run()

    def episodes(self, **counts: int) -> None:
        self.evaluation.receive_episodes(FormulaEpisodes(**counts))
        self.run()

    @property
    def answer(self) -> Answer | None:
        """The answer, if it has ended."""
        found: Answer | None = self.evaluation.outcome.result()
        return found


@pytest.mark.parametrize('undecided', [0, 8])
@pytest.mark.parametrize('is_progress_first', [True, False])
def test_true_at_the_timeout_depends_on_the_last_states(
    undecided: int, *, is_progress_first: bool
) -> None:
    world = World()
    world.report(40)
    world.episodes(holds=40)
    world.evaluation.expire(3.0)
    world.report(41)  # It was on its way.
    assert world.answer is None
    if is_progress_first:
        world.report(48, is_last=True)
        assert world.answer is None
    world.episodes(holds=48 - undecided, undecided=undecided)
    if not is_progress_first:
        world.report(48, is_last=True)
    assert world.answer
    if undecided:
        assert world.answer.error
        assert world.answer.error.code is ExitCode.TIMEOUT
        assert 'undecided from 8' in world.answer.error.message
    else:
        assert world.answer.verdict is Verdict.TRUE


def test_an_engine_that_reports_no_more() -> None:
    world = World()
    world.report(40)
    world.episodes(holds=40)
    world.evaluation.expire(3.0)
    world.limit.set_result(None)
    world.run()
    assert world.answer
    assert world.answer.verdict is Verdict.UNDECIDED
    assert world.answer.error
    assert world.answer.error.code is ExitCode.TIMEOUT
    assert 'the last states are not known' in world.answer.error.message


def test_a_cancellation_and_the_timeout_while_the_last_report_comes() -> None:
    world = World(every_state=False)
    world.report(40)
    world.evaluation.cancel(lambda: f'after {world.evaluation.progress.states_progressed} states')
    world.evaluation.expire(3.0)
    world.report(48, is_last=True)
    assert world.answer
    assert world.answer.error
    assert world.answer.error.message == 'after 48 states'
    assert world.group.remove.call_count == 2


def test_a_formula_that_is_decided_is_not_removed_for_its_timeout_too() -> None:
    """A cancelled wait calls what waits for it: each formula cost a request more."""
    world = World(every_state=False)
    evaluation, expiry = world.evaluation, Future()
    evaluation._context.node.deadlines.after.side_effect = [expiry, world.limit]  # type: ignore[attr-defined]
    evaluation.request = replace(evaluation.request, timeout_s=3.0)
    with patch.multiple(evaluation, _prepare=AsyncMock(), _start=AsyncMock()):
        world._spawn(evaluation.run)
        evaluation.receive_result(FormulaResult(verdict=FormulaResult.TRUE))
        world.run()
    assert expiry.cancelled()
    world.group.remove.assert_not_called()


def test_no_name_ends_an_evaluation_whose_formula_is_not_parsed_yet() -> None:
    world = World()
    assert world.evaluation.canonical_formula == ''
    assert set(world.evaluation.names) == {'F'}


def test_without_a_group_an_evaluation_ends_at_once() -> None:
    world = World()
    world.evaluation._group = None
    world.evaluation.cancel()
    assert world.answer


class FakeEvaluation:
    """An evaluation in a plan."""

    def __init__(self, request: EvaluationRequest) -> None:
        self.request = request
        self.outcome: Future = Future()
        self.progress = Progress(62, 62, presumably_false=True)
        self.canonical_formula = request.formula
        self.waits_for = self.silence = ''
        self.on_progress: Any = None
        self.until: int | None = None
        self.reason: Any = None

    def withdraw(self, until: int, reason: Any) -> None:
        self.until, self.reason = until, reason

    def end(self, answer: Answer | None = None, *, is_complete: bool = True) -> str:
        """End, by default as withdrawn; return the reason."""
        reason = self.reason(None if is_complete else self.until) if answer is None else ''
        self.outcome.set_result(answer or Answer(error=CoordinationError(reason)))
        return str(reason)


class Driven:
    """A plan whose only action has been executed, with one formula."""

    def __init__(self, *, stop_at_violation: bool = False) -> None:
        self.told: list[PlanVerdict] = []
        self.evaluations: list[FakeEvaluation] = []
        plan = Plan(
            'p',
            (PlanAction('drive', (PlanFormula('f', 'F'),)), PlanAction('dock')),
            stop_at_violation=stop_at_violation,
        )
        self.plan = MonitoredPlan(
            plan, Grounding.AUTO, NO_CONSTRAINTS, self._start, self.told.append
        )
        self.plan.begin(0)
        self.plan.report('drive', Event.STARTED, 10)

    def _start(self, request: EvaluationRequest) -> Any:
        self.evaluations.append(FakeEvaluation(request))
        return self.evaluations[-1]

    @property
    def evaluation(self) -> FakeEvaluation:
        """The only one."""
        return self.evaluations[0]

    @property
    def verdict(self) -> PlanVerdict:
        """The latest one."""
        return self.plan.verdicts[0]


def test_a_plan_ends_with_the_last_reports_on_withdrawn_formulas() -> None:
    driven = Driven()
    driven.plan.report('dock', Event.FAILED, 60)
    driven.plan.report('drive', Event.SUCCEEDED, 70)
    assert not driven.plan.ended.done()
    assert (driven.evaluation.request.since, driven.evaluation.until) == (10, 70)
    driven.evaluation.progress = Progress(69)
    assert driven.evaluation.end() == "withdrawn by plan 'p': held in 69 states"
    assert driven.plan.ended.done()
    assert driven.told[-1] == driven.verdict
    assert driven.verdict.phase is PlanPhase.WITHDRAWN
    assert (driven.verdict.explanation, driven.verdict.presumably_false) == (
        'held in 69 states',
        False,
    )


@pytest.mark.parametrize('stop', [False, True])
def test_a_verdict_from_a_late_state_of_the_period_counts(*, stop: bool) -> None:
    driven = Driven(stop_at_violation=stop)
    driven.plan.report('drive', Event.SUCCEEDED, 70)
    driven.evaluation.end(Answer(Verdict.FALSE, 70, explanation='so'))
    assert driven.verdict.phase is PlanPhase.DECIDED
    assert driven.verdict.is_violation
    assert (driven.verdict.decided_at, driven.verdict.explanation) == (70, 'so')
    assert driven.plan.ended.done() == stop


def test_a_verdict_from_a_state_after_the_period_does_not_count() -> None:
    driven = Driven()
    driven.plan.report('drive', Event.SUCCEEDED, 70)
    driven.evaluation.end(Answer(Verdict.FALSE, 71))
    assert driven.verdict.phase is PlanPhase.WITHDRAWN
    assert driven.verdict.verdict is Verdict.UNDECIDED


@pytest.mark.parametrize('ending', ['late', 'failed'])
def test_a_formula_whose_last_states_are_not_known(ending: str) -> None:
    driven = Driven()
    driven.evaluation.progress = Progress(14, 2_000_000_000)
    driven.plan.report('drive', Event.SUCCEEDED, 5_500_000_000)
    if ending == 'late':
        driven.evaluation.silence = 'topic /a is silent'
        driven.evaluation.end(is_complete=False)
        reason = '; it waited for states: topic /a is silent'
    else:
        driven.evaluation.end(Answer(error=CoordinationError('a gap')))
        reason = ': a gap'
    assert driven.verdict.explanation == (
        f'held in 14 states; not evaluated in the last 3.5 s{reason}'
    )
    assert driven.verdict.phase is PlanPhase.WITHDRAWN
    assert driven.verdict.error is None


def test_a_plan_says_what_a_formula_waits_for() -> None:
    driven = Driven()
    for waits_for in ('', 'topic /a is silent', 'topic /a is silent', ''):
        driven.evaluation.waits_for = waits_for
        driven.evaluation.on_progress()
    assert [each.explanation for each in driven.told] == [
        '',
        'it waits for states: topic /a is silent',
        '',
    ]
    driven.plan.report('drive', Event.SUCCEEDED, 70)
    driven.evaluation.end()
    assert driven.verdict.explanation == (
        'not fulfilled after 62 states; not evaluated in the last 8 ns; '
        'it waited for states: topic /a is silent'
    )


def test_a_withdrawn_evaluation_awaits_the_late_states() -> None:
    world = World(every_state=False)
    world.report(40)
    told: list[int | None] = []
    world.evaluation.withdraw(48, lambda end: str(told.append(end)))
    world.group.remove.assert_called_once_with(world.evaluation, 48)
    world.report(47)
    assert world.answer is None
    world.report(48, is_last=True)
    assert world.answer
    assert told == [None]
    world.group.note_removed.assert_called_once_with(world.evaluation)


def test_a_withdrawn_evaluation_gets_a_verdict_from_the_late_states() -> None:
    world = World(every_state=False)
    world.evaluation.withdraw(48, lambda _: '')
    world.evaluation.receive_result(
        FormulaResult(verdict=int(Verdict.FALSE), decided_at=nanoseconds_to_time(45))
    )
    world.report(45, is_last=True)
    assert world.answer
    assert (world.answer.verdict, world.answer.decided_at) == (Verdict.FALSE, 45)
    # It has not been removed, as it was decided before.
    world.group.note_removed.assert_not_called()


def test_late_states_that_do_not_come() -> None:
    world = World(every_state=False)
    world.report(40)
    limits = [world.limit, Future()]
    world.evaluation._context.node.deadlines.after.side_effect = limits  # type: ignore[attr-defined]
    world.group.remove.side_effect = [True, True]
    told: list[int | None] = []
    world.evaluation.withdraw(48, lambda end: str(told.append(end)))
    world.limit.set_result(None)
    world.run()
    assert world.answer is None  # The last report may say more.
    world.report(44, is_last=True)
    assert world.answer
    assert told == [48]
