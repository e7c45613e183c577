"""The action MonitorFormula."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dyknow_interfaces.action import MonitorFormula

from dyknow_common import DyKnowError
from dyknow_common.ros import DyKnowNode
from dyknow_coordinator.evaluation.answer import Answer
from dyknow_coordinator.evaluation.request import EvaluationRequest
from dyknow_coordinator.ros.actions import CancellingActionServer, finish_goal
from dyknow_coordinator.ros.answers import fill_answer
from dyknow_coordinator.ros.evaluation.formula_evaluation import FormulaEvaluation


class MonitorFormulaServer:
    """Evaluates formulas for clients that get feedback and may cancel.

    Args:
        node: offers the action.
        start: starts an evaluation.
        read_request: returns the content of a goal.
    """

    def __init__(
        self,
        node: DyKnowNode,
        start: Callable[[EvaluationRequest], FormulaEvaluation],
        read_request: Callable[[Any], EvaluationRequest],
    ) -> None:
        self._start = start
        self._read_request = read_request
        self.server = CancellingActionServer(node, MonitorFormula, self._execute)

    async def _execute(self, goal: Any) -> Any:
        try:
            evaluation = self._start(self._read_request(goal.request))
        except DyKnowError as error:
            answer = Answer(error=error)
        else:
            evaluation.on_progress = _Feedback(goal, evaluation).publish
            with self.server.running(goal, evaluation.cancel):
                answer = await evaluation.outcome
        result = MonitorFormula.Result()
        fill_answer(result, answer)
        finish_goal(goal, answer.error)
        return result


class _Feedback:
    """Publishes the progress of a formula to the client of its goal."""

    def __init__(self, goal: Any, evaluation: FormulaEvaluation) -> None:
        self._goal = goal
        self._evaluation = evaluation
        self._published_events = 0

    def publish(self) -> None:
        evaluation, progress = self._evaluation, self._evaluation.progress
        if evaluation.outcome.done():
            return
        feedback = MonitorFormula.Feedback(
            streams=[each.stream for each in evaluation.groundings],
            events=evaluation.history.since(self._published_events),
        )
        if progress is not None:
            feedback.states_progressed = progress.states_progressed
            feedback.latest_valid_time = progress.latest_valid_time
            feedback.residual_formula = progress.residual_formula
            feedback.presumably_false = progress.presumably_false
        self._published_events = evaluation.history.count
        self._goal.publish_feedback(feedback)
