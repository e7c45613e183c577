"""Streams that are published as messages of a type that their sink names."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from dyknow_interfaces import srv
from dyknow_interfaces.msg import ExitStatus, StreamSpec
from geometry_msgs.msg import PointStamped
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import Float64, Int8

from stream_nodes import TANK, StreamNodes

ENGINES = ('/one', '/two')
MANAGER = '/stream_manager'

BAD_SINKS = [
    ('std_msgs/msg/Nothing', "1:23: message type 'std_msgs/msg/Nothing' is not installed"),
    ('std_msgs/msg/Float64 (value = data)', "1:23: std_msgs/msg/Float64 has no field 'value'"),
    ('std_msgs/msg/String', "1:23: field 'data' of std_msgs/msg/String is of the type string"),
    (f'std_msgs/msg/Float64 on "{TANK}"', f"1:23: the stream is made of '{TANK}'"),
    (
        'std_msgs/msg/Float64 on "/dyknow/streams/other"',
        "1:23: topic '/dyknow/streams/other' is published with the type dyknow_interfaces/msg/S",
    ),
    ('std_msgs/msg/Float64 on "a b"', "1:23: the topic of the sink 'a b' cannot be the name"),
]


@pytest.fixture
def nodes(tmp_path: Path) -> Iterator[StreamNodes]:
    with StreamNodes(tmp_path) as running:
        running.start_manager()
        for name in ENGINES:
            running.start(name)
        running.wait_for_engines(*ENGINES)
        yield running


def test_messages_of_a_sink(nodes: StreamNodes) -> None:
    levels = nodes.client.collect(Float64, '/dyknow/streams/level/message')
    points = nodes.client.collect(PointStamped, '/points', qos_profile_sensor_data)
    nodes.create('level', f'stream a = "{TANK}"; sink a as std_msgs/msg/Float64')
    nodes.create(
        'point',
        f'stream a = select data as east from "{TANK}"; sink a as geometry_msgs/msg/PointStamped '
        '(point.x = east, header.frame_id = "map") on "points"',
    )
    nodes.until(lambda: bool(levels and points), 'messages')
    assert levels[-1].data == points[-1].point.x == 0.5
    assert points[-1].header.frame_id == 'map'
    assert points[-1].header.stamp.sec > 0
    # Another engine continues with the same messages.
    nodes.wait_until_flowing('level')
    engine = nodes.engines_of()['level']
    nodes.kill(engine)
    nodes.wait_until_flowing('level', off=engine)
    levels.clear()
    nodes.until(lambda: bool(levels), 'messages of the other engine')
    nodes.call(MANAGER, srv.StreamDestroy, stream_name='level')
    nodes.until(
        lambda: not nodes.client.node.count_publishers('/dyknow/streams/level/message'),
        'the end of the topic',
    )


def test_a_sink_that_cannot_be_published(nodes: StreamNodes) -> None:
    for node in (MANAGER, ENGINES[0]):
        nodes.create('other', f'"{TANK}"', node)
        nodes.until(lambda: bool(nodes.engines_of()), 'the type of the tank is known')
        for sink, message in BAD_SINKS:
            spec = StreamSpec(name='level', specification=f'sink "{TANK}" as {sink}')
            status = nodes.call(node, srv.StreamCreateFromSpec, spec=spec).exit_status
            assert status.code in {ExitStatus.INVALID_ARGUMENT, ExitStatus.NOT_FOUND}
            assert message in status.message
            assert 'level' not in nodes.call(node, srv.ListStreams).stream_names
        nodes.call(node, srv.StreamDestroy, stream_name='other')


def test_samples_that_do_not_fit_are_counted(nodes: StreamNodes) -> None:
    nodes.client.collect(Int8, '/small')
    nodes.create('level', 'sink "/late" as std_msgs/msg/Int8 on "/small"')
    publisher = nodes.client.node.create_publisher(Float64, '/late', 10)
    nodes.client.node.create_timer(0.05, lambda: publisher.publish(Float64(data=1.5)))
    nodes.until(
        lambda: any(
            drop.reason == 'unpublished' for each in nodes.report.streams for drop in each.drops
        ),
        'counted samples',
    )
