"""Why a stream has no samples."""

from __future__ import annotations

import pytest
from recorded_flow import MILLISECOND, Flow

from dyknow_stream_processing import is_normal_wait
from dyknow_stream_processing.dataflow.operators import NormalWait

LONG_AGO = -1


def reasons(flow: Flow, since: float = LONG_AGO, latched: str = '') -> list[str]:
    """The reasons of stream `s`, where each topic has the reason that is its name.

    One topic may be silent.
    """
    found = flow.dataflow.waits_for(
        's', round(since * MILLISECOND), lambda topic: '' if topic == latched else f'no {topic}'
    )
    return list(found)


@pytest.mark.parametrize(
    ('text', 'expected'),
    [
        ('select x from "a"', ['no a']),
        ('merge("a", "b")', ['no a', 'no b']),
        ('sync("a", (select x as y from "b" where z > 1), "a")', ['no a', 'no b']),
        ('stream half = select x from "a"; sink (select x from half where x > 1)', ['no a']),
        ('select x from "a" with max_delay = 1 s, sample_period = 1 s', ['no a']),
        (
            'compunit magnitude: float magnitude((x: float)); sink magnitude("a")',
            ['no a'],
        ),
    ],
)
def test_without_samples_the_topics_are_the_reason(
    flow: Flow, text: str, expected: list[str]
) -> None:
    assert reasons(flow.create(text)) == expected


def test_a_sync_names_the_one_input_that_never_delivered(flow: Flow) -> None:
    inputs = ', '.join(f'(select x as {name} from "{name}")' for name in 'abcde')
    flow.create(f'sync({inputs}) with sample_period = 10 ms')
    for time in range(0, 100, 10):
        for topic in 'abde':
            flow.push(topic, time, x=1)
    assert reasons(flow) == ['no c']


def test_a_where_that_lets_nothing_through_is_named(flow: Flow) -> None:
    flow.create('select x from "fleet" where id = "uav7" and x > 0')
    for name in ('uav1', 'uav2'):
        flow.push('fleet', 1, id=name, x=1)
    assert reasons(flow) == [
        'no sample of fleet satisfies id = "uav7" and x > 0 (the last has id = "uav2")'
    ]


def test_a_huge_value_is_cut(flow: Flow) -> None:
    flow.create('select x from "fleet" where id = "uav7"').push('fleet', 1, id='u' * 10**6, x=1)
    assert len(reasons(flow)[0]) < 200


def test_the_where_of_an_input_is_named(flow: Flow) -> None:
    flow.create('stream seven = select x from "fleet" where id = 7; sink sync(seven, "b")')
    flow.push('fleet', 1, id=1, x=1)
    flow.push('b', 1, y=1)
    assert reasons(flow) == ['no sample of fleet satisfies id = 7 (the last has id = 1)']


def test_the_first_window_of_a_rate_is_a_normal_wait(flow: Flow) -> None:
    flow.create('sync(rate("a", 5 s), "b")')
    assert reasons(flow) == ['no a', 'no b']
    for time in (1, 3000, 4000, 5900):
        flow.push('a', time)
        flow.push('b', time, x=1)
    (reason,) = flow.dataflow.waits_for('s', LONG_AGO, str)
    assert reason == 'the rate of a has its first value 5 s after the first message'
    assert isinstance(reason, NormalWait)
    assert is_normal_wait(reason)
    assert is_normal_wait(f'{reason}; {reason}')
    assert not is_normal_wait(f'{reason}; no b')
    flow.push('a', 6100)
    assert flow.times() == [5001]


def test_dropped_samples_are_the_reason(flow: Flow) -> None:
    flow.create('select y from "a"').push('a', 1, x=1)
    assert reasons(flow) == ['samples of a come, but all are dropped (fields)']


def test_samples_that_wait_for_the_clock_are_the_reason(flow: Flow) -> None:
    flow.create('"a" with max_delay = 10 s').push('a', 1, 2, x=1)
    assert reasons(flow) == ['samples of a wait until its max_delay has passed']
    flow.push('a', 3000, 3, x=1)
    assert reasons(flow) == ['samples of a wait until its max_delay has passed']


def test_samples_of_the_future_are_the_reason(flow: Flow) -> None:
    flow.create('"a" with max_delay = 1 s, max_lead = 5 s').push('a', 5000, 2, x=1)
    assert reasons(flow) == ['samples of a are stamped later than the time of the clock, and wait']


def test_a_state_that_waits_for_a_max_delay_says_for_whose(flow: Flow) -> None:
    flow.create('stream late = "b" with max_delay = 10 s; sink sync("a", late)')
    for time in (0, 10_001):
        flow.push('a', time, x=1)
        flow.push('b', time, y=1)
    flow.push('a', 10_005, 10_005, x=1)
    assert flow.times() == [0]
    assert reasons(flow, since=10_002) == ['no b']
    flow.push('b', 10_002, 10_006, y=1)
    assert reasons(flow) == ['samples of b wait until its max_delay has passed']


def test_an_input_that_lags_behind_the_others_is_named(flow: Flow) -> None:
    flow.create('sync(("a" with max_lead = 1 h), "b")')
    flow.push('a', 0, 900, x=1)
    flow.push('b', 0, 900, y=1)
    flow.take()
    for now in range(901, 910):
        flow.push('a', 900_000 + now, now, x=1)
        flow.push('b', 0, now, y=1)
    (reason,) = reasons(flow)
    assert reason.startswith('the sample at ')
    assert reason.endswith(' waits for later ones of b')


def test_a_topic_that_may_be_silent_delays_the_others(flow: Flow) -> None:
    flow.create('stream kept = select x from "/map"; sink sync(kept, (select x as y from "b"))')
    flow.push('/map', 0, x=1)
    assert reasons(flow, since=0.5, latched='/map') == ['no b']
    for time in range(1, 10):
        flow.push('b', time, x=1)
    (reason,) = reasons(flow, since=5, latched='/map')
    assert reason.endswith(' waits for later ones of /map')
    assert not reasons(flow, since=20, latched='b')[1:]


def test_a_silent_topic_without_a_first_message_is_named(flow: Flow) -> None:
    flow.sent_topics = {'map', 'b'}
    flow.create('sync((select x as m from "map"), "b")')
    flow.push('b', 1, x=1)
    assert reasons(flow, latched='map') == ['no sample of map has come yet']


def test_a_stream_that_fell_silent_names_the_topic_that_did(flow: Flow) -> None:
    flow.create('sync("a", (select x as y from "b"))')
    for time in range(10):
        flow.push('a', time, z=1)
        flow.push('b', time, x=1)
    for time in range(10, 20):
        flow.push('a', time, z=1)
    assert reasons(flow, since=15) == ['no b']


def test_a_unit_that_returns_nothing_is_named() -> None:
    def nothing(sample: object) -> None:
        del sample

    flow = Flow({'nothing': nothing})
    flow.create('compunit x: float nothing((x: float)); sink nothing("a")')
    flow.push('a', 1, x=1.0)
    assert reasons(flow) == ['samples of a come, but s gives none for them']


def test_several_publishers_of_the_topics_at_fault_are_remarked() -> None:
    flow = Flow(remark=lambda topics: f'; remarked: {", ".join(topics)}')
    flow.create('sync((select x from "a"), (select x as y from "b"))')
    flow.push('a', 5, x=1)
    flow.push('a', 4, x=1)
    assert [each.message[-13:] for each in flow.violations] == ['; remarked: a']
