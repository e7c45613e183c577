"""Verdicts, diagnostics and markers as messages, as the nodes publish them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from typing import Any, Final

from dyknow_common import ExitCode, Verdict
from dyknow_coordinator import EvaluationStatus, diagnose
from dyknow_coordinator.reporting.evaluation_status import details
from dyknow_recordings.markers import Marker, Point
from dyknow_recordings.reporting.verdicts.message_types import (
    MARGIN,
    RESULT,
    VIOLATION,
    header,
    message,
    time_message,
)
from dyknow_stream_processing import Violation

_DURATION: Final = 'builtin_interfaces/msg/Duration'
UNDECIDED: Final = 0
_NUMBERS: Final = {Verdict.TRUE: 1, Verdict.UNDECIDED: UNDECIDED, Verdict.FALSE: -1}
_FAILED: Final = -2


def verdict_number(status: EvaluationStatus) -> int:
    """Return a verdict as a number to plot: 1 true, 0 undecided, -1 false, -2 error."""
    return _NUMBERS[status.verdict] if status.error is None else _FAILED


def number_message(number: int) -> Any:
    """Return a number as an Int8."""
    return message('std_msgs/msg/Int8', data=number)


def result_message(time: int, status: EvaluationStatus, episode: int) -> Any:
    """Return the end of an episode as a FormulaResult; its id is the number of the episode."""
    error = status.error
    exit_status = message(
        'dyknow_interfaces/msg/ExitStatus',
        code=int(ExitCode.SUCCESS if error is None else error.code),
        message='' if error is None else error.message,
    )
    return message(
        RESULT,
        header=header(time),
        formula_id=episode,
        formula_name=status.name,
        verdict=int(status.verdict),
        decided_at=time_message(status.decided_at),
        explanation=status.explanation,
        margin=message(MARGIN, **({} if status.margin is None else asdict(status.margin))),
        exit_status=exit_status,
    )


def violation_message(violation: Violation) -> Any:
    """Return a violation as a ConstraintViolation."""
    return message(
        VIOLATION,
        header=header(violation.available_time),
        stream_name=violation.stream_name,
        constraint=str(violation.constraint),
        valid_time=time_message(violation.valid_time),
        available_time=time_message(violation.available_time),
        observed=time_message(violation.observed, _DURATION),
        allowed=time_message(violation.allowed, _DURATION),
        message=violation.message,
    )


def diagnostic_status(status: EvaluationStatus, reporter: str) -> Any:
    """Return the diagnosis of a formula."""
    diagnosis = diagnose(status, status.started, silence_limit=0)
    known = dict(details(status))
    if not status.states_progressed:
        del known['states']  # It is known at the end of the recording only.
    return message(
        'diagnostic_msgs/msg/DiagnosticStatus',
        level=int(diagnosis.level),
        name=f'{reporter}: {status.name}',
        message=diagnosis.text,
        hardware_id='none',
        values=[
            message('diagnostic_msgs/msg/KeyValue', key=name, value=text)
            for name, text in known.items()
        ],
    )


def diagnostics_message(time: int, statuses: Iterable[Any]) -> Any:
    """Return the diagnoses of formulas as a DiagnosticArray."""
    return message(
        'diagnostic_msgs/msg/DiagnosticArray', header=header(time), status=list(statuses)
    )


def markers_message(time: int, frame: str, markers: Iterable[Marker], lifetime: int) -> Any:
    """Return markers, which viewers show for a lifetime, as a MarkerArray."""
    return message(
        'visualization_msgs/msg/MarkerArray',
        markers=[_marker(marker, header(time, frame), lifetime) for marker in markers],
    )


def _marker(marker: Marker, common: Any, lifetime: int) -> Any:
    red, green, blue, opacity = marker.colour
    return message(
        'visualization_msgs/msg/Marker',
        header=common,
        ns=marker.name,
        id=marker.number,
        type=int(marker.shape),
        pose=message(
            'geometry_msgs/msg/Pose',
            position=_point(marker.position),
            orientation=message('geometry_msgs/msg/Quaternion', w=1.0),
        ),
        scale=_point(marker.scale, 'geometry_msgs/msg/Vector3'),
        color=message('std_msgs/msg/ColorRGBA', r=red, g=green, b=blue, a=opacity),
        lifetime=time_message(lifetime, _DURATION),
        points=[_point(point) for point in marker.points],
        text=marker.text,
    )


def _point(point: Point, message_type: str = 'geometry_msgs/msg/Point') -> Any:
    x, y, z = point
    return message(message_type, x=x, y=y, z=z)
