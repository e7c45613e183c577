"""The action MonitorFormula."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dyknow_interfaces.action import MonitorFormula
from rclpy.action import CancelResponse

from dyknow_common import DyKnowError, ExitCode
from dyknow_common.ros import DyKnowNode, fill_exit_status
from dyknow_coordinator.evaluation.evaluation import EvaluationOutcome
from dyknow_coordinator.evaluation.request import EvaluationRequest
from dyknow_coordinator.ros.actions import serve_action
from dyknow_coordinator.ros.answers import fill_answer
from dyknow_coordinator.ros.evaluation.formula_evaluation import FormulaEvaluation


class MonitorFormulaServer:
    """Evaluates formulas for the clients of an action, who hear how it goes and may cancel.

    Args:
        start: begins an evaluation.
        question: what a goal asks.
    """

    def __init__(
        self,
        node: DyKnowNode,
        start: Callable[[EvaluationRequest], FormulaEvaluation],
        question: Callable[[Any], EvaluationRequest],
    ) -> None:
        self._start = start
        self._question = question
        self._evaluations: dict[bytes, FormulaEvaluation] = {}
        self._action = serve_action(
            node, MonitorFormula, self._monitor, self._cancel, self._abandon
        )

    def destroy(self) -> None:
        """Frees the action server."""
        self._action.destroy()

    async def _monitor(self, goal: Any) -> Any:
        result = MonitorFormula.Result()
        try:
            evaluation = self._start(self._question(goal.request))
        except DyKnowError as error:
            fill_exit_status(result.exit_status, error)
            goal.abort()
            return result
        key = bytes(goal.goal_id.uuid)
        self._evaluations[key] = evaluation
        evaluation.on_progress = _Feedback(goal, evaluation).publish
        if goal.is_cancel_requested:
            evaluation.cancel()
        outcome = await evaluation.outcome
        del self._evaluations[key]
        fill_answer(result, evaluation, outcome)
        _finish(goal, outcome)
        return result

    def _cancel(self, goal: Any) -> CancelResponse:
        evaluation = self._evaluations.get(bytes(goal.goal_id.uuid))
        if evaluation is not None:
            evaluation.cancel()
        return CancelResponse.ACCEPT

    def _abandon(self) -> None:
        for evaluation in list(self._evaluations.values()):
            evaluation.cancel('no client of ~/monitor_formula is left')


class _Feedback:
    """Tells the client of a goal how its formula is."""

    def __init__(self, goal: Any, evaluation: FormulaEvaluation) -> None:
        self._goal = goal
        self._evaluation = evaluation
        self._told = 0

    def publish(self) -> None:
        evaluation, progress = self._evaluation, self._evaluation.progress
        if evaluation.outcome.done():
            return
        feedback = MonitorFormula.Feedback(
            streams=[each.stream for each in evaluation.groundings],
            events=evaluation.history.since(self._told),
        )
        if progress is not None:
            feedback.states_progressed = progress.states_progressed
            feedback.latest_valid_time = progress.latest_valid_time
            feedback.residual_formula = progress.residual_formula
            feedback.presumably_false = progress.presumably_false
        self._told = evaluation.history.count
        self._goal.publish_feedback(feedback)


def _finish(goal: Any, outcome: EvaluationOutcome) -> None:
    if outcome.error is None:
        goal.succeed()
    elif outcome.error.code is ExitCode.CANCELLED and goal.is_cancel_requested:
        goal.canceled()
    else:
        goal.abort()
