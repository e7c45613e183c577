"""Requests, answers and progress as messages of EvaluateFormula and MonitorFormula."""

from __future__ import annotations

from typing import Any

from dyknow_common import SECOND_NS, Verdict
from dyknow_common.ros import (
    constraints_from_message,
    fill_exit_status,
    margin_from_message,
    margin_to_message,
    nanoseconds_to_time,
    probability_from_message,
    time_to_nanoseconds,
)
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation import Answer, EvaluationRequest, Progress
from dyknow_coordinator.grounding.feature_sources import Grounding
from dyknow_coordinator.ros.reporting.evaluation_messages import (
    black_box_from_message,
    error_from_status,
    symbol_grounding_from_message,
    symbol_grounding_to_message,
    verdicts_from_message,
    verdicts_to_message,
)


def request_from_message(
    message: Any, default_timeout_s: float, max_timeout_s: float
) -> EvaluationRequest:
    """Return the content of a request of EvaluateFormula or a goal of MonitorFormula.

    Args:
        message: the request or goal.
        default_timeout_s: used if the message has none.
        max_timeout_s: upper bound of the timeout; 0 for none.

    Raises:
        DyKnowError: if the request is invalid.
    """
    if not message.formula.strip():
        raise CoordinationError('the formula is empty; write one, such as always p')
    timeout_s = time_to_nanoseconds(message.timeout) / SECOND_NS
    if timeout_s < 0:
        raise CoordinationError(f'the timeout of {timeout_s:g} s is negative')
    timeout_s = timeout_s or default_timeout_s
    return EvaluationRequest(
        formula=message.formula,
        grounding=requested_grounding(message),
        constraints=constraints_from_message(message.constraints),
        timeout_s=min(timeout_s, max_timeout_s) if max_timeout_s else timeout_s,
        name=getattr(message, 'name', ''),
        restart_on_change=getattr(message, 'restart_on_change', False),
        margin=message.margin,
        every_state=getattr(message, 'every_state', False),
        record=black_box_from_message(getattr(message, 'record', ())),
    )


def requested_grounding(message: Any) -> Grounding:
    """Return how the symbols in a request or goal are to be grounded.

    Raises:
        CoordinationError: if the number is unknown.
    """
    if message.grounding not in set(Grounding):
        raise CoordinationError(
            f'there is no grounding {message.grounding}; use AUTO (0), SYNTACTIC (1) or '
            'SEMANTIC (2)'
        )
    return Grounding(message.grounding)


def fill_answer(message: Any, answer: Answer) -> None:
    """Write an answer into a response of EvaluateFormula or a result of MonitorFormula."""
    message.verdict = int(answer.verdict)
    message.canonical_formula = answer.canonical_formula
    message.explanation = answer.explanation
    message.margin = margin_to_message(answer.margin)
    message.groundings = [symbol_grounding_to_message(each) for each in answer.groundings]
    if answer.decided_at is not None:
        message.decided_at = nanoseconds_to_time(answer.decided_at)
    if answer.error is not None:
        fill_exit_status(message.exit_status, answer.error)
    if answer.episodes is not None:
        message.episodes = verdicts_to_message(answer.episodes)


def answer_from_message(message: Any, *, every_state: bool = False) -> Answer:
    """Return the answer in a response of EvaluateFormula or a result of MonitorFormula.

    Args:
        message: the response or result.
        every_state: True if the formula was asked at every state.
    """
    error = error_from_status(message.exit_status)
    return Answer(
        verdict=Verdict(message.verdict),
        decided_at=time_to_nanoseconds(message.decided_at) or None,
        canonical_formula=message.canonical_formula,
        explanation=message.explanation,
        groundings=tuple(symbol_grounding_from_message(each) for each in message.groundings),
        margin=margin_from_message(message.margin),
        error=error,
        episodes=verdicts_from_message(message.episodes) if every_state else None,
    )


def progress_from_message(message: Any, *, every_state: bool = False) -> Progress:
    """Return the progress in the feedback of MonitorFormula."""
    return Progress(
        states_progressed=message.states_progressed,
        latest_valid_time=time_to_nanoseconds(message.latest_valid_time),
        residual_formula=message.residual_formula,
        presumably_false=message.presumably_false,
        streams=tuple(message.streams),
        events=tuple(message.events),
        waits_for=message.waits_for,
        margin=margin_from_message(message.margin),
        probability=probability_from_message(message.probability),
        episodes=verdicts_from_message(message.episodes) if every_state else None,
    )
