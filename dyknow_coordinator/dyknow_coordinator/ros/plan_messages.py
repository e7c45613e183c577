"""Conversion between plans and their messages."""

from __future__ import annotations

from typing import Any

from dyknow_interfaces.action import MonitorPlan
from dyknow_interfaces.msg import PlanAction as PlanActionMessage
from dyknow_interfaces.msg import PlanFormula as PlanFormulaMessage
from dyknow_interfaces.msg import PlanVerdict as PlanVerdictMessage

from dyknow_common import Verdict
from dyknow_common.ros import fill_exit_status, nanoseconds_to_time, time_to_nanoseconds
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.plan import (
    FormulaPosition,
    Holds,
    Plan,
    PlanAction,
    PlanFormula,
    PlanPhase,
    PlanVerdict,
)
from dyknow_coordinator.ros.reporting.evaluation_messages import error_from_status


def plan_to_goal(plan: Plan) -> Any:
    """Return a goal of MonitorPlan, without grounding and constraints."""
    return MonitorPlan.Goal(
        name=plan.name,
        actions=[
            PlanActionMessage(name=action.name, formulas=_formulas_to_messages(action.formulas))
            for action in plan.actions
        ],
        formulas=_formulas_to_messages(plan.formulas),
        stop_at_violation=plan.stop_at_violation,
    )


def plan_from_goal(goal: Any) -> Plan:
    """Return the plan in a goal of MonitorPlan.

    Raises:
        CoordinationError: if the period of a formula is unknown.
    """
    return Plan(
        name=goal.name,
        actions=tuple(
            PlanAction(action.name, _formulas_from_messages(action.formulas))
            for action in goal.actions
        ),
        formulas=_formulas_from_messages(goal.formulas),
        stop_at_violation=goal.stop_at_violation,
    )


def verdict_to_message(verdict: PlanVerdict) -> Any:
    """Return a PlanVerdict message."""
    message = PlanVerdictMessage(
        action=verdict.position.action,
        formula_name=verdict.position.formula,
        formula=verdict.formula,
        phase=int(verdict.phase),
        verdict=int(verdict.verdict),
        presumably_false=verdict.presumably_false,
        explanation=verdict.explanation,
    )
    if verdict.decided_at is not None:
        message.decided_at = nanoseconds_to_time(verdict.decided_at)
    if verdict.error is not None:
        fill_exit_status(message.exit_status, verdict.error)
    return message


def verdict_from_message(message: Any) -> PlanVerdict:
    """Return the verdict in a PlanVerdict message."""
    return PlanVerdict(
        position=FormulaPosition(message.action, message.formula_name),
        formula=message.formula,
        phase=PlanPhase(message.phase),
        verdict=Verdict(message.verdict),
        presumably_false=message.presumably_false,
        decided_at=time_to_nanoseconds(message.decided_at) or None,
        explanation=message.explanation,
        error=error_from_status(message.exit_status),
    )


def _formulas_to_messages(formulas: tuple[PlanFormula, ...]) -> list[Any]:
    return [
        PlanFormulaMessage(name=each.name, formula=each.formula, holds=int(each.holds))
        for each in formulas
    ]


def _formulas_from_messages(messages: Any) -> tuple[PlanFormula, ...]:
    return tuple(PlanFormula(each.name, each.formula, _holds(each)) for each in messages)


def _holds(message: Any) -> Holds:
    try:
        return Holds(message.holds)
    except ValueError:
        known = ', '.join(f'{each.name} ({each.value})' for each in Holds)
        raise CoordinationError(
            f"formula '{message.name}' has the unknown value {message.holds} of holds; use {known}"
        ) from None
