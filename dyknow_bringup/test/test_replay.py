import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_bringup.errors import BringupError
from dyknow_bringup.replay import MAX_STEP_NS, Replay, ReplayTime, Schedule
from dyknow_recordings import RecordedMessage

times = st.integers(0, 2 * 10**18)
rates = st.floats(0.001, 1000)
spans = st.integers(0, 10**12)


def message(log_time: int) -> RecordedMessage:
    return RecordedMessage(log_time, '/armed', 'std_msgs/msg/Bool', b'')


def test_twice_as_fast() -> None:
    schedule = Schedule.at_rate(1_000, 50_000, 2.0)
    assert schedule.due(1_000) == 50_000
    assert schedule.due(1_400) == 50_200
    assert schedule.log_time(50_200) == 1_400


def test_a_rate_is_what_the_user_wrote() -> None:
    assert Schedule.at_rate(0, 0, 0.1).rate == Fraction(1, 10)


@pytest.mark.parametrize('rate', [0.0, -1.0, 1e9, math.nan, math.inf])
def test_a_rate_that_makes_no_sense(rate: float) -> None:
    with pytest.raises(BringupError) as error:
        Schedule.at_rate(0, 0, rate)
    assert str(error.value) == (
        f'the rate {rate:g} makes no sense; use one from 0.000001 to 1000000, such as 2.0'
    )


@given(times, times, rates, spans)
def test_a_message_is_never_early_and_never_a_nanosecond_late(
    recording_start: int, replay_start: int, rate: float, span: int
) -> None:
    schedule = Schedule.at_rate(recording_start, replay_start, rate)
    log_time = recording_start + span
    due = schedule.due(log_time)
    assert schedule.log_time(due) >= log_time
    assert schedule.log_time(due - 1) < log_time


@given(st.lists(spans), st.lists(spans), rates)
def test_messages_go_once_in_order_when_due(
    recorded: list[int], asked: list[int], rate: float
) -> None:
    messages = [message(log_time) for log_time in sorted(recorded)]
    schedule = Schedule.at_rate(0, 10**9, rate)
    replay = Replay(messages, schedule)
    gone: list[RecordedMessage] = []
    for now in sorted(asked):
        gone += replay.due(now)
        assert gone == [each for each in messages if schedule.due(each.log_time) <= now]
        rest = messages[len(gone) :]
        assert replay.next_due == (schedule.due(rest[0].log_time) if rest else None)


def test_messages_are_read_when_they_are_needed() -> None:
    read: list[int] = []

    def recording() -> object:
        for log_time in range(10):
            read.append(log_time)
            yield message(log_time)

    replay = Replay(recording(), Schedule.at_rate(0, 0, 1.0))
    assert len(list(replay.due(3))) == 4
    assert read == [0, 1, 2, 3, 4]


def test_the_time_of_a_replay_stands_still_with_its_process() -> None:
    time = ReplayTime(1_000)
    assert time.at(1_000 + MAX_STEP_NS) == 1_000 + MAX_STEP_NS
    stalled = 1_000 + 41 * MAX_STEP_NS
    assert time.at(stalled) == 1_000 + 2 * MAX_STEP_NS
    assert time.at(stalled + 7) == 1_007 + 2 * MAX_STEP_NS
