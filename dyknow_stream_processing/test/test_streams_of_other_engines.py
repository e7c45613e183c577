"""Two dataflows; the second reads a stream of the first over a link with delays.

The reference is a single dataflow with both streams, in which nothing is delayed, stopped or dead.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from recorded_flow import Flow

from dyknow_common import NO_CONSTRAINTS, REPAIR_NS
from dyknow_stream_processing import (
    Dataflow,
    ReceivedViolations,
    Sample,
    SourceType,
    Violation,
    parse_specification,
)
from dyknow_stream_processing.dataflow.received import (
    PATIENCE,
    SPACING,
    ReceivedWatermarks,
    SampleOrigin,
)

pytestmark = pytest.mark.long

END = 80
QUIET = 30
ID = 7
MADE = {
    'stamped': 'select n as n from "a" with max_delay = 6 ns',
    'receipt': 'select n as n from "receipt"',
    'unit': 'compunit m: float maximum((n: float)); '
    'sink maximum(select n as n from "a" with max_delay = 6 ns)',
    'merge': 'merge((select n as n from "a" where n > 5 with max_delay = 12 ns), '
    '(select n as n from "a" where n <= 5 with max_delay = 6 ns))',
}
READ = {
    'latest': 'sync((select {0} as a from {1}), (select n as b from "b" with max_delay = 3 ns))',
    'periodic': 'sync((select {0} as a from {1}), (select n as b from "b" with max_delay = 3 ns)) '
    'with start_time = 0, sample_period = 4 ns',
    'limited': 'sync((select {0} as a from {1} with max_delay = 30 ns), '
    '(select n as b from "b" with max_delay = 3 ns)) with start_time = 0, sample_period = 4 ns',
    'merged': 'sync((select {0} as a from merge({1}, (select n as {0} from "b" where n > 5))), '
    '(select n as b from "b" with max_delay = 3 ns)) with start_time = 0, sample_period = 3 ns',
}

Tick = tuple[int, tuple[object, ...]]


@dataclass
class Message:
    """A message of the first engine: a sample, or a watermark alone."""

    due: int
    number: int
    content: Sample | int


class Recorder:
    """A dataflow with one stream."""

    def __init__(self, text: str) -> None:
        self.samples: list[Sample] = []
        self.violations: list[Violation] = []
        self.flow = Dataflow({'maximum': max_of}, source_type)
        specification = parse_specification(text)
        self.flow.create('s', specification, NO_CONSTRAINTS, self._take, self.violations.append)

    def _take(self, sample: Sample) -> None:
        # After a violation, nobody uses the samples.
        if not self.violations:
            self.samples.append(sample)

    def ticks(self) -> list[Tick]:
        return [(each.valid_time, tuple(each.fields.values())) for each in self.samples]


def max_of(fields: dict[str, float]) -> float:
    return fields['n']


def source_type(topic: str) -> SourceType | None:
    return SourceType(None, receipt_time=True) if topic == 'receipt' else None


class Engine:
    """The first engine: it may stop, and continue or not."""

    def __init__(self, text: str, stops: range, sample_delays: Sequence[int]) -> None:
        self.recorder = Recorder(text)
        self._stops = stops
        self._delays = deque(sample_delays)
        self._inbox: list[tuple[int, str, int, int]] = []
        self._number = 0
        self._watermark = 0
        self.sent: deque[Message] = deque()
        self.vouched: deque[Message] = deque()

    def receive(self, now: int, topic: str, valid_time: int, value: int) -> None:
        in_pause = now in self._stops and topic != 'receipt'
        received = max(valid_time, self._stops.start) if in_pause else now
        self._inbox.append((received, topic, valid_time, value))

    def step(self, now: int) -> None:
        if now in self._stops:
            return
        flow = self.recorder.flow
        for received, topic, valid_time, value in sorted(self._inbox):
            stamp = received if topic == 'receipt' else valid_time
            flow.push(topic, Sample(stamp, received, {'n': value}))
        self._inbox.clear()
        flow.advance(now)
        for sample in self.recorder.samples:
            self._number += 1
            self._watermark = sample.watermark or 0
            self._send(self.sent, now, sample)
        self.recorder.samples.clear()
        if (watermark := flow.watermark('s')) > self._watermark:
            self._send(self.vouched, now, watermark)

    def _send(self, topic: deque[Message], now: int, content: Sample | int) -> None:
        self._delays.rotate(-1)
        due = now + self._delays[0]
        topic.append(Message(max(due, topic[-1].due if topic else 0), self._number, content))


class Reader:
    """The second engine."""

    def __init__(self, text: str) -> None:
        self.recorder = Recorder(text)
        self._watermarks = ReceivedWatermarks()

    def take(self, message: Message, now: int) -> None:
        flow, content = self.recorder.flow, message.content
        if isinstance(content, Sample):
            assert self._watermarks.note_sample(ID, message.number, now=0) is SampleOrigin.SAME
            arrived = Sample(content.valid_time, now, content.fields, content.watermark)
            flow.push('far', arrived, is_checked=True)
        else:
            self._watermarks.note_watermark(ID, message.number, content)
        watermark = self._watermarks.due()
        if watermark is not None:
            flow.vouch('far', watermark, now)


@dataclass
class Case:
    """Events of a robot as pairs of valid time and delay, and the faults."""

    first: list[tuple[int, int]]
    second: list[tuple[int, int]]
    stops: range
    delays: list[int]


def case() -> st.SearchStrategy[Case]:
    times = st.integers(0, END - 1)
    stops = st.tuples(times, st.integers(1, 30)).map(lambda stop: range(stop[0], sum(stop)))
    never, killed = st.just(range(0)), times.map(lambda time: range(time, 10 * END))
    return st.builds(
        Case,
        st.lists(
            st.tuples(times, st.integers(0, 5)),
            min_size=3,
            max_size=25,
            unique_by=lambda each: each[0],
        ),
        st.lists(
            st.tuples(times, st.integers(0, 3)),
            min_size=3,
            max_size=25,
            unique_by=lambda each: each[0],
        ),
        st.one_of(never, stops, killed),
        st.lists(st.integers(0, 12), min_size=1, max_size=9),
    )


def arrivals(events: Sequence[tuple[int, int]]) -> list[tuple[int, int, int]]:
    """Time of receipt, valid time and value, in the order of receipt."""
    return sorted(
        (valid_time + delay, valid_time, number)
        for number, (valid_time, delay) in enumerate(events)
    )


def expected(made: str, read: str, events: Case) -> list[Tick]:
    """The ticks of a single engine that has both streams."""
    field = 'm' if made == 'unit' else 'n'
    text = MADE[made].removeprefix('compunit m: float maximum((n: float)); sink ')
    prefix = 'compunit m: float maximum((n: float)); ' if made == 'unit' else ''
    single = Recorder(prefix + 'sink ' + READ[read].format(field, f'({text})'))
    topic = 'receipt' if made == 'receipt' else 'a'
    for now in range(END + QUIET):
        for at, valid_time, value in arrivals(events.first):
            if at == now:
                stamp = now if topic == 'receipt' else valid_time
                single.flow.push(topic, Sample(stamp, now, {'n': value}))
        for at, valid_time, value in arrivals(events.second):
            if at == now:
                single.flow.push('b', Sample(valid_time, now, {'n': value}))
        single.flow.advance(now)
    assert single.violations == [] or made == 'merged' or read == 'merged'
    return single.ticks()


def run(made: str, read: str, events: Case) -> Reader:
    """Run both engines until the first violation."""
    field = 'm' if made == 'unit' else 'n'
    engine, reader = (
        Engine(MADE[made], events.stops, events.delays),
        Reader('sink ' + READ[read].format(field, '"far"')),
    )
    topic = 'receipt' if made == 'receipt' else 'a'
    for now in range(END + QUIET):
        for at, valid_time, value in arrivals(events.first):
            if at == now:
                engine.receive(now, topic, valid_time, value)
        for at, valid_time, value in arrivals(events.second):
            if at == now:
                reader.recorder.flow.push('b', Sample(valid_time, now, {'n': value}))
        engine.step(now)
        for sent in (engine.vouched, engine.sent):
            while sent and sent[0].due <= now:
                reader.take(sent.popleft(), now)
        reader.recorder.flow.advance(now)
        if reader.recorder.violations:
            break
    return reader


@pytest.mark.parametrize('made', MADE)
@pytest.mark.parametrize('read', READ)
@given(events=case())
def test_each_tick_is_that_of_a_single_engine(made: str, read: str, events: Case) -> None:
    if made == 'receipt':
        # The times of receipt of a stopped engine are unknown; they differ from each other.
        assume(not events.stops or events.stops.stop > END + QUIET)
        assume(len({sum(each) for each in events.first}) == len(events.first))
    if read == 'merged':
        # Of two samples with the same valid time, the one that comes later replaces the other.
        seconds = {valid_time for valid_time, _ in events.second}
        assume(not seconds & {time for each in events.first for time in (each[0], sum(each))})
    reader = run(made, read, events)
    wanted, found = expected(made, read, events), reader.recorder.ticks()
    assert set(found) <= set(wanted), (found, wanted)
    if not events.stops and not reader.recorder.violations:
        until = END
        assert [each for each in found if each[0] < until] == [
            each for each in wanted if each[0] < until
        ]


def test_the_clock_vouches_for_nothing(flow: Flow) -> None:
    flow.create(
        'sync((select x as a from "far" with max_delay = 5 ms), '
        '(select x as b from "b" with max_delay = 5 ms)) with sample_period = 10 ms'
    )
    flow.push('far', 0, 1, watermark=1, x=1)
    flow.push('b', 0, 1, x=1)
    flow.advance(100)
    assert flow.times() == [0]
    flow.dataflow.vouch('far', 25_000_000, 101_000_000)
    assert flow.times() == [10, 20]
    flow.push('far', 24, 102, watermark=30, x=2)
    assert flow.broken() == [('valid_time_order', 24)]


def test_the_clock_reports_the_silence_of_an_engine(flow: Flow) -> None:
    flow.create('"far" with max_delay = 5 ms, sample_period = 10 ms')
    flow.push('far', 0, 1, watermark=0, x=1)
    flow.advance(20)
    assert flow.broken() == [('sample_period', 10)]


def test_watermarks_wait_for_the_samples_before_them() -> None:
    received = ReceivedWatermarks()
    assert received.note_sample(ID, 1, now=0) is SampleOrigin.SAME
    assert received.note_watermark(ID, 2, 20)
    assert received.due() is None
    received.note_sample(ID, 2, now=0)
    assert (received.due(), received.due()) == (20, None)


def test_samples_that_never_come_are_lost() -> None:
    received = ReceivedWatermarks()
    received.note_sample(ID, 1, now=0)
    assert lost_before(received, SPACING) == [0] * (PATIENCE - 1) + [3]
    assert received.due() == 20


def test_watermarks_that_come_all_at_once() -> None:
    """The samples before them may be the next messages that are taken."""
    received = ReceivedWatermarks()
    received.note_sample(ID, 1, now=0)
    assert not any(lost_before(received, SPACING // PATIENCE))
    assert received.due() is None
    received.note_sample(ID, 4, now=0)
    assert received.due() == 20


def test_samples_from_before_the_subscription_are_not_lost() -> None:
    received = ReceivedWatermarks()
    assert not any(lost_before(received, SPACING))
    assert received.due() == 20


def lost_before(received: ReceivedWatermarks, spacing: int) -> list[int]:
    """Return what is lost at each of some watermarks after the fourth sample."""
    assert received.note_watermark(ID, 4, 20)
    return [received.lost(number * spacing) for number in range(PATIENCE)]


def test_a_stream_that_was_replaced_is_heard_no_more() -> None:
    received = ReceivedWatermarks()
    received.note_sample(ID, 5, now=0)
    assert received.note_sample(9, 1, now=0) is SampleOrigin.RECREATED
    assert received.note_sample(ID, 6, now=0) is SampleOrigin.FORMER
    received.note_watermark(ID, 6, 50)
    assert received.due() is None
    assert received.note_sample(9, 2, now=0) is SampleOrigin.SAME


def test_a_stream_that_was_chosen_before_its_first_sample() -> None:
    received = ReceivedWatermarks()
    assert received.expect(ID) is SampleOrigin.SAME
    assert received.note_sample(9, 1, now=0) is SampleOrigin.RECREATED
    # It was chosen by who knew less: it may still be made.
    assert received.note_sample(ID, 1, now=0) is SampleOrigin.RECREATED
    assert received.note_sample(9, 2, now=0) is SampleOrigin.FORMER


def test_a_stream_that_was_chosen_in_place_of_the_one_so_far() -> None:
    received = ReceivedWatermarks()
    received.note_sample(ID, 5, now=0)
    assert received.expect(ID) is SampleOrigin.SAME
    assert received.expect(9) is SampleOrigin.RECREATED
    assert received.note_sample(9, 1, now=0) is SampleOrigin.SAME
    # The one so far may come again, as its last samples may still be on their way.
    assert received.note_sample(ID, 6, now=0) is SampleOrigin.RECREATED
    assert received.expect(9) is SampleOrigin.FORMER


def test_a_stream_that_was_replaced_by_late_samples_of_its_predecessor() -> None:
    """An engine that was stopped sends on, until it hears that another one makes its stream."""
    received = ReceivedWatermarks()
    received.expect(9)
    received.note_sample(9, 1, now=0)
    assert received.note_sample(ID, 70, now=1) is SampleOrigin.RECREATED
    assert received.note_sample(9, 2, now=2) is SampleOrigin.FORMER
    # A watermark or a sample shows that the stream taken for the present one is still made.
    received.note_watermark(ID, 70, 50)
    assert received.note_sample(9, 3, now=REPAIR_NS + 2) is SampleOrigin.FORMER
    assert received.note_sample(ID, 71, now=REPAIR_NS + 3) is SampleOrigin.SAME
    assert received.note_sample(9, 4, now=REPAIR_NS + 4) is SampleOrigin.FORMER
    assert received.note_sample(9, 5, now=2 * REPAIR_NS + 3) is SampleOrigin.FORMER
    assert received.expect(9) is SampleOrigin.FORMER
    assert received.note_sample(9, 6, now=2 * REPAIR_NS + 4) is SampleOrigin.RECREATED
    assert received.note_sample(9, 7, now=2 * REPAIR_NS + 5) is SampleOrigin.SAME
    assert received.note_sample(ID, 72, now=2 * REPAIR_NS + 5) is SampleOrigin.FORMER
    assert received.expect(9) is SampleOrigin.SAME


@given(st.lists(st.booleans(), max_size=12), st.integers(0, 6), st.data())
def test_no_sample_overtakes_a_violation_unnoticed(
    published: list[bool], start: int, data: st.DataObject
) -> None:
    """Violations (True) and samples are two topics, each in order; a sample names what was before.

    A reader may trust a sample only if all violations before it since `start` were received.
    """
    times = list(enumerate(published, 1))
    violations = deque(time for time, is_violation in times if is_violation)
    samples = deque(time for time, is_violation in times if not is_violation)
    received, heard, is_doubtful, has_missed = ReceivedViolations(start), 0, False, False
    while samples:
        if violations and data.draw(st.booleans()):
            heard = violations.popleft()
            assert received.note(heard) == (heard >= start)
            continue
        time = samples.popleft()
        before = [each for each, is_violation in times if is_violation and each < time]
        is_doubtful |= received.note_sample(max(before, default=0))
        has_missed |= any(each >= max(start, heard + 1) for each in before)
        assert is_doubtful == has_missed


def test_a_sample_after_violations_that_were_received() -> None:
    received = ReceivedViolations(10)
    assert not received.note_sample(9)
    assert received.note(12)
    assert not received.note_sample(12)
    assert [received.note_sample(15), received.note_sample(15)] == [True, False]
    assert received.note(15)
