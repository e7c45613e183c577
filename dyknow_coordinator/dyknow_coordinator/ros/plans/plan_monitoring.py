"""The action ~/monitor_plan and the service ~/report_plan_action."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

from dyknow_interfaces.action import MonitorPlan
from dyknow_interfaces.srv import ReportPlanAction
from rclpy.action import CancelResponse
from rclpy.task import Future

from dyknow_common import DyKnowError, ExitCode, StreamConstraints, Verdict
from dyknow_common.ros import DyKnowNode, constraints_from_message, fill_exit_status
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation.evaluation import EvaluationOutcome
from dyknow_coordinator.evaluation.request import EvaluationRequest
from dyknow_coordinator.grounding.grounding import Grounding
from dyknow_coordinator.plans.plan import (
    Event,
    FormulaPosition,
    Plan,
    PlanExecution,
    PlanPhase,
    PlanVerdict,
    Step,
)
from dyknow_coordinator.ros.actions import serve_action
from dyknow_coordinator.ros.answers import grounding_of
from dyknow_coordinator.ros.plans.plan_messages import plan_from_goal, verdict_to_message


class PlanFormulaEvaluation(Protocol):
    """What is asked of the evaluation of a formula."""

    @property
    def outcome(self) -> Future:
        """Is given its `EvaluationOutcome`."""

    @property
    def canonical_formula(self) -> str:
        """Empty until it is known."""

    @property
    def presumably_false(self) -> bool:
        """Whether it would be false if no further state came."""

    def cancel(self) -> None:
        """Ends it without a verdict; a second time does nothing."""


Start = Callable[[EvaluationRequest], PlanFormulaEvaluation]
"""Starts the evaluation of a formula."""


class MonitoredPlan:
    """A plan that is being executed, and the evaluations that go on for it.

    Args:
        grounding: of all formulas.
        constraints: of the states of all formulas.
        start: starts evaluations.
        tell: is told of every change.

    Raises:
        CoordinationError: when the plan makes no sense.
    """

    def __init__(
        self,
        plan: Plan,
        grounding: Grounding,
        constraints: StreamConstraints,
        start: Start,
        tell: Callable[[PlanVerdict], None],
    ) -> None:
        self.over: Future = Future()
        self.is_cancelled = False
        self._execution = PlanExecution(plan)
        self._grounding = grounding
        self._constraints = constraints
        self._start = start
        self._tell = tell
        self._verdicts = {
            place: PlanVerdict(place, formula.formula) for place, formula in plan.places.items()
        }
        self._evaluations: dict[FormulaPosition, PlanFormulaEvaluation] = {}

    @property
    def verdicts(self) -> tuple[PlanVerdict, ...]:
        """Of all formulas."""
        return tuple(self._verdicts.values())

    def begin(self) -> None:
        """The plan starts."""
        self._follow(self._execution.begin())

    def report(self, action: str, event: Event) -> None:
        """An action has started, succeeded or failed.

        Raises:
            CoordinationError: when that cannot be.
        """
        self._follow(self._execution.report(action, event))

    def cancel(self) -> None:
        """Ends the plan before its end."""
        if not self._execution.ended:
            self.is_cancelled = True
            self._follow(self._execution.end())

    def _follow(self, step: Step) -> None:
        for place in step.withdraw:
            evaluation = self._evaluations.pop(place)
            self._change(
                place,
                formula=evaluation.canonical_formula or self._verdicts[place].formula,
                phase=PlanPhase.WITHDRAWN,
                presumably_false=evaluation.presumably_false,
            )
            evaluation.cancel()
        for place in step.start:
            self._evaluate(place)
        if self._execution.ended and not self.over.done():
            self.over.set_result(None)

    def _evaluate(self, place: FormulaPosition) -> None:
        question = EvaluationRequest(
            formula=self._verdicts[place].formula,
            grounding=self._grounding,
            constraints=self._constraints,
            timeout=None,
            name=place.formula,
            plan=self._execution.plan.name,
            action=place.action,
        )
        evaluation = self._evaluations[place] = self._start(question)
        self._change(place, phase=PlanPhase.RUNNING)
        evaluation.outcome.add_done_callback(lambda done: self._conclude(place, done.result()))

    def _conclude(self, place: FormulaPosition, outcome: EvaluationOutcome) -> None:
        if self._execution.phase(place) is not PlanPhase.RUNNING:
            return  # It was withdrawn.
        evaluation = self._evaluations.pop(place)
        step = self._execution.settle(
            place,
            failed=outcome.error is not None,
            violated=outcome.verdict is Verdict.FALSE,
        )
        self._change(
            place,
            formula=evaluation.canonical_formula or self._verdicts[place].formula,
            phase=self._execution.phase(place),
            verdict=outcome.verdict,
            decided_at=outcome.decided_at,
            explanation=outcome.explanation,
            error=outcome.error,
        )
        self._follow(step)

    def _change(self, place: FormulaPosition, **news: Any) -> None:
        self._verdicts[place] = replace(self._verdicts[place], **news)
        self._tell(self._verdicts[place])


class PlanMonitoring:
    """The plans that are monitored for callers.

    Args:
        node: offers the action and the service.
        start: starts evaluations.
    """

    def __init__(self, node: DyKnowNode, start: Start) -> None:
        self._start = start
        self._plans: dict[str, MonitoredPlan] = {}
        self._goals: dict[bytes, MonitoredPlan] = {}
        node.serve(ReportPlanAction, self._report)
        self._action = serve_action(node, MonitorPlan, self._monitor, self._cancel, self._abandon)

    def destroy(self) -> None:
        """Frees the action server."""
        self._action.destroy()

    async def _monitor(self, goal: Any) -> Any:
        result = MonitorPlan.Result()
        name, key = goal.request.name, bytes(goal.goal_id.uuid)
        try:
            monitored = self._plans[name] = self._goals[key] = self._plan(goal)
        except DyKnowError as error:
            fill_exit_status(result.exit_status, error)
            goal.abort()
            return result
        monitored.begin()
        if goal.is_cancel_requested:
            monitored.cancel()
        await monitored.over
        del self._plans[name], self._goals[key]
        result.verdicts = [verdict_to_message(verdict) for verdict in monitored.verdicts]
        _finish(goal, result, monitored)
        return result

    def _plan(self, goal: Any) -> MonitoredPlan:
        request = goal.request
        if request.name in self._plans:
            raise CoordinationError(
                f"a plan '{request.name}' is monitored already; give this one another name",
                ExitCode.ALREADY_EXISTS,
            )

        def tell(verdict: PlanVerdict) -> None:
            goal.publish_feedback(MonitorPlan.Feedback(verdict=verdict_to_message(verdict)))

        return MonitoredPlan(
            plan_from_goal(request),
            grounding_of(request),
            constraints_from_message(request.constraints),
            self._start,
            tell,
        )

    def _report(self, request: Any, _: Any) -> None:
        if request.plan not in self._plans:
            there = f'these are: {", ".join(self._plans)}' if self._plans else 'there is none'
            raise CoordinationError(
                f"no plan '{request.plan}' is monitored ({there})", ExitCode.NOT_FOUND
            )
        if request.event not in set(Event):
            known = ', '.join(f'{each.name} ({each.value})' for each in Event)
            raise CoordinationError(f'there is no event {request.event}; use {known}')
        self._plans[request.plan].report(request.action, Event(request.event))

    def _cancel(self, goal: Any) -> CancelResponse:
        monitored = self._goals.get(bytes(goal.goal_id.uuid))
        if monitored is not None:
            monitored.cancel()
        return CancelResponse.ACCEPT

    def _abandon(self) -> None:
        for plan in list(self._plans.values()):
            plan.cancel()


def _finish(goal: Any, result: Any, monitored: MonitoredPlan) -> None:
    if not monitored.is_cancelled:
        goal.succeed()
        return
    text = 'the plan was cancelled before its end'
    fill_exit_status(result.exit_status, CoordinationError(text, ExitCode.CANCELLED))
    if goal.is_cancel_requested:
        goal.canceled()
    else:
        goal.abort()
