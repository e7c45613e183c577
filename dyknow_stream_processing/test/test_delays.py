"""Delays of topics for which a stream gives no `max_delay`; times are in milliseconds."""

from __future__ import annotations

import pytest
from recorded_flow import Flow

BOTH = 'sync(select c from "command", select s from "speed")'


@pytest.fixture
def flow() -> Flow:
    flow = Flow()
    flow.sent_topics = {'command'}
    return flow


def test_a_command_is_valid_from_the_time_at_which_it_was_sent(flow: Flow) -> None:
    """It was sent before the speed was stamped that it led to, and came later."""
    flow.create(BOTH)
    flow.push('command', 0, 1, c=0)
    flow.push('speed', 5, 6, s=0)
    flow.push('speed', 21, 22, s=3)
    flow.push('command', 20, 30, c=1)
    assert flow.take() == [(5, {'c': 0, 's': 0}), (20, {'c': 1, 's': 0})]
    flow.advance(130)
    assert flow.take() == [(21, {'c': 1, 's': 3})]
    assert flow.broken() == []


def test_messages_of_several_publishers_may_overtake_each_other(flow: Flow) -> None:
    flow.create('select c from "command"')
    for sent_at, now in ((10, 15), (8, 16), (17, 18)):
        flow.push('command', sent_at, now, c=sent_at)
    assert flow.take() == [(10, {'c': 10}), (10, {'c': 8}), (17, {'c': 17})]
    assert flow.broken() == []


@pytest.mark.parametrize(
    ('topic', 'limit', 'how', 'allowed'),
    [('command', 100, 'it was sent', '100 ms'), ('speed', 1000, 'its stamp', '1 s')],
)
def test_a_sample_that_is_later_than_the_default(
    flow: Flow, topic: str, limit: int, how: str, allowed: str
) -> None:
    flow.create(f'select x from "{topic}"')
    flow.push(topic, 0, limit, x=1)
    flow.push(topic, 100, 2100, x=2)
    assert flow.times() == [0]
    (violation,) = flow.violations
    assert violation.message.endswith(
        f'came 2 s after {how}; without a max_delay at most {allowed} is taken for true: state a '
        'larger max_delay if its way takes so long, set the clock of its sender, or replay a '
        'recording with its clock'
    )
    assert flow.drops == {'max_delay': 1}


def test_the_clock_of_a_replayed_recording_says_nothing_about_delays(flow: Flow) -> None:
    flow.create('select s from "speed"')
    flow.push('speed', 0, 25 * 3_600_000, s=1)
    assert (flow.times(), flow.broken()) == ([0], [])


def test_a_stated_max_delay_counts_instead(flow: Flow) -> None:
    flow.ordered_topics = {'command'}
    flow.create('select c from "command" with max_delay = 5 s')
    flow.push('command', 0, 4000, c=1)
    assert flow.times() == [0]
    flow.push('command', 100, 5101, c=1)
    assert flow.broken() == [('max_delay', 100)]


@pytest.mark.parametrize('constraints', ['', ' with max_delay = 5 s'])
def test_what_was_sent_before_the_subscription_is_never_late(flow: Flow, constraints: str) -> None:
    flow.create(f'select s from "speed"{constraints}')
    flow.push('speed', 0, 3_600_000, s=1, is_initial=True)
    assert flow.take() == [(0, {'s': 1})]
    flow.push('speed', 1, 3_600_001, s=2)
    assert flow.broken() == [('max_delay', 1)]


@pytest.mark.parametrize('sent_topics', [set(), {'stop'}])
def test_an_older_message_of_another_publisher_is_no_news(
    flow: Flow, sent_topics: set[str]
) -> None:
    """Two publishers keep a message each, and the older one comes last."""
    flow.sent_topics = sent_topics
    flow.create('sync("stop")')
    flow.push('stop', 5, 3_600_000, x=1, is_initial=True)
    flow.push('stop', 3, 3_600_000, x=2, is_initial=True)
    flow.push('stop', 3_600_001, x=3)
    assert flow.take() == [(5, {'x': 1}), (3_600_001, {'x': 3})]
    assert (flow.broken(), flow.drops) == ([], {'superseded': 1})


def test_what_another_topic_sends_later_may_be_late(flow: Flow) -> None:
    flow.create('merge("speed", "height") with max_delay = 5 s')
    flow.push('speed', 0, 3_600_000, x=1, is_initial=True)
    flow.push('height', 1, 3_600_001, x=2)
    assert flow.broken() == [('max_delay', 1)]
