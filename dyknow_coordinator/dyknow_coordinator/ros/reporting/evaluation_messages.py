"""Conversion between evaluation statuses and their messages."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from dyknow_interfaces.msg import EvaluationStatus as StatusMessage
from dyknow_interfaces.msg import ExitStatus
from dyknow_interfaces.msg import SymbolGrounding as GroundingMessage

from dyknow_common import DyKnowError, ExitCode, Verdict
from dyknow_common.ros import fill_exit_status, nanoseconds_to_time, time_to_nanoseconds
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation.evaluation import EvaluationPhase
from dyknow_coordinator.grounding.feature_sources import Grounding, SymbolGrounding
from dyknow_coordinator.reporting.evaluation_status import EvaluationStatus


def status_to_message(status: EvaluationStatus) -> StatusMessage:
    """Return an EvaluationStatus message; absent times are zero."""
    return StatusMessage(
        name=status.name,
        plan=status.plan,
        action=status.action,
        formula=status.formula,
        phase=int(status.phase),
        started=nanoseconds_to_time(status.started),
        formula_group_id=status.formula_group_id,
        state_stream=status.state_stream,
        groundings=[symbol_grounding_to_message(each) for each in status.groundings],
        events=list(status.events),
        states_progressed=status.states_progressed,
        latest_valid_time=_time(status.latest_valid_time),
        residual_formula=status.residual_formula,
        presumably_false=status.presumably_false,
        verdict=int(status.verdict),
        decided_at=_time(status.decided_at),
        explanation=status.explanation,
        exit_status=_exit_status(status.error),
    )


def status_from_message(message: StatusMessage) -> EvaluationStatus:
    """Return the status in an EvaluationStatus message."""
    return EvaluationStatus(
        name=message.name,
        plan=message.plan,
        action=message.action,
        formula=message.formula,
        phase=EvaluationPhase(message.phase),
        started=time_to_nanoseconds(message.started),
        formula_group_id=message.formula_group_id,
        state_stream=message.state_stream,
        groundings=tuple(symbol_grounding_from_message(each) for each in message.groundings),
        events=tuple(message.events),
        states_progressed=message.states_progressed,
        latest_valid_time=time_to_nanoseconds(message.latest_valid_time) or None,
        residual_formula=message.residual_formula,
        presumably_false=message.presumably_false,
        verdict=Verdict(message.verdict),
        decided_at=time_to_nanoseconds(message.decided_at) or None,
        explanation=message.explanation,
        error=error_from_status(message.exit_status),
    )


def symbol_grounding_to_message(grounding: SymbolGrounding) -> GroundingMessage:
    """Return a SymbolGrounding message."""
    return GroundingMessage(
        symbol=grounding.symbol,
        grounding=int(grounding.grounding),
        stream=grounding.stream,
        stand_ins=list(grounding.stand_ins),
    )


def symbol_grounding_from_message(message: GroundingMessage) -> SymbolGrounding:
    """Return the grounding in a SymbolGrounding message."""
    return SymbolGrounding(
        message.symbol, Grounding(message.grounding), message.stream, tuple(message.stand_ins)
    )


def _time(nanoseconds: int | None) -> Time:
    return nanoseconds_to_time(nanoseconds or 0)


def _exit_status(error: DyKnowError | None) -> ExitStatus:
    exit_status = ExitStatus()
    if error is not None:
        fill_exit_status(exit_status, error)
    return exit_status


def error_from_status(exit_status: ExitStatus) -> DyKnowError | None:
    """Return the error in an exit status; None on SUCCESS."""
    code = ExitCode(exit_status.code)
    return None if code is ExitCode.SUCCESS else CoordinationError(exit_status.message, code)
