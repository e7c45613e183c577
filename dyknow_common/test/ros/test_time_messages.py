"""Between messages of ROS and times and constraints of the core."""

import pytest
from dyknow_interfaces.msg import ExitStatus
from dyknow_interfaces.msg import StreamConstraints as StreamConstraintsMessage
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import CONSTRAINT_KINDS, DyKnowError, ExitCode, StreamConstraints
from dyknow_common.ros import (
    constraints_from_message,
    constraints_to_message,
    error_from_message,
    error_to_message,
    nanoseconds_to_duration,
    nanoseconds_to_time,
    time_to_nanoseconds,
)


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_times_come_back(nanoseconds: int) -> None:
    assert time_to_nanoseconds(nanoseconds_to_time(nanoseconds)) == nanoseconds


@given(st.integers(-(2**31 - 1) * 10**9, (2**31 - 1) * 10**9))
def test_durations_come_back(nanoseconds: int) -> None:
    assert time_to_nanoseconds(nanoseconds_to_duration(nanoseconds)) == nanoseconds


def test_a_duration_too_long_becomes_the_longest() -> None:
    assert nanoseconds_to_duration(10**20).sec == 2**31 - 1


def test_the_message_has_all_constraints() -> None:
    fields = StreamConstraintsMessage.get_fields_and_field_types().keys()
    assert fields <= CONSTRAINT_KINDS.keys()
    for name in CONSTRAINT_KINDS.keys() - fields:
        with pytest.raises(DyKnowError, match=f'no message has {name}; give it in the text'):
            constraints_to_message(StreamConstraints(**{name: True}))


@given(st.data())
def test_constraints_come_back(data: st.DataObject) -> None:
    names = StreamConstraintsMessage.get_fields_and_field_types()
    constraints = StreamConstraints(**{name: data.draw(st.integers(1, 10**12)) for name in names})
    assert constraints_from_message(constraints_to_message(constraints)) == constraints


@pytest.mark.parametrize('code', sorted(set(ExitCode) - {ExitCode.SUCCESS}))
def test_errors_come_back(code: ExitCode) -> None:
    error = error_from_message(error_to_message(DyKnowError('a fault', code)))
    assert error is not None
    assert (error.code, error.message) == (code, 'a fault')


def test_success_is_no_error() -> None:
    assert error_from_message(ExitStatus(code=0)) is None


def test_an_unknown_exit_code_is_still_an_error() -> None:
    """An answer of a later version must not raise a ValueError in the callback of a client."""
    error = error_from_message(ExitStatus(code=99, message='a fault'))
    assert error is not None
    assert (error.code, error.message) == (ExitCode.INTERNAL_ERROR, 'a fault')
