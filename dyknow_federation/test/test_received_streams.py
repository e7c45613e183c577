"""Samples are delivered in order, each once, whatever the link does."""

from __future__ import annotations

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from dyknow_common import SECOND_NS, Alternatives, Value
from dyknow_federation.errors import FederationError
from dyknow_federation.messages import (
    MAX_RANGES,
    Grant,
    Request,
    Samples,
    StreamFault,
    StreamMessage,
    Watermark,
)
from dyknow_federation.possible_values import PossibleValues, Precision
from dyknow_federation.receiving import MAX_HELD, Lost, Promise, Received, ReceivedStream
from dyknow_federation.sending import MAX_HISTORY, MAX_RESENT, SentStream, Thinning

NAME = 'level'
LARGE = 1e300


class Pair:
    """A stream that is sent and who receives it, over a link without a clock."""

    def __init__(self, history: int = 10**9) -> None:
        self.sent = SentStream(NAME, 1, history)
        self.stream = ReceivedStream(NAME)
        self.told: list[object] = []
        self.renew()

    def renew(self) -> None:
        for each in self.sent.renew('me', self.stream.request(), 10**18):
            self.take(each)

    def take(self, message: Grant | StreamMessage) -> None:
        if message.epoch > self.stream.epoch and isinstance(message, Grant):
            self.stream = ReceivedStream(NAME, message.epoch)
        elif message.epoch == self.stream.epoch and not isinstance(message, Grant):
            self.stream.take(message)
        self.told += self.stream.deliveries()

    @property
    def times(self) -> list[int]:
        return [each.valid_time for each in self.told if isinstance(each, Received)]


def test_what_is_lost_or_late_shows() -> None:
    stream = ReceivedStream(NAME)
    assert stream.request() == Request(NAME, 0, 0, ())

    def receive(message: StreamMessage) -> tuple[list[object], tuple[tuple[int, int], ...]]:
        stream.take(message)
        return list(stream.deliveries()), stream.request().missing

    def samples(first: int, *contents: Value | StreamFault) -> Samples:
        times = range(10 * first, 10 * (first + len(contents)), 10)
        return Samples(1, first, tuple(times), contents)

    early, ahead = (StreamFault(time, 'max_gap', 'none came') for time in (0, 10**6))
    assert receive(samples(7, 'a', early)) == ([Received(70, 'a'), early], ())
    assert receive(samples(11, 'e')) == ([], ((9, 10),))
    assert receive(Watermark(1, 13, 1, 125)) == ([], ((9, 10), (12, 12)))
    assert not stream.is_complete
    assert receive(Watermark(1, 12, 1, 115)) == ([], ((9, 10), (12, 12)))  # It is late.
    assert receive(samples(9, ahead, 'd')) == (
        [ahead, Received(100, 'd'), Received(110, 'e')],
        ((12, 12),),
    )
    assert receive(samples(12, 'f')) == ([Received(120, 'f'), Promise(125)], ())
    assert receive(samples(12, 'f')) == ([], ())
    assert receive(samples(16, 'j'))[0] == []
    assert receive(samples(14, 'h')) == ([], ((13, 13), (15, 15)))
    lost = Lost(1, 'the peer keeps them no more')
    found = receive(Watermark(1, 18, 17, 175))
    assert found == ([lost, Received(140, 'h'), lost, Received(160, 'j')], ((17, 17),))
    assert receive(samples(20, 'n'))[0] == []
    assert receive(Watermark(1, 22, 19, 215)) == (
        [Lost(2, 'the peer keeps them no more')],
        ((19, 19), (21, 21)),
    )


def test_a_stream_begins_with_what_comes_first() -> None:
    stream = ReceivedStream(NAME)
    stream.take(Watermark(1, 7, 3, 65))
    assert stream.request().missing == ((6, 6),)
    for number in range(8, 8 + 4 * MAX_RANGES, 2):
        stream.take(Samples(1, number, (number,), (0,)))
    assert len(stream.request().missing) == MAX_RANGES


@given(st.data())
def test_samples_arrive_in_order_and_once(data: st.DataObject) -> None:
    pair = Pair()
    on_the_way: list[Grant | StreamMessage] = []
    published = 0
    for action in data.draw(st.lists(st.sampled_from('ppsdddxxr'), min_size=15, max_size=60)):
        if action == 'p':
            published += 1
            pair.sent.publish(published, published)
        elif action == 's':
            on_the_way += [message for _, message in pair.sent.unsent()]
        elif action == 'r':
            on_the_way += pair.sent.renew('me', pair.stream.request(), 10**18)
        elif on_the_way:
            index = data.draw(st.integers(0, len(on_the_way) - 1))
            if action == 'd' and data.draw(st.booleans()):  # It may arrive once more.
                pair.take(on_the_way[index])
            else:
                found = on_the_way.pop(index)
                if action == 'd':
                    pair.take(found)
        assert pair.times == list(range(1, len(pair.times) + 1))
        promised = [each.time for each in pair.told if isinstance(each, Promise)]
        assert max(promised, default=0) <= len(pair.times)
    pair.renew()
    pair.renew()
    assert pair.times == list(range(1, published + 1))
    assert pair.stream.is_complete
    assert not pair.stream._held


