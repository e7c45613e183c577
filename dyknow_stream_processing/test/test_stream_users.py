"""The topics that formulas use, and streams by the formulas that use them."""

from __future__ import annotations

from dataclasses import replace

from test_stream_table import shown

from dyknow_stream_processing.reporting.stream_report import (
    SourceReport,
    StreamReport,
    StreamState,
)
from dyknow_stream_processing.reporting.stream_table import (
    as_json,
    stream_table,
    topic_as_json,
    topic_table,
)
from dyknow_stream_processing.reporting.stream_users import StreamUser, shown_name, used_topics

ODOMETRY = SourceReport('/odom', 120, 5, 3_000_000, rate=49.96, drops={'lost': 3, 'message': 1})
POWER = StreamReport(
    'power',
    StreamState.FLOWING,
    engine='/engine',
    topic='/dyknow/streams/power',
    sources=(SourceReport('/battery', 7, 4),),
)
STATES = StreamReport(
    '_states_f2_1',
    StreamState.WAITING,
    "nobody publishes '/lidar'",
    engine='/engine',
    topic='/dyknow/streams/_states_f2_1',
    sources=(ODOMETRY, SourceReport('/lidar'), SourceReport('/dyknow/streams/power', 7, 4)),
)
USERS = (
    StreamUser('slow', STATES.topic, ('/odom', '/lidar')),
    StreamUser('near', STATES.topic, ('/odom', '/battery')),
    StreamUser('begun', '', ()),
)


def test_the_topics_of_formulas() -> None:
    battery, lidar, odometry = used_topics([POWER, STATES], USERS)
    assert [each.source.topic for each in (battery, lidar, odometry)] == [
        '/battery',
        '/lidar',
        '/odom',
    ]
    assert (battery.streams, battery.formulas, battery.reason) == (('power',), ('near',), '')
    assert (lidar.formulas, lidar.reason) == (('slow',), "nobody publishes '/lidar'")
    assert odometry.formulas == ('slow', 'near')
    assert (odometry.lost, odometry.dropped, odometry.streams) == (3, 1, ())


def test_of_several_engines_the_first_one_counts() -> None:
    later = replace(POWER, name='b', sources=(SourceReport('/battery', 5, 4),))
    (battery,) = used_topics([later, POWER], ())
    assert battery.source.samples == 7
    assert battery.streams == ('b', 'power')


def test_states_have_the_names_of_their_formulas() -> None:
    assert shown_name(POWER, USERS) == 'power'
    assert shown_name(STATES, USERS) == 'states of slow, near'
    assert shown_name(STATES, ()) == '_states_f2_1'
    assert shown_name(replace(STATES, topic=''), USERS) == '_states_f2_1'


def test_topics_on_a_terminal() -> None:
    lines = shown(stream_table([STATES], ['/engine'], users=USERS))
    lines += shown(topic_table(used_topics([STATES, POWER], USERS)))
    assert "states of slow, near waiting nobody publishes '/lidar'" in lines
    assert 'topic received rate delay lost dropped formulas' in lines
    assert '/odom 120 50.0 Hz 3 ms 3 1 slow, near' in lines
    assert "/lidar 0 0.0 Hz 0 0 slow nobody publishes '/lidar'" in lines


def test_topics_for_programs() -> None:
    assert as_json(STATES, USERS)['formulas'] == ['slow', 'near']
    *_, odometry = map(topic_as_json, used_topics([STATES], USERS))
    assert (odometry['topic'], odometry['samples'], odometry['rate_hz']) == ('/odom', 120, 49.96)
    assert odometry['drops'] == {'lost': 3, 'message': 1}
    assert odometry['formulas'] == ('slow', 'near')
    assert odometry['delay_ns'] == 3_000_000
