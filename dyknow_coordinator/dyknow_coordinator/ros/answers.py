"""Questions and answers as messages."""

from __future__ import annotations

from typing import Any

from dyknow_common import SECOND_NS
from dyknow_common.ros import (
    constraints_from_message,
    fill_exit_status,
    nanoseconds_to_time,
    time_to_nanoseconds,
)
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation.evaluation import EvaluationOutcome
from dyknow_coordinator.evaluation.request import EvaluationRequest
from dyknow_coordinator.grounding.grounding import Grounding
from dyknow_coordinator.ros.evaluation.formula_evaluation import FormulaEvaluation
from dyknow_coordinator.ros.reporting.evaluation_messages import grounding_to_message


def question_from_message(
    goal: Any, default_timeout: float, timeout_limit: float
) -> EvaluationRequest:
    """What a request of EvaluateFormula, or a goal of MonitorFormula, asks.

    Args:
        goal: the message.
        default_timeout: seconds, where it names none.
        timeout_limit: the most that a timeout may be, seconds; 0: any.

    Raises:
        DyKnowError: for what makes no sense.
    """
    if not goal.formula.strip():
        raise CoordinationError('the formula is empty; write one, such as always p')
    timeout = time_to_nanoseconds(goal.timeout) / SECOND_NS
    if timeout < 0:
        raise CoordinationError(f'the timeout of {timeout:g} s is negative')
    timeout = timeout or default_timeout
    return EvaluationRequest(
        formula=goal.formula,
        grounding=grounding_of(goal),
        constraints=constraints_from_message(goal.constraints),
        timeout=min(timeout, timeout_limit) if timeout_limit else timeout,
        name=getattr(goal, 'name', ''),
        restart_on_change=getattr(goal, 'restart_on_change', False),
    )


def grounding_of(goal: Any) -> Grounding:
    """How symbols are to be grounded.

    Raises:
        CoordinationError: for a number that stands for no way.
    """
    if goal.grounding not in set(Grounding):
        raise CoordinationError(
            f'there is no grounding {goal.grounding}; use AUTO (0), SYNTACTIC (1) or SEMANTIC (2)'
        )
    return Grounding(goal.grounding)


def fill_answer(answer: Any, evaluation: FormulaEvaluation, outcome: EvaluationOutcome) -> None:
    """Writes an outcome into the response of the service or the result of the action."""
    answer.verdict = int(outcome.verdict)
    answer.canonical_formula = evaluation.canonical_formula
    answer.explanation = outcome.explanation
    answer.groundings = [grounding_to_message(each) for each in evaluation.groundings]
    if outcome.decided_at is not None:
        answer.decided_at = nanoseconds_to_time(outcome.decided_at)
    if outcome.error is not None:
        fill_exit_status(answer.exit_status, outcome.error)