def test_what_the_history_has_no_more_is_lost() -> None:
    pair = Pair(history=10)
    for time in range(1, 31):
        pair.sent.publish(time, 0)
        list(pair.sent.unsent())
    pair.renew()
    pair.renew()
    assert pair.told[0] == Lost(19, 'the peer keeps them no more')
    assert pair.times == list(range(20, 31))


@given(st.data())
def test_violations_arrive_in_order_and_once(data: st.DataObject) -> None:
    """Also the one before which nothing has arrived, as nothing may follow it."""
    pair = Pair()
    pair.stream = ReceivedStream(NAME)  # The answer to its first request is lost.
    sent, published = pair.sent, list[int]()
    for number, action in enumerate(data.draw(st.text('svfr', min_size=10, max_size=40)), 1):
        messages: list[StreamMessage] = []
        if action == 's':
            sent.publish(number, 0)
        elif action == 'v':
            sent.violate(StreamFault(number, 'max_gap', 'none came'))
        elif action == 'r':
            messages = sent.renew('me', pair.stream.request(), 10**18)
        else:
            messages = [message for _, message in sent.unsent()]
        published += [number] * (action in 'sv')
        for each in data.draw(st.permutations(messages)):
            if data.draw(st.booleans()):
                pair.take(each)
                assert_told(pair.told, published)
    for _ in range(3):
        pair.renew()
    found = assert_told(pair.told, published)
    assert found[-1:] == published[-1:]


def assert_told(told: list[object], published: list[int]) -> list[int]:
    """Check that what is told follows each other, and that nothing follows before a promise."""
    times = [each.valid_time for each in told if isinstance(each, Received | StreamFault)]
    assert not times or times == [each for each in published if times[0] <= each <= times[-1]]
    assert not any(isinstance(each, Lost) for each in told)
    if told and isinstance(told[-1], Promise):
        assert not [each for each in published if (times or [0])[-1] < each <= told[-1].time]
    return times


def test_a_peer_that_lies_about_times_is_not_believed() -> None:
    pair = Pair()
    for number in (1, 2):
        pair.take(Samples(1, number, (5,), (1,)))
    assert pair.told[-1] == Lost(1, 'it is valid at 5 ns, which is too early')
    pair.take(Watermark(1, 3, 1, 20))
    pair.take(Samples(1, 3, (20,), (1,)))
    assert pair.told[-1] == Lost(1, 'it is valid at 20 ns, which is too early')


def test_memory_is_bounded() -> None:
    pair = Pair()
    for first in range(2, 3 * MAX_HELD, 100):
        times = tuple(range(first, first + 100))
        pair.take(Samples(1, first, times, times))
    assert len(pair.stream._held) == MAX_HELD
    assert len(pair.stream.request().missing) == 2
    pair.take(Samples(1, 1, (1,), (1,)))
    assert len(pair.times) == MAX_HELD + 1
    for time in range(2 * MAX_HISTORY):
        pair.sent.publish(time, 0)
    assert len(pair.sent._kept) == MAX_HISTORY


def test_a_request_for_what_never_was_is_harmless() -> None:
    pair = Pair()
    pair.sent.publish(1, 1)
    strange = Request('level', 1, 10**15, ((-(2**62), -5), (3, 2**62)))
    assert [type(each) for each in pair.sent.renew('me', strange, 1)] == [Watermark]
    assert [type(each) for each in pair.sent.renew('other', strange, 1)] == [Watermark]


def test_a_request_is_answered_up_to_a_limit() -> None:
    sent, number = SentStream(NAME, 1, 10**9), 2 * MAX_RESENT
    for time in range(1, number + 1):
        sent.publish(time, 0)
    ranges = (2**61, 2**62), (number - 2, 2**62), (1, 2**62)
    *batches, _ = sent.renew('me', Request(NAME, 1, 1, ranges), 100)
    resent = [time for each in batches if isinstance(each, Samples) for time in each.valid_times]
    assert resent == [*range(number - 2, number + 1), *range(1, MAX_RESENT - 2)]
    assert sent.used_until == 100
    sent.expire(99)
    assert sent.subscribers
    sent.expire(100)
    assert not sent.subscribers


