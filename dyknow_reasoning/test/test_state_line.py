"""Which states count, of one stream after another, against all that there are."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from dyknow_reasoning import Breach, ReadStream, StateLine
from dyknow_reasoning.state_line import HAND_OVER_LIMIT_NS, MAX_KEPT, StandbyStates


@dataclass(frozen=True)
class Tick:
    valid_time: int


class Reader:
    """Reads streams through a line, and notes what counts."""

    def __init__(self) -> None:
        self.counted: list[int | str] = []
        self.gaps: list[tuple[int, int | None]] = []
        self.published: dict[ReadStream[Tick], list[int]] = {}
        self.line: StateLine[ReadStream[Tick]] = StateLine(self._begin_gap, self._end_gap)
        self.line.change(self.stream(), 0)

    def stream(self) -> ReadStream[Tick]:
        made: ReadStream[Tick] = ReadStream()
        self.published[made] = []
        return made

    def _begin_gap(self, after: int) -> None:
        self.counted.append('gap')
        self.gaps.append((after, None))

    def _end_gap(self, before: int) -> None:
        self.gaps[-1] = self.gaps[-1][0], before

    def publish(self, stream: ReadStream[Tick], valid_time: int, now: int = 0) -> None:
        self.published[stream].append(valid_time)
        if stream is self.line.stream:
            self._receive(valid_time)
        else:
            stream.kept.add(Tick(valid_time), self.line.latest)
        self.look(now)

    def _receive(self, valid_time: int) -> None:
        if self.line.receive(valid_time):
            self.counted.append(valid_time)

    def look(self, now: int) -> None:
        if self.line.next and self.line.is_due(now):
            self.change(self.line.next, now)

    def change(self, stream: ReadStream[Tick], now: int = 0) -> None:
        self.line.change(stream, now)
        for each in stream.kept.take():
            self._receive(each.valid_time)

    def violate(self, stream: ReadStream[Tick], valid_time: int) -> bool:
        stream.breach = Breach(valid_time, 'broken')
        stream.doubt(valid_time)
        return self.line.break_off(stream, valid_time)


def in_use(reader: Reader) -> ReadStream[Tick]:
    assert reader.line.stream is not None
    return reader.line.stream


STEPS = st.lists(
    st.sampled_from(['use', 'use', 'use', 'other', 'other', 'hand over', 'change', 'violate'])
    | st.integers(-3, 3),
    min_size=15,
    max_size=40,
)


@given(STEPS)
@example(['use', 'hand over', 'use', 'other', 'use'])
@example(['use', 'hand over', 'other', 'use', -1, 'use', 'other'])
def test_random_streams(steps: list[str | int]) -> None:
    reader, late = Reader(), 0
    other, clock = reader.stream(), 0
    for step in steps:
        if isinstance(step, int):
            late = step
        elif step in {'use', 'other'}:
            stream = in_use(reader) if step == 'use' else other
            clock += 1
            at = max([clock + late, *(each + 1 for each in reader.published[stream][-1:])])
            reader.publish(stream, at)
        elif step == 'hand over':
            reader.line.hand_over(other, 0)
            reader.look(0)
        elif step == 'change':
            reader.change(other)
        else:
            former = in_use(reader)
            reader.violate(former, max(clock + late, 0))
            before = len(reader.counted)
            reader.publish(former, max(clock, *reader.published[former], 0) + 1)
            assert in_use(reader) is not former or len(reader.counted) == before
        if other is in_use(reader):
            other = reader.stream()
    check(reader)


def check(reader: Reader) -> None:
    """Check that states between two counted ones lie in a gap, and that gaps are reported."""
    times = [each for each in reader.counted if isinstance(each, int)]
    assert times == sorted(set(times))
    found = []
    for position, each in enumerate(reader.counted):
        if each == 'gap':
            later = reader.counted[position + 1 : position + 2]
            found.append((reader.counted[position - 1], later[0] if later else None))
            assert 'gap' not in reader.counted[position + 1 : position + 2]
        elif position and isinstance(before := reader.counted[position - 1], int):
            assert isinstance(each, int)
            # One stream has both, or states of the later one from before the former.
            assert any(
                each in stream and stream[0] <= before and not _between(stream, before, each)
                for stream in reader.published.values()
            )
    assert reader.gaps == found


def _between(stream: list[int], before: int, after: int) -> list[int]:
    return [each for each in stream if before < each < after]


@pytest.mark.parametrize(('doubtful', 'expected'), [(2, [1, 2, 'gap', 3]), (3, [1, 2, 3])])
@pytest.mark.parametrize('is_next', [False, True])
def test_counted_states_that_a_violation_makes_doubtful(
    doubtful: int, expected: list[int | str], *, is_next: bool
) -> None:
    reader = Reader()
    former, other = in_use(reader), reader.stream()
    for each in (1, 2):
        reader.publish(former, each)
    for each in (2, 3):
        reader.publish(other, each)
    for each in (3, doubtful, 3):  # The least counts.
        reader.violate(former, each)
    if is_next:
        reader.line.hand_over(other, 0)
        reader.look(0)
    else:
        reader.change(other)
    assert reader.counted == expected


def test_a_stream_that_lacks_no_state_replaces_another_without_a_gap() -> None:
    reader = Reader()
    for start in (0, 10):
        former, other = in_use(reader), reader.stream()
        reader.publish(former, start + 2)
        reader.publish(other, start + 3)
        reader.line.hand_over(other, 0)
        reader.look(0)
        assert in_use(reader) is former
        reader.publish(former, start + 4)
        assert in_use(reader) is other
        assert reader.line.skipped == 1
        reader.publish(other, start + 5)
        assert not reader.line.catches_up
    assert reader.counted == [2, 4, 5, 12, 14, 15]


def test_a_loss_before_a_state_gives_a_gap() -> None:
    reader = Reader()
    reader.publish(in_use(reader), 1)
    assert reader.line.receive(2, is_after_loss=True)
    assert reader.gaps == [(1, 2)]


def test_a_violated_stream_is_left_for_one_that_lacks_states() -> None:
    reader = Reader()
    former, other = in_use(reader), reader.stream()
    reader.publish(former, 1)
    reader.line.hand_over(other, 0)
    assert reader.violate(former, 2)
    assert not reader.violate(former, 3)
    assert reader.line.paused_at == 2
    reader.look(0)
    reader.line.note_gap()  # There is one already.
    reader.publish(other, 3)
    assert reader.counted == [1, 'gap', 3]


def test_a_stream_that_goes_back_in_time_is_not_skipped() -> None:
    reader = Reader()
    for each in (2, 1):
        reader.publish(in_use(reader), each)
    assert reader.counted == [2, 1]  # The formulas fail at the second one.


def test_before_the_first_state_nothing_can_be_missing() -> None:
    reader = Reader()
    other = reader.stream()
    reader.line.note_gap()
    assert not reader.line.catches_up
    assert not reader.line.is_due(0)
    reader.line.hand_over(other, 0)
    reader.look(0)
    assert in_use(reader) is other
    assert reader.line.next is None
    reader.publish(other, 3)
    assert reader.counted == [3]


@pytest.mark.parametrize(('wait', 'expected'), [(0, [1, 2]), (1, [1, 2, 'gap', 3])])
def test_a_hand_over_has_a_limit(wait: int, expected: list[int | str]) -> None:
    reader = Reader()
    former, better = in_use(reader), reader.stream()
    reader.publish(former, 1)
    reader.line.hand_over(better, 100)
    reader.look(100 + HAND_OVER_LIMIT_NS)  # Without a state, it is no better.
    reader.publish(former, 2)
    reader.publish(better, 3, 100 + HAND_OVER_LIMIT_NS - 1)
    reader.look(100 + HAND_OVER_LIMIT_NS - 1 + wait)
    assert reader.counted == expected


def test_a_stream_that_broke_a_constraint_before_it_is_used_pauses_the_line() -> None:
    reader = Reader()
    reader.publish(in_use(reader), 1)
    other = reader.stream()
    reader.publish(other, 1)
    assert not reader.violate(other, 1)
    assert not reader.line.pause
    reader.change(other, 7)
    assert reader.line.pause is other.breach
    assert reader.line.paused_at == 7
    reader.publish(other, 2)
    assert reader.counted == [1]


@given(st.lists(st.integers(0, 1), max_size=60), st.lists(st.integers(0, 60), max_size=60))
@example([1] * 5, [0, 0, 4, 4, 4])
def test_only_what_a_take_over_needs_is_kept(steps: list[int], counted: list[int]) -> None:
    states: StandbyStates[Tick] = StandbyStates()
    every: list[int] = []
    latest = None
    for step, reached in zip(steps, counted, strict=False):
        every.append((every[-1] if every else 0) + 1 + step)
        latest = max(latest or 0, reached)
        states.add(Tick(every[-1]), latest)
        needed = [each for each in every if each > latest]
        before = [each for each in every if each <= latest][-1:]
        assert states.continue_from(latest) == bool(before)
        assert [each.valid_time for each in list(states._states)] == before + needed
    assert len(states.take()) <= len(every)
    assert not states.continue_from(latest or 0)


def test_a_stream_that_runs_ahead_for_too_long_gives_a_gap() -> None:
    reader = Reader()
    reader.publish(in_use(reader), 5)
    other = reader.stream()
    for valid_time in range(5, 5 + MAX_KEPT):
        reader.publish(other, valid_time)
    assert other.kept.continue_from(5)
    reader.publish(other, 5 + MAX_KEPT)
    reader.change(other)
    assert reader.counted[:3] == [5, 'gap', 6]


def test_a_recreated_stream_begins_with_states_that_do_not_count() -> None:
    """Of its former publisher, the last states may be lost: there is a gap."""
    reader = Reader()
    for each in (1, 2, 3):
        reader.publish(in_use(reader), each)
    for each in (2, 3, 4):
        if reader.line.receive(each, is_after_loss=each == 2):
            reader.counted.append(each)
    assert reader.counted == [1, 2, 3, 'gap', 4]
    assert reader.gaps == [(3, 4)]
    assert reader.line.skipped == 2
    assert not reader.line.catches_up


def test_states_lost_before_a_stream_has_caught_up_give_no_gap() -> None:
    reader = Reader()
    reader.publish(in_use(reader), 5)
    other = reader.stream()
    reader.publish(other, 2)
    reader.change(other)
    assert not reader.line.receive(4, is_after_loss=True)
    assert reader.line.receive(6)
    assert reader.gaps == []
