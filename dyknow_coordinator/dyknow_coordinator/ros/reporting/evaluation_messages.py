"""Conversion between the statuses and verdicts of evaluations and their messages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, Final

from dyknow_interfaces.msg import BlackBoxRequest, Episode, ExitStatus, FormulaEpisodes
from dyknow_interfaces.msg import EvaluationStatus as StatusMessage
from dyknow_interfaces.msg import SymbolGrounding as GroundingMessage

from dyknow_common import BlackBoxOptions, DyKnowError, ExitCode, Verdict
from dyknow_common.ros import (
    fill_exit_status,
    margin_from_message,
    margin_to_message,
    nanoseconds_to_duration,
    nanoseconds_to_time,
    probability_from_message,
    probability_to_message,
    time_to_nanoseconds,
)
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation import EvaluationPhase, StandingVerdicts, ViolationEpisode
from dyknow_coordinator.grounding.feature_sources import Grounding, SymbolGrounding
from dyknow_coordinator.reporting.evaluation_status import EvaluationStatus

_FIELDS: Final = ('holds', 'fails', 'undecided', 'unknown', 'is_violated', 'episode_count')
_EPISODE_FIELDS: Final = ('states', 'has_ended', 'explanation')

_MESSAGE_TYPES: Final = StatusMessage.get_fields_and_field_types()
_COMMON_FIELDS: Final = tuple(
    each.name
    for each in fields(EvaluationStatus)
    if each.type in {'str', 'int', 'bool'} and '/' not in _MESSAGE_TYPES[each.name]
)
"""The texts, numbers and booleans of a status, which its message has as they are."""

_MAX_TEXT: Final = 10_000
"""The most characters of a text in a status."""


def verdicts_to_message(verdicts: StandingVerdicts) -> FormulaEpisodes:
    """Return a FormulaEpisodes message, without the names of the formula."""
    return FormulaEpisodes(
        **{name: getattr(verdicts, name) for name in _FIELDS},
        latest_episodes=[
            Episode(
                begin=nanoseconds_to_time(each.begin),
                end=nanoseconds_to_time(each.end),
                decided_at=nanoseconds_to_time(each.decided_at),
                worst=margin_to_message(each.worst),
                **{name: getattr(each, name) for name in _EPISODE_FIELDS},
            )
            for each in verdicts.latest_episodes
        ],
    )


def verdicts_from_message(message: FormulaEpisodes) -> StandingVerdicts:
    """Return the verdicts in a FormulaEpisodes message."""
    return StandingVerdicts(
        **{name: getattr(message, name) for name in _FIELDS},
        latest_episodes=tuple(
            ViolationEpisode(
                begin=time_to_nanoseconds(each.begin),
                end=time_to_nanoseconds(each.end),
                decided_at=time_to_nanoseconds(each.decided_at),
                worst=margin_from_message(each.worst),
                **{name: getattr(each, name) for name in _EPISODE_FIELDS},
            )
            for each in message.latest_episodes
        ),
    )


def status_to_message(status: EvaluationStatus) -> StatusMessage:
    """Return an EvaluationStatus message; unknown times are zero."""
    message = StatusMessage(
        **{name: _brief(getattr(status, name)) for name in _COMMON_FIELDS},
        phase=int(status.phase),
        started=nanoseconds_to_time(status.started),
        groundings=[symbol_grounding_to_message(each) for each in status.groundings],
        topics=list(status.topics),
        record=black_box_to_message(status.record),
        events=list(status.events),
        latest_valid_time=nanoseconds_to_time(status.latest_valid_time or 0),
        margin=margin_to_message(status.margin),
        probability=probability_to_message(status.probability),
        verdict=int(status.verdict),
        decided_at=nanoseconds_to_time(status.decided_at or 0),
        every_state=status.episodes is not None,
    )
    if status.episodes is not None:
        message.episodes = verdicts_to_message(status.episodes)
    if status.error is not None:
        fill_exit_status(message.exit_status, status.error)
    return message


def _brief(value: Any) -> Any:
    """Return the beginning of a very long text: reports are sent each second."""
    is_long = isinstance(value, str) and len(value) > _MAX_TEXT
    return f'{value[:_MAX_TEXT]}...' if is_long else value


def status_from_message(message: StatusMessage) -> EvaluationStatus:
    """Return the status in an EvaluationStatus message."""
    return EvaluationStatus(
        **{name: getattr(message, name) for name in _COMMON_FIELDS},
        phase=EvaluationPhase(message.phase),
        started=time_to_nanoseconds(message.started),
        groundings=tuple(symbol_grounding_from_message(each) for each in message.groundings),
        topics=tuple(message.topics),
        record=black_box_from_message(message.record),
        events=tuple(message.events),
        latest_valid_time=time_to_nanoseconds(message.latest_valid_time) or None,
        margin=margin_from_message(message.margin),
        probability=probability_from_message(message.probability),
        verdict=Verdict(message.verdict),
        decided_at=time_to_nanoseconds(message.decided_at) or None,
        error=error_from_status(message.exit_status),
        episodes=verdicts_from_message(message.episodes) if message.every_state else None,
    )


def black_box_to_message(options: BlackBoxOptions | None) -> list[BlackBoxRequest]:
    """Return the BlackBoxRequest messages of a goal or a status: one, or none."""
    if options is None:
        return []
    return [
        BlackBoxRequest(
            topics=list(options.topics),
            before=nanoseconds_to_duration(options.before),
            after=nanoseconds_to_duration(options.after),
        )
    ]


def black_box_from_message(messages: Sequence[Any]) -> BlackBoxOptions | None:
    """Return the black box that a goal asks for, or a status reports.

    Raises:
        DyKnowError: if a value is out of range.
    """
    if not messages:
        return None
    (message,) = messages
    return BlackBoxOptions(
        tuple(message.topics),
        time_to_nanoseconds(message.before),
        time_to_nanoseconds(message.after),
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


def error_from_status(exit_status: ExitStatus) -> DyKnowError | None:
    """Return the error in an exit status; None on SUCCESS."""
    code = ExitCode(exit_status.code)
    return None if code is ExitCode.SUCCESS else CoordinationError(exit_status.message, code)