def test_a_promise_is_kept() -> None:
    sent = SentStream(NAME, 1, 10**9)
    sent.promise(5)
    with pytest.raises(FederationError, match=r'0\.000000005 s, not after 0\.000000005 s'):
        sent.publish(5, 0)
    sent.renew('me', Request(NAME, 0, 0, ()), 100)
    for expected in ([Watermark], []):
        assert [type(each) for _, each in sent.unsent()] == expected
    assert sent.publish(6, 0)
    for expected in ([Samples], []):
        assert [type(each) for _, each in sent.unsent()] == expected


def test_a_deadband_leaves_out_what_lies_within() -> None:
    thinning = Thinning(0, 0.5)
    values = (0.0, 0.5, -0.5, 0.75)
    assert [thinning.passes(*each) for each in enumerate(values)] == [True, False, False, True]


def test_an_unknown_value_is_not_left_out_for_the_rate() -> None:
    thinning = Thinning(10)
    samples = [(0, 1.0), (4, math.nan), (8, math.nan), (12, 2.0), (16, 1.0), (20, math.nan)]
    samples += [(29, 1.0), (30, 2.0)]
    taken = [time for time, value in samples if thinning.passes(time, value)]
    assert taken == [0, 4, 16, 20, 30]


@given(
    st.lists(st.integers(-4, 4).map(lambda each: each / 2) | st.floats(-2, 2) | st.just(math.nan)),
    st.sampled_from([0, 0.5, 1]),
)
@example([-1.0, 1e-17], 1)
def test_a_deadband_bounds_what_is_not_sent(values: list[float], deadband: float) -> None:
    thinning, sent = Thinning(0, deadband), math.nan
    for time, value in enumerate(values):
        if thinning.passes(time, value):
            sent = value
        lower, upper = Precision(deadband).ends(sent)
        assert lower <= value <= upper or (math.isnan(value) and math.isnan(sent))


@given(
    st.lists(st.integers(-6, 6).map(lambda each: each / 2) | st.floats() | st.integers()),
    st.sets(st.integers(-4, 4).map(lambda each: each / 2) | st.floats(-2, 2), min_size=1),
    st.sampled_from([None, 0, 0.5]),
)
@example([2**53 + 1, 2**53 + 3], {2.0**53 - 1}, None)
@example([1.0, 1.625, 0.75], {1.375}, 0.5)
def test_of_comparisons_all_is_known_that_all_samples_tell(
    values: list[float], compared: set[float], deadband: float | None
) -> None:
    constants = tuple(sorted(compared))
    thinning, all_leave = Thinning(0, deadband, constants), Thinning(0, deadband)
    precision = Precision(deadband or 0, constants, 'r')
    told: Value = math.nan
    sent = math.nan
    for time, value in enumerate(values):
        if thinning.passes(time, value):
            possible = PossibleValues()
            possible.put(time, time, value)
            ((_, told),) = possible.take(lambda: '', precision)
        bounds = told.bounds if isinstance(told, Alternatives) else (told, told)
        sent = value if all_leave.passes(time, value) else sent
        if math.isnan(value) or LARGE < abs(value) < math.inf:
            continue  # Of the largest ones, it is not known up to an error that they are finite.
        assert bounds[0] <= value <= bounds[1]
        for bound, other in zip(bounds, Precision(deadband or 0).ends(sent), strict=True):
            for constant in constants:
                assert (bound < constant, bound == constant) == (
                    other < constant,
                    other == constant,
                )


def test_after_a_violation_the_next_sample_is_sent() -> None:
    sent = SentStream(NAME, 1, 10**9, Thinning(constants=(5.0,)))
    assert [sent.publish(time, time) for time in range(3)] == [True, False, False]
    sent.violate(StreamFault(2, 'max_gap', 'none came'))
    assert [sent.publish(time, 3) for time in range(3, 6)] == [True, False, False]
    assert sent.continued(2).publish(0, 3)  # The clock was set back.


def test_a_rate_holds_after_a_clock_was_set_back() -> None:
    thinning = Thinning(10)
    times = [100, 105, 50, 55, 60]
    assert [each for each in times if thinning.passes(each, each)] == [100, 50, 60]


def test_a_value_within_a_deadband_is_sent_again() -> None:
    thinning = Thinning(0, 0)
    sent = [time for time in range(25) if thinning.passes(time * SECOND_NS, value=True)]
    assert sent == [0, 10, 20]
    assert thinning.passes(25 * SECOND_NS, value=False)
    assert not thinning.passes(26 * SECOND_NS, value=False)
