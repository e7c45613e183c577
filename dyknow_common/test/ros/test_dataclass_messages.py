"""Tests of the conversion between dataclasses and messages."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import pytest
from dyknow_interfaces.msg import EvaluationStatus, ProbabilityInterval

from dyknow_common import SECOND_NS, DyKnowError, ExitCode, Margin
from dyknow_common.ros import from_message, to_message


class _Phase(IntEnum):
    GROUNDING = 0
    RUNNING = 1


@dataclass(frozen=True)
class _Probability:
    lower: float
    upper: float


@dataclass(frozen=True)
class _Status:
    name: str
    phase: _Phase = _Phase.GROUNDING
    started: int = 0
    decided_at: int | None = None
    topics: tuple[str, ...] = ()
    margin: Margin | None = None
    probability: _Probability | None = None
    unsent: str = 'not in the message'


@dataclass(frozen=True)
class _Failure:
    error: DyKnowError | None


FULL = _Status(
    'landing',
    _Phase.RUNNING,
    3 * SECOND_NS + 7,
    4 * SECOND_NS,
    ('a', 'b'),
    Margin(-1.0, 2.0),
    _Probability(0.25, 0.5),
)


@pytest.mark.parametrize('status', [_Status('landing'), FULL])
def test_what_was_written_is_read(status: _Status) -> None:
    assert from_message(_Status, to_message(status, EvaluationStatus())) == status


def test_fields_have_the_types_of_the_message() -> None:
    message = to_message(FULL, EvaluationStatus(events=['kept']))
    assert type(message.phase) is int
    assert (message.started.sec, message.started.nanosec) == (3, 7)
    assert list(message.probability) == [ProbabilityInterval(lower=0.25, upper=0.5)]
    assert list(message.events) == ['kept']


def test_an_error_is_an_exit_status() -> None:
    message = to_message(_Failure(DyKnowError('too late', ExitCode.TIMEOUT)), EvaluationStatus())
    assert (message.exit_status.code, message.exit_status.message) == (6, 'too late')
    error = from_message(_Failure, message).error
    assert error is not None
    assert (error.code, error.message) == (ExitCode.TIMEOUT, 'too late')
    assert from_message(_Failure, to_message(_Failure(None), EvaluationStatus())).error is None


def test_the_caller_gives_a_value() -> None:
    message = to_message(FULL, EvaluationStatus())
    message.phase = 9
    read = from_message(_Status, message, phase=_Phase.GROUNDING, unsent='given')
    assert (read.phase, read.unsent, read.topics) == (_Phase.GROUNDING, 'given', ('a', 'b'))


def test_an_unknown_number_is_refused() -> None:
    with pytest.raises(ValueError, match='9 is not a valid _Phase'):
        from_message(_Status, EvaluationStatus(phase=9))
