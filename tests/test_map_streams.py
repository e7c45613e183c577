"""The streams of maps on real topics: positions, and regions that move."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count

import pytest
from geometry_msgs.msg import Point32, PointStamped, Polygon, PolygonStamped
from rclpy.qos import QoSProfile

from dyknow_common.ros import NodeAdapter
from dyknow_dashboard.model.live_map import MapSample
from dyknow_dashboard.ros.drawn_streams import MapStreams
from services import time_of
from system import Client, private_environment

POSITION = (
    'stream position = select point.x as x, point.y as y from "/{}" where header.frame_id = "map"'
)
OUTLINE = 'stream outline = select wkt(polygon.points) as outline from "/cell"'
CORNERS = ((0.0, 0.0), (2.0, 0.0), (0.0, 2.0))


@pytest.fixture
def client() -> Iterator[Client]:
    found = Client(private_environment())
    yield found
    found.close()


def test_streams_begin_and_end_with_what_maps_show(client: Client) -> None:
    """Stamps of a simulation, far from the clock, are drawn, too."""
    found: list[MapSample] = []
    maps = MapStreams(NodeAdapter(client.node), found.extend)
    points = client.node.create_publisher(PointStamped, '/r1', QoSProfile(depth=10))
    cells = client.node.create_publisher(PolygonStamped, '/cell', QoSProfile(depth=10))
    numbers = count(1)

    def publish() -> None:
        number = next(numbers)
        point, cell = PointStamped(), PolygonStamped()
        point.header.frame_id, point.header.stamp = 'map', time_of(number * 10**8)
        point.point.x = float(number)
        cell.header.stamp = point.header.stamp
        cell.polygon = Polygon(points=[Point32(x=x, y=y, z=0.0) for x, y in CORNERS])
        points.publish(point)
        cells.publish(cell)

    def latest(name: str) -> bool:
        publish()
        return any(each[0] == name for each in found)

    streams = {
        'r1': POSITION.format('r1'),
        'r2': POSITION.format('r2'),
        'r3': 'stream position = select x, y from nothing',
        'cell': OUTLINE,
    }
    maps.read(streams)
    for name in ('r1', 'cell'):
        client.spin_until(lambda name=name: latest(name), name, pause=0.05)
    samples = {name: (time, fields) for name, time, fields in found}
    assert samples.keys() == {'r1', 'cell'}
    time, fields = samples['r1']
    assert fields == {'x': time / 10**8, 'y': 0.0}
    assert str(samples['cell'][1]['outline']).startswith('POLYGON ((0')
    maps.read({'cell': OUTLINE})
    client.spin_until(lambda: client.node.count_subscribers('/r1') == 0, 'the end')
    found.clear()
    client.spin_until(lambda: latest('cell'), 'the other', pause=0.05)
    assert {name for name, *_ in found} == {'cell'}
