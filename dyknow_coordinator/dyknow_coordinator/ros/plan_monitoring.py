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
from dyknow_coordinator.ros.actions import CancellingActionServer, is_of_former_run
from dyknow_coordinator.ros.answers import (
    plan_from_goal,
    requested_grounding,
    verdict_to_message,
)
from dyknow_coordinator.ros.evaluation.formula_evaluation import FormulaEvaluation
from dyknow_stream_processing import OTHER_CLOCK_NS
from dyknow_stream_processing.ros import PAUSES

Start = Callable[[EvaluationRequest], FormulaEvaluation]
"""Starts the evaluation of a formula."""


class MonitoredPlan:
    """A plan that is being executed, and the evaluations of its formulas.

    Args:
        grounding: the grounding of all formulas.
        constraints: the constraints of the states of all formulas.
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
        # What formulas have waited for last.
        self._waits: dict[FormulaPosition, str] = {}
        # For withdrawn formulas, the end of the period, and the situation at the withdrawal.
        self._periods_end: dict[FormulaPosition, int] = {}
        self._withdrawals: dict[FormulaPosition, str] = {}
        self._verdicts = {
            position: PlanVerdict(position, formula.formula)
            for position, formula in plan.formulas_by_position.items()
        }

    @property
    def verdicts(self) -> tuple[PlanVerdict, ...]:
        """Status of all formulas."""
        return tuple(self._verdicts.values())

    def begin(self, time: int) -> None:
        """Start the plan at a time in nanoseconds."""
        self._take(self._execution.begin(), time)

    def report(self, action: str, event: Event, time: int) -> None:
        """Apply a report on an action.

        Args:
            action: the name of the action.
            event: what has happened.
            time: when it has happened, in nanoseconds.

        Raises:
            CoordinationError: if the report is impossible.
        """
        self._take(self._execution.report(action, event), time)

    def cancel(self, reason: str = 'the plan was cancelled before its end') -> None:
        """End the plan early."""
        if not self._execution.has_ended:
            self.error = CoordinationError(reason, ExitCode.CANCELLED)
            self._take(self._execution.end())

    def _take(self, step: Step, time: int | None = None) -> None:
        """Take a step at a time: ending periods take states until then, new ones from then on.

        Times are in nanoseconds. Without one, late states do not count.
        """
        for position in step.withdraw:
            evaluation = self._evaluations.get(position)
            if evaluation is None:  # It was about to start.
                self._update(position, phase=PlanPhase.WITHDRAWN, explanation=NO_STATE)
                continue
            self._note_wait(position, evaluation)
            if time is None:  # It ends with the last report on it.
                evaluation.cancel(partial(self._reason, position, evaluation))
            else:
                self._periods_end[position] = time
                evaluation.withdraw(time, partial(self._reason, position, evaluation))
        for position in step.start:
            # A formula that cannot be started may end the plan before the next one.
            if self._execution.phase(position) is PlanPhase.RUNNING:
                self._evaluate(position, time or 0)
        if self._execution.has_ended and not self._evaluations and not self.ended.done():
            self.ended.set_result(None)

    def _reason(
        self, position: FormulaPosition, evaluation: FormulaEvaluation, end: int | None = None
    ) -> str:
        if end is not None and evaluation.silence:
            self._waits[position] = evaluation.silence
        text = self._withdrawals[position] = self._standing(position, evaluation, end)
        return f"withdrawn by plan '{self._execution.plan.name}': {text}"

    def _evaluate(self, position: FormulaPosition, since: int) -> None:
        request = EvaluationRequest(
            formula=self._verdicts[position].formula,
            grounding=self._grounding,
            constraints=self._constraints,
            name=position.formula,
            plan=self._execution.plan.name,
            action=position.action,
            is_monitored=True,
            since=since,
        )
        try:
            evaluation = self._start(request)
        except DyKnowError as error:
            self._conclude(position, Answer(error=error))
            return
        self._evaluations[position] = evaluation
        evaluation.on_progress = partial(self._note_wait, position, evaluation)
        self._update(position, phase=PlanPhase.RUNNING)
        evaluation.outcome.add_done_callback(lambda done: self._conclude(position, done.result()))

    def _conclude(self, position: FormulaPosition, answer: Answer) -> None:
        evaluation = self._evaluations.pop(position, None)
        is_withdrawn = self._execution.phase(position) is PlanPhase.WITHDRAWN
        if evaluation and is_withdrawn and not self._is_in_period(position, answer):
            self._update(
                position,
                formula=answer.canonical_formula or self._verdicts[position].formula,
                phase=PlanPhase.WITHDRAWN,
                presumably_false=evaluation.progress.presumably_false,
                explanation=self._withdrawals.get(position)
                or self._interrupted(position, evaluation, answer),
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

    def _note_wait(self, position: FormulaPosition, evaluation: FormulaEvaluation) -> None:
        """Note what a formula waits for, and report it while it runs."""
        text = ''
        if evaluation.waits_for:
            self._waits[position] = evaluation.waits_for
            text = f'it waits for states: {evaluation.waits_for}'
        is_running = self._execution.phase(position) is PlanPhase.RUNNING
        if is_running and self._verdicts[position].explanation != text:
            self._update(position, explanation=text)

    def _standing(
        self, position: FormulaPosition, evaluation: FormulaEvaluation, end: int | None
    ) -> str:
        """Return how a formula stood when it was withdrawn.

        Args:
            position: the position of the formula.
            evaluation: the evaluation of the formula.
            end: the end of its period, in nanoseconds, if not all states until then are known; else
                None. After a wait, the end of the period counts in any case.
        """
        progress = evaluation.progress
        if position in self._waits:
            end = self._periods_end.get(position)
        unknown = None if end is None else max(end - progress.latest_valid_time, 0)
        return withdrawal(
            progress.states_progressed,
            presumably_false=progress.presumably_false,
            # States of another clock have no order with the end of the period.
            unknown=None if unknown is None or unknown > OTHER_CLOCK_NS else unknown,
            waited_for=self._waits.get(position, ''),
        )

    def _interrupted(
        self, position: FormulaPosition, evaluation: FormulaEvaluation, answer: Answer
    ) -> str:
        """Return how a withdrawn formula stood that ended before its last states were known."""
        text = self._standing(position, evaluation, self._periods_end.get(position))
        return text if answer.error is None else f'{text}: {answer.error}'

    def _is_in_period(self, position: FormulaPosition, answer: Answer) -> bool:
        """Return True if a withdrawn formula has a verdict from a state of its period."""
        end = self._periods_end.get(position)
        if end is None or answer.verdict is Verdict.UNDECIDED:
            return False
        return answer.decided_at is None or answer.decided_at <= end

    def _update(self, position: FormulaPosition, **changes: Any) -> None:
        self._verdicts[position] = replace(self._verdicts[position], **changes)
        self._on_change(self._verdicts[position])


class PlanMonitoring:
    """All monitored plans.

    Args:
        start: starts evaluations.
        limits: the limits of plans.
    """

    def __init__(self, node: DyKnowNode, start: Start, limits: ParameterLimits) -> None:
        self._node = node
        self._start = start
        self._limits = limits
        # The plans of a name by their goals: of its client, and for a moment of its former run.
        self._plans: dict[str, dict[bytes, MonitoredPlan]] = {}
        node.serve(ReportPlanAction, self._report)
        self.server = CancellingActionServer(node, MonitorPlan, self._execute)

    async def _execute(self, goal: Any) -> Any:
        result = MonitorPlan.Result()
        name, goal_id = goal.request.name, bytes(goal.goal_id.uuid)
        try:
            plan = self._monitored_plan(goal)
        except DyKnowError as error:
            result.exit_status = error_to_message(error)
            self.server.finish(goal, error)
            return result
        self._plans.setdefault(name, {})[goal_id] = plan
        plan.begin(self._node.now())
        # The server ends the plan of a former run once it is sure that this client stays.
        with self.server.running(goal, plan.cancel):
            await plan.ended
        del self._plans[name][goal_id]
        if not self._plans[name]:
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
        # A plan that this one replaces does not count; it ends a moment later.
        count = sum(map(len, self._plans.values())) + (request.name not in self._plans)
        self._limits.check('plan_limit', count, 'monitored plans')
        newer = bytes(goal.goal_id.uuid)
        for former in self._plans.get(request.name, ()):
            if self.server.is_over(former, newer):
                continue
            is_former = is_of_former_run(former, newer)
            hint = ', or try again in 20 s if its client was killed' if is_former else ''
            raise CoordinationError(
                f"a plan '{request.name}' is monitored already; give this one another name{hint}",
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
        plans, goal_id = self._plans[request.plan], bytes(request.goal_id)
        plan = plans.get(goal_id) if any(goal_id) else list(plans.values())[-1]
        if plan is None:
            raise CoordinationError(
                f"another client's plan '{request.plan}' is monitored; give this one another name",
                ExitCode.ALREADY_EXISTS,
            )
        if request.event not in set(Event):
            known = ', '.join(f'{each.name} ({each.value})' for each in Event)
            raise CoordinationError(f'there is no event {request.event}; use {known}')
        # The client had reported before a pause of this process.
        delay = PAUSES.delay_of(self._node.request_sent_at())
        time = self._node.now() - delay
        plan.report(request.action, Event(request.event), time)
