"""Silence of streams and topics, in words."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import pytest

from dyknow_common import SECOND_NS
from dyknow_stream_processing.reporting.silence import (
    ActivityMeter,
    joined_reasons,
    last_sign,
    nearest_topics,
    several_publishers,
    topic_reason,
    with_origins,
)
from dyknow_stream_processing.reporting.stream_report import (
    SourceReport,
    StreamReport,
    StreamState,
)

ODOM: Final = {'is_published': True, 'has_received': True, 'is_silent': False}


@pytest.mark.parametrize(
    ('changes', 'expected'),
    [
        ({}, ''),
        ({'is_published': False, 'has_received': False}, 'nobody publishes /odom'),
        ({'is_published': False}, 'nobody publishes /odom any more'),
        ({'has_received': False}, '/odom has a publisher but no message has come'),
        ({'is_silent': True}, '/odom has fallen silent'),
        ({'is_silent': True, 'is_latched': True}, ''),
        ({'fault': 'it is published with several types'}, 'it is published with several types'),
    ],
)
def test_the_reason_why_no_messages_come(changes: dict[str, Any], expected: str) -> None:
    assert topic_reason('/odom', **{**ODOM, **changes}) == expected


@pytest.mark.parametrize(
    ('topic', 'promised', 'expected'),
    [
        ('/r/dyknow/federation/c1/Charge', 9 * SECOND_NS, 9),
        ('/r/dyknow/federation/c1/Charge', 90 * SECOND_NS, 35),
        ('/r/dyknow/federation/c1/Charge', 0, 5),
        ('/r/dyknow/streams/charge', 9 * SECOND_NS, 5),
    ],
)
def test_a_peer_may_leave_out_samples(topic: str, promised: int, expected: int) -> None:
    assert last_sign(topic, 5 * SECOND_NS, promised) == expected * SECOND_NS


def test_a_mistyped_topic_gets_a_suggestion() -> None:
    reason = topic_reason('/odm', nearest=nearest_topics('/odm', ['/odom', '/scan', '/tf']))
    assert reason == 'nobody publishes /odm (did you mean /odom?)'


@pytest.mark.parametrize(
    ('topic', 'known', 'expected'),
    [
        ('/odm', ['/scan'], ()),
        ('/odm', ['/odm'], ()),
        ('/robot1/odom', ['/odom', '/scan'], ('/odom',)),
        ('/odom', ['/a/very/long/namespace/odom'], ('/a/very/long/namespace/odom',)),
        ('/uav1/power', ['/uav1/powr', '/uav2/power'], ('/uav1/powr', '/uav2/power')),
    ],
)
def test_similar_names(topic: str, known: list[str], expected: tuple[str, ...]) -> None:
    assert nearest_topics(topic, known) == expected


def test_huge_names_are_not_compared() -> None:
    huge = '/' + 'ab' * 100_000
    assert nearest_topics(huge, [huge + 'c']) == ()
    assert nearest_topics('/abab', [huge] * 10_000) == ()


def test_a_stream_is_silent_after_three_seconds_or_three_periods() -> None:
    meter = ActivityMeter()
    assert meter.is_silent(0)
    assert not meter.is_silent(1)
    for samples in (50, 100, 100, 100):
        meter.measure(samples)
    assert not meter.is_silent(100)
    meter.measure(100)
    assert meter.is_silent(100)
    assert not meter.is_silent(101)
    slow = ActivityMeter()
    for second in range(1, 120):
        slow.measure(second // 10)
    assert not slow.is_silent(11)
    for _ in range(31):
        slow.measure(11)
    assert slow.is_silent(11)


def test_a_waiting_stream_names_the_root_cause() -> None:
    level = StreamReport(
        'level', StreamState.WAITING, 'nobody publishes /levle', topic='/dyknow/streams/level'
    )
    sources = (SourceReport('/dyknow/streams/level'),)
    half = StreamReport('half', StreamState.WAITING, 'none of it', topic='/half', sources=sources)
    quarter = replace(half, name='quarter', topic='/q', sources=(SourceReport('/half'),))
    messages = {each.name: each.message for each in with_origins([quarter, half, level])}
    assert messages['half'] == 'none of it; stream level waits: nobody publishes /levle'
    assert messages['quarter'] == f'none of it; stream half waits: {messages["half"]}'
    flowing = replace(half, state=StreamState.FLOWING, message='')
    assert list(with_origins([flowing, level])) == [flowing, level]


def test_streams_that_are_made_of_each_other_wait_for_each_other() -> None:
    one, other = (
        StreamReport(name, StreamState.WAITING, f'no {of}', topic=name, sources=(SourceReport(of),))
        for name, of in (('a', 'b'), ('b', 'a'))
    )
    assert [each.message for each in with_origins([one, other])] == [
        'no b; stream b waits: no a',
        'no a; stream a waits: no b',
    ]


def test_only_some_of_many_reasons_are_told() -> None:
    assert joined_reasons(['a', 'b']) == 'a; b'
    assert joined_reasons([str(n) for n in range(7)]) == '0; 1; 2; 3; 4; and 2 more'


def test_publishers_are_named() -> None:
    assert several_publishers(['/sim', '/driver']) == '2 publishers: /driver, /sim'
    assert several_publishers(['/sim'] * 2) == '2 publishers, all of /sim (one may be gone)'
