"""The order of the stamps of a topic with a `max_delay`: by one publisher, or by several."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded_flow import Flow

from dyknow_common import NO_CONSTRAINTS, DyKnowError
from dyknow_stream_processing import SourceType, Violation, parse_specification

MAX_DELAY = 8
END = 100


def test_samples_of_one_publisher_pass_at_once(flow: Flow) -> None:
    flow.ordered_topics.add('a')
    flow.create('select x from "a" with max_delay = 10 ms')
    flow.push('a', 5, 6, x=1)
    flow.push('a', 7, 9, x=2)
    assert flow.times() == [5, 7]
    flow.push('a', 6, 10, x=3)
    flow.push('a', 7, 10, x=4)
    assert flow.take() == [(7, {'x': 4})]
    assert flow.drops == {'valid_time_order': 1}
    (violation,) = flow.violations
    assert violation.message == (
        "stream 's': the sample valid at 0.006 s came after the one valid at 0.007 s; "
        'with reorder = true, samples that come within max_delay are put in order'
    )


def test_what_is_late_is_still_dropped(flow: Flow) -> None:
    flow.ordered_topics.add('a')
    flow.create('"a" with max_delay = 10 ms')
    flow.push('a', 5, 16, x=1)
    assert (flow.times(), flow.broken()) == ([], [('max_delay', 5)])


def test_a_sync_of_ordered_topics_does_not_wait(flow: Flow) -> None:
    flow.ordered_topics |= {'a', 'b'}
    flow.create(
        'sync(select x as a from "a" with max_delay = 500 ms, '
        'select x as b from "b" with max_delay = 500 ms) with sample_period = 10 ms'
    )
    flow.push('a', 0, 1, x=0)
    flow.push('b', 0, 1, x=0)
    flow.push('a', 10, 11, x=1)
    assert flow.times() == [0]
    flow.push('b', 10, 12, x=1)
    assert flow.take() == [(10, {'a': 1, 'b': 1})]


@pytest.mark.parametrize(
    ('text', 'is_ordered', 'is_held'),
    [
        ('"a" with max_delay = 9 ms', True, False),
        ('"a" with max_delay = 9 ms', False, True),
        ('"a" with max_delay = 9 ms, reorder = true', True, True),
        ('"a" with max_delay = 9 ms, reorder = false', False, False),
        ('select x from ("a" with max_delay = 9 ms, reorder = true)', True, True),
        ('select x from "a" where x < 9 with max_delay = 9 ms, reorder = true', True, True),
        ('select x from "a" where x < 9 with max_delay = 9 ms', True, False),
        ('merge("a", "b") with max_delay = 9 ms, reorder = true', True, True),
        ('merge("a" with max_delay = 9 ms, "b")', True, False),
        ('merge("a" with max_delay = 9 ms, reorder = true, "b")', True, True),
        ('select x from ("a" with reorder = false) with max_delay = 9 ms', False, False),
    ],
)
def test_reordering_is_asked_for(flow: Flow, text: str, *, is_ordered: bool, is_held: bool) -> None:
    flow.ordered_topics.update('a' if is_ordered else '')
    flow.create(text)
    flow.push('a', 5, 6, x=1)
    assert flow.times() == ([] if is_held else [5])
    flow.push('a', 4, 7, x=2)
    flow.advance(END)
    assert flow.times() == ([4, 5] if is_held else [])
    assert flow.broken() == ([] if is_held else [('valid_time_order', 4)])


def test_reordering_needs_a_bound(flow: Flow) -> None:
    with pytest.raises(DyKnowError, match='reorder needs a max_delay beside it'):
        flow.create('"a" with reorder = true')


def test_the_robots_of_one_publisher_are_ordered_by_themselves(flow: Flow) -> None:
    """A relay may pass on one robot's samples later than another's."""
    flow.ordered_topics.add('fleet')
    flow.create('select x from "fleet" where id = 1 with max_delay = 10 ms')
    flow.push('fleet', 5, 6, id=1, x=1)
    flow.push('fleet', 9, 9, id=2, x=2)
    flow.push('fleet', 7, 10, id=1, x=3)
    assert (flow.times(), flow.violations) == ([5, 7], [])


@pytest.mark.parametrize('text', ['"a" with max_delay = 10 ms', '"a"', 'sync("a")'])
def test_samples_of_another_engine_come_in_the_order_of_its_stream(flow: Flow, text: str) -> None:
    """A merge is published as its samples come; the watermarks tell what is complete."""
    flow.ordered_topics.add('a')
    flow.create(text)
    flow.push('a', 5, 6, watermark=2, x=1)
    flow.push('a', 3, 7, watermark=3, x=2)
    assert (flow.times(), flow.violations) == ([3], [])
    flow.push('a', 9, 9, watermark=9, x=3)
    assert (flow.times(), flow.violations) == ([5, 9], [])


@dataclass
class NaiveOrder:
    """The reference: what is emitted, step by step, while the number of publishers changes."""

    newest: int = -1000
    held: list[tuple[int, int]] = field(default_factory=list)
    emitted: list[tuple[int, int, int]] = field(default_factory=list)
    dropped: int = 0

    def take(self, valid_time: int, number: int, now: int, *, one_publisher: bool) -> None:
        if one_publisher and valid_time < self.newest:
            self.dropped += 1
            return
        if one_publisher:
            self.newest = valid_time
        is_overtaken = any(valid_time < time for _, time, _ in self.emitted)
        if now - valid_time > MAX_DELAY or is_overtaken:
            self.dropped += 1
        else:
            self.held.append((valid_time, number))
        # What is as late as a promise before needs not wait: no earlier one was to follow.
        self.release(self.newest, now)

    def release(self, until: int, now: int) -> None:
        due = sorted((each for each in self.held if each[0] <= until), key=lambda each: each[0])
        self.held = [each for each in self.held if each not in due]
        self.emitted += [(now, *each) for each in due]


@given(
    arrivals=st.lists(
        st.tuples(st.integers(0, 60), st.integers(0, 12), st.integers(0, 2)),
        min_size=3,
        max_size=30,
    ),
    second=st.integers(0, 60),
    third=st.integers(0, 60),
)
def test_order_against_its_definition(
    flow_class: type[Flow], arrivals: list[tuple[int, int, int]], second: int, third: int
) -> None:
    """Each of three publishers stamps in order; the graph tells when there are several."""
    flow, expected = flow_class(), NaiveOrder()
    flow.ordered_topics.add('a')
    flow.create('"a" with max_delay = 8 ms')
    found: list[tuple[int, int, int]] = []
    stamps = [-1000, -1000, -1000]
    arrivals.sort(key=lambda each: each[0])
    for now in range(END):
        is_one = not min(second, third) <= now < max(second, third)
        flow.dataflow.set_source_type('a', SourceType(None, False, is_one))
        for number, (time, delay, publisher) in enumerate(arrivals):
            if time == now:
                stamp = stamps[publisher] = max(stamps[publisher], now - delay)
                expected.release(now - MAX_DELAY, now)
                expected.take(stamp, number, now, one_publisher=is_one)
                flow.push('a', stamp, now, x=number)
        flow.advance(now)
        expected.release(now - MAX_DELAY, now)
        found += [(now, int(time), int(fields['x'])) for time, fields in flow.take()]
    assert found == expected.emitted
    assert sum(flow.drops.values()) == expected.dropped == len(flow.violations)
    assert len(found) + expected.dropped == len(arrivals)


def test_streams_from_before_the_order_was_known_share_their_operators(flow: Flow) -> None:
    """A later stream hears of the silence after a sample that an earlier one received."""
    text = 'select x from "a" with max_delay = 20 ms, sample_period = 10 ms'
    flow.create(text)
    flow.push('a', 5, 6, x=1)
    flow.ordered_topics.add('a')
    flow.dataflow.set_source_type('a', SourceType(None, False, True))
    late: list[Violation] = []
    flow.dataflow.create('t', parse_specification(text), NO_CONSTRAINTS, id, late.append)
    flow.advance(100)
    assert [each.stream_name for each in (*flow.violations, *late)] == ['s', 't']
