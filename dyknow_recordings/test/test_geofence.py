"""A geofence in degrees over recorded fixes of a satellite receiver."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from running_checks import run_check
from small_bags import START, STORE, header, write_messages

from dyknow_configuration import ConfigurationError, read_robot

FIX = 'sensor_msgs/msg/NavSatFix'
FENCE = """\
{"type": "Feature", "properties": {"name": "field", "sort": "Allowed"}, "geometry":
 {"type": "Polygon", "coordinates":
  [[[15.57, 58.39], [15.58, 58.39], [15.58, 58.4], [15.57, 58.4], [15.57, 58.39]]]}}
"""
ROBOT = """\
objects: {UAV: [uav1]}
regions:
  fence: {frame: WGS84, geojson: fence.json}
  mast: {is: Mast, frame: wgs84, circle: {center: [15.575, 58.395], radius: 50}}
positions:
  - {of: {u: UAV}, frame: wgs84, topic: '/{u}/fix'}
formulas:
  - {name: in, formula: 'forall u in UAV, z in Allowed: always inside(u, z)', margin: true}
  - {name: clear, formula: 'forall u in UAV, m in Mast: always distance(u, m) > 20 m'}
"""


def write_flight(path: Path, longitudes: list[float]) -> None:
    types: Any = STORE.types
    status, found = types['sensor_msgs/msg/NavSatStatus'](0, 1), []
    for number, longitude in enumerate(longitudes):
        time = START + number * 10**9
        place = (58.399, longitude, 100.0)
        fix = types[FIX](header(time, 'gps'), status, *place, np.zeros(9), 0)
        found.append((time, '/uav1/fix', fix))
    write_messages(path, found)


def test_a_flight_that_leaves_its_fence(tmp_path: Path) -> None:
    (tmp_path / 'fence.json').write_text(FENCE)
    (tmp_path / 'robot.yaml').write_text(ROBOT)
    write_flight(tmp_path / 'flight', [15.575, 15.579, 15.5801])
    page = tmp_path / 'page.html'
    options = ('--config', tmp_path / 'robot.yaml', '--html', page)
    inside, clear = run_check(tmp_path / 'flight', *options, '--json').formulas
    assert (inside['outcome'], clear['outcome']) == ('false', 'undecided')
    # 0.0001 degrees are 5.84 m there.
    assert inside['episodes'][0]['margin']['upper'] == pytest.approx(-5.84, abs=0.01)
    assert 'aria-label="map in frame wgs84"' in page.read_text()


@pytest.mark.parametrize(
    ('old', 'new', 'message'),
    [
        ("topic: '/{u}/fix'", "tf: '{u}/base'", '6:39: tf has no wgs84; give the topic'),
        ("'/{u}/fix'", "'/{u}/fix', axes: [lon]", 'such as [lon, lat, alt]'),
        ('geojson:', 'mask:', '3:31: mask is in metres; state its frame, which is not wgs84'),
        ('[15.575, 58.395]', '[58.395, 95]', 'write longitudes of at most 180 before latitudes'),
    ],
)
def test_what_has_no_degrees_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    (tmp_path / 'fence.json').write_text(FENCE)
    (tmp_path / 'robot.yaml').write_text(ROBOT.replace(old, new, 1))
    with pytest.raises(ConfigurationError) as caught:
        read_robot(tmp_path / 'robot.yaml')
    assert message in str(caught.value)


def test_fields_of_other_messages(tmp_path: Path) -> None:
    (tmp_path / 'fence.json').write_text(FENCE)
    (tmp_path / 'robot.yaml').write_text(ROBOT.replace("fix'", "fix', axes: [lon, lat, alt]"))
    (stream,) = read_robot(tmp_path / 'robot.yaml').streams
    assert 'select lon as x, lat as y from "/uav1/fix"' in stream.text
