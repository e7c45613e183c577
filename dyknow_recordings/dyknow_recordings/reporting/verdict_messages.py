"""Verdicts, diagnostics and markers as messages, as the nodes publish them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from dyknow_common import SECOND_NS, ExitCode, Verdict, sourced_prefixes
from dyknow_coordinator import EvaluationStatus, diagnose
from dyknow_coordinator.reporting.evaluation_status import details
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.markers import Marker, Point
from dyknow_stream_processing import Violation

VIOLATION: Final = 'dyknow_interfaces/msg/ConstraintViolation'
RESULT: Final = 'dyknow_interfaces/msg/FormulaResult'
MARGIN: Final = 'dyknow_interfaces/msg/Margin'
_OWN: Final = (VIOLATION, RESULT, MARGIN, 'dyknow_interfaces/msg/ExitStatus')
_MAX_SECONDS: Final = 2**31 - 1
"""The last second of a time in a message, in the year 2038."""

_NUMPY: Final = {'byte': 'uint8', 'bool': 'bool'}

_DURATION: Final = 'builtin_interfaces/msg/Duration'

UNDECIDED: Final = 0

_NUMBERS: Final = {Verdict.TRUE: 1, Verdict.UNDECIDED: UNDECIDED, Verdict.FALSE: -1}

_FAILED: Final = -2


@lru_cache(maxsize=1)
def message_types() -> Typestore:
    """Return the types of ROS 2 Jazzy and DyKnow.

    Raises:
        RecordingError: if the definitions of DyKnow's messages are not installed.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in _OWN:
        store.register(get_types_from_msg(_definition(f'{name.rpartition("/")[2]}.msg'), name))
    return store


def message(message_type: str, **fields: Any) -> Any:
    """Return a message; fields that are not given have their default values."""
    return _constructor(message_type)(**fields)


def serialized(found: Any) -> bytes:
    """Return the bytes of a message."""
    return bytes(message_types().serialize_cdr(found, found.__msgtype__))


def time_message(time: int | None, message_type: str = 'builtin_interfaces/msg/Time') -> Any:
    """Return a time in nanoseconds as a message: zero for None, the last one for a later time."""
    seconds, nanoseconds = divmod(min(time or 0, _MAX_SECONDS * SECOND_NS), SECOND_NS)
    return message(message_type, sec=seconds, nanosec=nanoseconds)


def header(time: int, frame: str = '') -> Any:
    """Return a header."""
    return message('std_msgs/msg/Header', stamp=time_message(time), frame_id=frame)


def _definition(file: str) -> str:
    """Return the definition of a message of dyknow_interfaces."""
    folders = (
        Path(__file__).with_name('msg'),  # of the wheel
        *(each / 'share' / 'dyknow_interfaces' / 'msg' for each in sourced_prefixes()),
        Path(__file__).resolve().parents[3] / 'dyknow_interfaces' / 'msg',  # of the sources
    )
    for folder in folders:
        path = folder / file
        if path.is_file():
            return path.read_text(encoding='utf-8')
    raise RecordingError(
        f'the definition {file} of dyknow_interfaces is not installed; '
        'source the setup.bash of the workspace, or install the wheel of DyKnow',
        ExitCode.UNAVAILABLE,
    )


@lru_cache(maxsize=64)
def _constructor(message_type: str) -> Callable[..., Any]:
    """Return a function that makes messages of a type."""
    store = message_types()
    _, fields = store.fielddefs[message_type]
    message_class: Callable[..., Any] = store.types[message_type]
    defaults = {name: _default(description) for name, description in fields}

    def construct(**given: Any) -> Any:
        return message_class(**{**defaults, **given})

    return construct


def _default(description: Any) -> Any:
    """Return the default value of a field; it is shared, and never changed."""
    kind, detail = description
    if kind == Nodetype.NAME:
        return message(detail)
    if kind == Nodetype.BASE:
        name = detail[0]
        return '' if name in {'string', 'wstring'} else _zero(name).item()
    (element, (name, *_)), length = detail
    if element == Nodetype.BASE and name != 'string':
        return np.zeros(length if kind == Nodetype.ARRAY else 0, _zero(name).dtype)
    return [_default(detail[0])] * (length if kind == Nodetype.ARRAY else 0)


def _zero(name: str) -> np.generic:
    zero: np.generic = np.dtype(_NUMPY.get(name, name)).type(0)
    return zero


def verdict_number(status: EvaluationStatus) -> int:
    """Return a verdict as a number to plot: 1 true, 0 undecided, -1 false, -2 error."""
    return _NUMBERS[status.verdict] if status.error is None else _FAILED


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
