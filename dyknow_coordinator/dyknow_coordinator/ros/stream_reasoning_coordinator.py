"""The stream reasoning coordinator: the one node that a user talks to (VI-A.7)."""

from __future__ import annotations

from itertools import count
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces.action import MonitorFormula
from dyknow_interfaces.msg import FormulaProgress, FormulaResult
from dyknow_interfaces.srv import EvaluateFormula
from rclpy.action import ActionServer, CancelResponse

from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding import Grounding
from dyknow_coordinator.ros.clients import Clients
from dyknow_coordinator.ros.formula_evaluation import FormulaEvaluation, Question, fill_answer
from dyknow_stream_processing import DyKnowError, ExitCode
from dyknow_stream_processing.ros import (
    LATCHED_HISTORY,
    NO_SUBSCRIPTION_EVENTS,
    RUNNING,
    DyKnowNode,
    constraints_from_message,
    fill_exit_status,
    run,
    time_to_nanoseconds,
)

if TYPE_CHECKING:
    from dyknow_coordinator.evaluation import Outcome


class StreamReasoningCoordinator(DyKnowNode):
    """Answers EvaluateFormula and MonitorFormula."""

    def __init__(self) -> None:
        super().__init__('stream_reasoning_coordinator')
        self._default_timeout = self.parameter(
            'default_timeout',
            60.0,
            'Seconds that a formula is evaluated for when the caller names no timeout.',
            (0.1, 1e9),
        )
        self._peers = Clients(self)
        self._results = f'{self.get_fully_qualified_name()}/results'
        self._evaluations: list[FormulaEvaluation] = []
        self._monitors: dict[bytes, FormulaEvaluation] = {}
        # Stream names are unique in the system, also across restarts of this node.
        self._names = (f'states_{self.now():x}_{number}' for number in count(1))
        self.create_subscription(
            FormulaResult,
            self._results,
            self._receive,
            LATCHED_HISTORY,
            callback_group=self.reentrant,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
        )
        for peer in self._peers.peers:
            peer.on_found.append(self._report)
            peer.on_lost.append(self._report)
        self._report()
        self.serve(EvaluateFormula, self._evaluate)
        self._action = ActionServer(
            self,
            MonitorFormula,
            '~/monitor_formula',
            self._monitor,
            callback_group=self.reentrant,
            cancel_callback=self._cancel,
        )

    def destroy_node(self) -> None:
        """Frees the action server too."""
        self._action.destroy()
        super().destroy_node()

    async def _evaluate(self, request: Any, response: Any) -> None:
        evaluation = self._start(request)
        fill_answer(response, evaluation, await evaluation.outcome)

    async def _monitor(self, goal: Any) -> Any:
        result = MonitorFormula.Result()
        try:
            evaluation = self._start(goal.request)
        except DyKnowError as error:
            fill_exit_status(result.exit_status, error)
            goal.abort()
            return result
        key = bytes(goal.goal_id.uuid)
        self._monitors[key] = evaluation
        feedback = self._report_to(goal, evaluation)
        if goal.is_cancel_requested:
            evaluation.cancel()
        outcome = await evaluation.outcome
        self.destroy_subscription(feedback)
        del self._monitors[key]
        fill_answer(result, evaluation, outcome)
        _finish(goal, outcome)
        return result

    def _report(self) -> None:
        missing = [peer.name for peer in self._peers.peers if not peer.alive]
        if missing:
            self.set_status(f'waiting for {", ".join(missing)}', level=DiagnosticStatus.WARN)
        else:
            self.set_status(RUNNING)

    def _start(self, goal: Any) -> FormulaEvaluation:
        question = self._question(goal)
        evaluation = FormulaEvaluation(
            self, self._peers, next(self._names), question, self._results
        )
        self._evaluations.append(evaluation)
        self.spawn(self._live, evaluation)
        return evaluation

    async def _live(self, evaluation: FormulaEvaluation) -> None:
        await evaluation.run()
        self._evaluations.remove(evaluation)

    def _question(self, goal: Any) -> Question:
        if not goal.formula.strip():
            raise CoordinationError('the formula is empty; write one, such as always p')
        if goal.grounding not in set(Grounding):
            raise CoordinationError(
                f'there is no grounding {goal.grounding}; use AUTO (0), SYNTACTIC (1) or '
                'SEMANTIC (2)'
            )
        timeout = time_to_nanoseconds(goal.timeout) / 1e9
        if timeout < 0:
            raise CoordinationError(f'the timeout of {timeout:g} s is negative')
        return Question(
            formula=goal.formula,
            grounding=Grounding(goal.grounding),
            constraints=constraints_from_message(goal.constraints),
            timeout=timeout or self._default_timeout,
        )

    def _receive(self, result: Any) -> None:
        for evaluation in list(self._evaluations):
            if _is_about(result, evaluation):
                evaluation.receive(result)

    def _report_to(self, goal: Any, evaluation: FormulaEvaluation) -> Any:
        def report(progress: Any) -> None:
            if _is_about(progress, evaluation) and evaluation.running:
                feedback = MonitorFormula.Feedback(
                    states_progressed=progress.states_progressed,
                    latest_valid_time=progress.latest_valid_time,
                    residual_formula=progress.residual_formula,
                )
                goal.publish_feedback(feedback)

        return self.create_subscription(
            FormulaProgress,
            f'{self._peers.stream_reasoning_engine.name}/progress',
            report,
            100,
            callback_group=self.reentrant,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
        )

    def _cancel(self, goal: Any) -> CancelResponse:
        evaluation = self._monitors.get(bytes(goal.goal_id.uuid))
        if evaluation is not None:
            evaluation.cancel()
        return CancelResponse.ACCEPT


def _is_about(message: Any, evaluation: FormulaEvaluation) -> bool:
    return (message.formula_group_id, message.formula_id) == (
        evaluation.group_id,
        evaluation.formula_id,
    )


def _finish(goal: Any, outcome: Outcome) -> None:
    if outcome.error is None:
        goal.succeed()
    elif outcome.error.code is ExitCode.CANCELLED:
        goal.canceled()
    else:
        goal.abort()


def main() -> int:
    """The executable stream_reasoning_coordinator."""
    return run(StreamReasoningCoordinator)
