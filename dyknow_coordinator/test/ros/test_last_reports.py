"""Evaluations that end before a verdict: with the last report of the reasoning engine."""

from __future__ import annotations

from collections.abc import Coroutine
from typing import Any
from unittest.mock import MagicMock

import pytest
from dyknow_interfaces.msg import FormulaEpisodes, FormulaProgress
from rclpy.task import Future

from dyknow_common import NO_CONSTRAINTS, ExitCode, Verdict
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


def test_without_a_group_an_evaluation_ends_at_once() -> None:
    world = World()
    world.evaluation._group = None
    world.evaluation.cancel()
    assert world.answer


class FakeEvaluation:
    """An evaluation in a plan."""

    def __init__(self, request: EvaluationRequest) -> None:
        self.outcome: Future = Future()
        self.progress = Progress(62, presumably_false=True)
        self.canonical_formula = request.formula
        self.reason: Any = None

    def cancel(self, reason: Any) -> None:
        self.reason = reason


def test_a_plan_ends_with_the_last_reports_on_withdrawn_formulas() -> None:
    evaluations: list[Any] = []

    def start(request: EvaluationRequest) -> Any:
        evaluations.append(FakeEvaluation(request))
        return evaluations[-1]

    told: list[PlanVerdict] = []
    plan = Plan('p', (PlanAction('drive', (PlanFormula('f', 'F'),)),))
    monitored = MonitoredPlan(plan, Grounding.AUTO, NO_CONSTRAINTS, start, told.append)
    monitored.begin()
    monitored.report('drive', Event.STARTED)
    monitored.report('drive', Event.SUCCEEDED)
    assert not monitored.ended.done()
    (evaluation,) = evaluations
    evaluation.progress = Progress(69)
    assert evaluation.reason() == "withdrawn by plan 'p': held in 69 states"
    evaluation.outcome.set_result(Answer())
    assert monitored.ended.done()
    assert told[-1] == monitored.verdicts[0]
    assert told[-1].phase is PlanPhase.WITHDRAWN
    assert (told[-1].explanation, told[-1].presumably_false) == ('held in 69 states', False)
