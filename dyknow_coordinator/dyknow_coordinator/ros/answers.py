"""Requests, answers, progress and plans as messages of the services and actions."""

from __future__ import annotations

from itertools import chain
from typing import Any

from dyknow_interfaces.msg import PlanVerdict as PlanVerdictMessage

from dyknow_common import SECOND_NS, StandingVerdicts
from dyknow_common.ros import from_message, time_to_nanoseconds, to_message
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation import Answer, EvaluationRequest, Progress
from dyknow_coordinator.grounding.feature_sources import Grounding
from dyknow_coordinator.plan import FormulaPosition, Holds, Plan, PlanVerdict


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
    return from_message(
        EvaluationRequest,
        message,
        grounding=requested_grounding(message),
        timeout_s=min(timeout_s, max_timeout_s) if max_timeout_s else timeout_s,
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


def answer_from_message(message: Any, *, every_state: bool = False) -> Answer:
    """Return the answer in a response of EvaluateFormula or a result of MonitorFormula.

    Args:
        message: the response or result.
        every_state: True if the formula was asked at every state.
    """
    return from_message(
        Answer,
        message,
        episodes=from_message(StandingVerdicts, message.episodes) if every_state else None,
    )


def progress_from_message(message: Any, *, every_state: bool = False) -> Progress:
    """Return the progress in the feedback of MonitorFormula."""
    episodes = from_message(StandingVerdicts, message.episodes) if every_state else None
    return from_message(Progress, message, episodes=episodes)


def plan_from_goal(goal: Any) -> Plan:
    """Return the plan in a goal of MonitorPlan.

    Raises:
        CoordinationError: if the period of a formula is unknown.
    """
    for each in chain(goal.formulas, *(action.formulas for action in goal.actions)):
        if each.holds not in set(Holds):
            known = ', '.join(f'{period.name} ({period.value})' for period in Holds)
            raise CoordinationError(
                f"formula '{each.name}' has the unknown value {each.holds} of holds; use {known}"
            )
    return from_message(Plan, goal)


def verdict_to_message(verdict: PlanVerdict) -> Any:
    """Return a PlanVerdict message."""
    place = verdict.position
    message = PlanVerdictMessage(action=place.action, formula_name=place.formula)
    return to_message(verdict, message)


def verdict_from_message(message: Any) -> PlanVerdict:
    """Return the verdict in a PlanVerdict message."""
    return from_message(
        PlanVerdict,
        message,
        position=FormulaPosition(message.action, message.formula_name),
    )
