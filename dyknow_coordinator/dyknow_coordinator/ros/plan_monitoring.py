"""The action `~/monitor_plan` and the service `~/report_plan_action`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from dyknow_interfaces.action import MonitorPlan
from dyknow_interfaces.srv import ReportPlanAction
from rclpy.task import Future

from dyknow_common import DyKnowError, ExitCode, StreamConstraints, Verdict, check_name, listed
from dyknow_common.ros import (
    DyKnowNode,
    ParameterLimits,
    constraints_from_message,
    error_to_message,
)
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation import Answer, EvaluationRequest
from dyknow_coordinator.grounding.feature_sources import Grounding
from dyknow_coordinator.plan import (
    NO_STATE,
    Event,
    FormulaPosition,
    Plan,
    PlanExecution,
    PlanPhase,
    PlanVerdict,
    Step,
    withdrawal,
)
from dyknow_coordinator.ros.actions import CancellingActionServer
from dyknow_coordinator.ros.answers import (
    plan_from_goal,
    requested_grounding,
    verdict_to_message,
)
from dyknow_coordinator.ros.evaluation.formula_evaluation import FormulaEvaluation

Start = Callable[[EvaluationRequest], FormulaEvaluation]
"""Starts the evaluation of a formula."""


class MonitoredPlan:
    """A plan that is being executed, and the evaluations of its formulas.

    Args:
        grounding: of all formulas.
        constraints: of the states of all formulas.
        start: starts evaluations.
        on_change: called for every change of the status of a formula.

    Attributes:
        ended: a future that is done at the end of the plan.
        error: why the plan ended early.

    Raises:
        CoordinationError: if the plan is invalid.
    """

    def __init__(
        self,
        plan: Plan,
        grounding: Grounding,
        constraints: StreamConstraints,
        start: Start,
        on_change: Callable[[PlanVerdict], None],
    ) -> None:
        self.ended: Future = Future()
        self.error: CoordinationError | None = None
        self._execution = PlanExecution(plan)
        self._grounding = grounding
        self._constraints = constraints
        self._start = start
        self._on_change = on_change
        self._evaluations: dict[FormulaPosition, FormulaEvaluation] = {}
        self._verdicts = {
            position: PlanVerdict(position, formula.formula)
            for position, formula in plan.formulas_by_position.items()
        }

    @property
    def verdicts(self) -> tuple[PlanVerdict, ...]:
        """Status of all formulas."""
        return tuple(self._verdicts.values())

    def begin(self) -> None:
        """Start the plan."""
        self._take(self._execution.begin())

    def report(self, action: str, event: Event) -> None:
        """Apply a report on an action.

        Raises:
            CoordinationError: if the report is impossible.
        """
        self._take(self._execution.report(action, event))

    def cancel(self, reason: str = 'the plan was cancelled before its end') -> None:
        """End the plan early."""
        if not self._execution.has_ended:
            self.error = CoordinationError(reason, ExitCode.CANCELLED)
            self._take(self._execution.end())

    def _take(self, step: Step) -> None:
        for position in step.withdraw:
            evaluation = self._evaluations.get(position)
            if evaluation is None:  # It was about to start.
                self._update(position, phase=PlanPhase.WITHDRAWN, explanation=NO_STATE)
            else:  # It ends with the last report on it.
                evaluation.cancel(partial(self._reason, evaluation))
        for position in step.start:
            # A formula that cannot be started may end the plan before the next one.
            if self._execution.phase(position) is PlanPhase.RUNNING:
                self._evaluate(position)
        if self._execution.has_ended and not self._evaluations and not self.ended.done():
            self.ended.set_result(None)

    def _reason(self, evaluation: FormulaEvaluation) -> str:
        return f"withdrawn by plan '{self._execution.plan.name}': {_outcome(evaluation)}"

    def _evaluate(self, position: FormulaPosition) -> None:
        request = EvaluationRequest(
            formula=self._verdicts[position].formula,
            grounding=self._grounding,
            constraints=self._constraints,
            name=position.formula,
            plan=self._execution.plan.name,
            action=position.action,
            is_monitored=True,
        )
        try:
            evaluation = self._start(request)
        except DyKnowError as error:
            self._conclude(position, Answer(error=error))
            return
        self._evaluations[position] = evaluation
        self._update(position, phase=PlanPhase.RUNNING)
        evaluation.outcome.add_done_callback(lambda done: self._conclude(position, done.result()))

    def _conclude(self, position: FormulaPosition, answer: Answer) -> None:
        evaluation = self._evaluations.pop(position, None)
        if evaluation and self._execution.phase(position) is PlanPhase.WITHDRAWN:
            self._update(
                position,
                formula=answer.canonical_formula or self._verdicts[position].formula,
                phase=PlanPhase.WITHDRAWN,
                presumably_false=evaluation.progress.presumably_false,
                explanation=_outcome(evaluation),
            )
            self._take(Step())
            return
        step = self._execution.conclude(
            position,
            failed=answer.error is not None,
            violated=answer.verdict is Verdict.FALSE,
        )
        self._update(
            position,
            formula=answer.canonical_formula or self._verdicts[position].formula,
            phase=self._execution.phase(position),
            verdict=answer.verdict,
            decided_at=answer.decided_at,
            explanation=answer.explanation,
            error=answer.error,
        )
        self._take(step)

    def _update(self, position: FormulaPosition, **changes: Any) -> None:
        self._verdicts[position] = replace(self._verdicts[position], **changes)
        self._on_change(self._verdicts[position])


def _outcome(evaluation: FormulaEvaluation) -> str:
    """Return how a formula stood when it was withdrawn."""
    progress = evaluation.progress
    return withdrawal(progress.states_progressed, presumably_false=progress.presumably_false)


class PlanMonitoring:
    """All monitored plans.

    Args:
        start: starts evaluations.
        limits: of plans.
    """

    def __init__(self, node: DyKnowNode, start: Start, limits: ParameterLimits) -> None:
        self._start = start
        self._limits = limits
        self._plans: dict[str, MonitoredPlan] = {}
        node.serve(ReportPlanAction, self._report)
        self.server = CancellingActionServer(node, MonitorPlan, self._execute)

    async def _execute(self, goal: Any) -> Any:
        result = MonitorPlan.Result()
        name = goal.request.name
        try:
            plan = self._plans[name] = self._monitored_plan(goal)
        except DyKnowError as error:
            result.exit_status = error_to_message(error)
            self.server.finish(goal, error)
            return result
        plan.begin()
        with self.server.running(goal, plan.cancel):
            await plan.ended
        del self._plans[name]
        result.verdicts = [verdict_to_message(verdict) for verdict in plan.verdicts]
        if plan.error is not None:
            result.exit_status = error_to_message(plan.error)
        self.server.finish(goal, plan.error)
        return result

    def _monitored_plan(self, goal: Any) -> MonitoredPlan:
        request = goal.request
        check_name(request.name, CoordinationError)
        parts = len(request.formulas) + sum(1 + len(each.formulas) for each in request.actions)
        what = 'actions and formulas of the plan'
        self._limits.check('plan_part_limit', parts, what, ExitCode.INVALID_ARGUMENT)
        self._limits.check('plan_limit', len(self._plans) + 1, 'monitored plans')
        if request.name in self._plans:
            raise CoordinationError(
                f"a plan '{request.name}' is monitored already; give this one another name",
                ExitCode.ALREADY_EXISTS,
            )

        def publish(verdict: PlanVerdict) -> None:
            goal.publish_feedback(MonitorPlan.Feedback(verdict=verdict_to_message(verdict)))

        return MonitoredPlan(
            plan_from_goal(request),
            requested_grounding(request),
            constraints_from_message(request.constraints),
            self._start,
            publish,
        )

    def _report(self, request: Any, _: Any) -> None:
        if request.plan not in self._plans:
            known = f'these are: {listed(self._plans)}' if self._plans else 'there is none'
            raise CoordinationError(
                f"no plan '{request.plan}' is monitored ({known})", ExitCode.NOT_FOUND
            )
        if request.event not in set(Event):
            known = ', '.join(f'{each.name} ({each.value})' for each in Event)
            raise CoordinationError(f'there is no event {request.event}; use {known}')
        self._plans[request.plan].report(request.action, Event(request.event))
