"""Documents with regions: GeoJSON, zone sets of VDA 5050, masks of Nav2."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dyknow_space import (
    Region,
    RegionDistances,
    SpaceError,
    buffer_of,
    circle,
    geometry_of,
    read_free_space,
    read_geojson,
    read_mask,
    read_zone_set,
)

SQUARE = [[0, 0], [2, 0], [2, 2], [0, 2], [0, 0]]


def distances(region: Region, *points: tuple[float, float]) -> list[float]:
    unit = RegionDistances(r=region.text)
    return [unit({'x': x, 'y': y}, 0)['r'] for x, y in points]


def test_geojson(tmp_path: Path) -> None:
    path = tmp_path / 'a.geojson'
    polygon = {'type': 'Polygon', 'coordinates': [SQUARE]}
    features = [
        {'type': 'Feature', 'properties': {'name': 'a', 'sort': 'NoFly'}, 'geometry': polygon},
        {'type': 'Feature', 'properties': {'name': 'b', 'sort': ['A', 'B']}, 'geometry': polygon},
    ]
    path.write_text(json.dumps({'type': 'FeatureCollection', 'features': features}))
    one, other = read_geojson(path, 'x', 'map')
    assert (one.name, one.sorts, one.frame) == ('a', ('NoFly',), 'map')
    assert (other.name, other.sorts) == ('b', ('A', 'B'))
    assert distances(one, (1, 1), (3, 1)) == [-1, 1]
    path.write_text(json.dumps(polygon))
    assert [each.name for each in read_geojson(path, 'x', 'map')] == ['x']


@pytest.mark.parametrize(
    ('document', 'message'),
    [
        ('[', 'is no JSON'),
        ([], 'must be an object'),
        ({'type': 'FeatureCollection', 'features': [1]}, 'a list of features'),
        ({'type': 'Feature', 'properties': {'name': 'a b'}, 'geometry': None}, "named 'a b'"),
        ({'type': 'Feature', 'properties': {'name': 'a'}, 'geometry': None}, 'no geometry'),
        ({'type': 'Feature', 'properties': {'name': 'a', 'sort': 5}}, '"sort" is a text or'),
        ({'type': 'Feature', 'properties': {'name': 'a', 'sort': [5]}}, '"sort" is a text or'),
        ({'type': 'Polygon', 'coordinates': [[[0, 0], ['a', 1]]]}, 'no geometry of GeoJSON'),
        ({'type': 'Point', 'coordinates': [0, 0]}, 'not a Point'),
    ],
)
def test_bad_geojson(document: Any, message: str, tmp_path: Path) -> None:
    path = tmp_path / 'a.geojson'
    path.write_text(document if isinstance(document, str) else json.dumps(document))
    with pytest.raises(SpaceError, match=message) as error:
        read_geojson(path, 'x', 'map')
    assert str(path) in error.value.message


def test_zone_sets(tmp_path: Path) -> None:
    path = tmp_path / 'zones.json'
    vertices = [{'x': x, 'y': y} for x, y in SQUARE[:-1]]
    zones = [{'zoneId': 'z1', 'zoneType': 'BLOCKED', 'vertices': vertices}]
    for document in ({'zones': zones}, {'zoneSet': {'mapId': 'hall', 'zones': zones}}):
        path.write_text(json.dumps(document))
        (zone,) = read_zone_set(path, 'x', 'map')
        assert (zone.name, zone.sorts) == ('z1', ('BLOCKED',))
        assert distances(zone, (1, 1.5), (1, -3)) == [-0.5, 3]
    path.write_text(json.dumps({'zones': [{'zoneId': 'z1', 'vertices': vertices[:2]}]}))
    with pytest.raises(SpaceError, match="region 'z1'"):
        read_zone_set(path, 'x', 'map')


def mask(folder: Path, pixels: Any, **changes: object) -> Path:
    image = np.array(pixels, np.uint8)
    height, width = image.shape
    (folder / 'm.pgm').write_bytes(
        b'P5\n# a comment\n%d %d\n255\n' % (width, height) + image.tobytes()
    )
    stated = {'image': 'm.pgm', 'resolution': 0.5, 'origin': [10, 20, 0], **changes}
    path = folder / 'm.yaml'
    path.write_text(json.dumps(stated))
    return path


def test_masks(tmp_path: Path) -> None:
    # The first row of the image is the highest one in the map.
    path = mask(tmp_path, [[0, 254, 254], [254, 254, 0], [254, 0, 0]])
    (occupied,) = read_mask(path, 'm', 'map')
    inside = [(10.2, 21.2), (11.2, 20.7), (10.7, 20.2), (11.2, 20.2)]
    outside = [(10.2, 20.2), (10.7, 20.7), (10.7, 21.2)]
    assert all(each < 0 for each in distances(occupied, *inside))
    assert all(each > 0 for each in distances(occupied, *outside))
    (free,) = read_free_space(path, 'm', 'map')
    assert all(each > 0 for each in distances(free, *inside))
    assert all(each < 0 for each in distances(free, *outside))
    (negated,) = read_mask(mask(tmp_path, [[0, 255]], negate=1), 'm', 'map')
    assert distances(negated, (10.75, 20.25)) == [-0.25]
    turned = mask(tmp_path, [[0]], origin=[0, 0, np.pi / 2])
    assert distances(read_mask(turned, 'm', 'map')[0], (-0.25, 0.25)) == pytest.approx([-0.25])


def test_bad_masks(tmp_path: Path) -> None:
    path = mask(tmp_path, [[254]])
    with pytest.raises(SpaceError, match='the map has no such cell'):
        read_mask(path, 'm', 'map')
    with pytest.raises(SpaceError, match='the resolution is positive'):
        read_mask(mask(tmp_path, [[0]], resolution=0), 'm', 'map')
    path = mask(tmp_path, [[0]])
    (tmp_path / 'm.pgm').write_bytes(b'P5\n9 9\n255\n')
    with pytest.raises(SpaceError, match='ends before its 9 x 9 pixels'):
        read_mask(path, 'm', 'map')
    (tmp_path / 'm.pgm').write_bytes(b'P5\n999999 999999\n255\n')
    with pytest.raises(SpaceError, match='has 999999 x 999999 pixels'):
        read_mask(path, 'm', 'map')
    (tmp_path / 'm.pgm').write_bytes(b'PNG')
    with pytest.raises(SpaceError, match='no binary PGM'):
        read_mask(path, 'm', 'map')
    path.write_text('image: nothing.pgm')
    with pytest.raises(SpaceError, match=re.escape('no description of a map')):
        read_mask(path, 'm', 'map')


def test_circles_and_buffers() -> None:
    region = Region('c', (), 'map', circle(1, 2, 3))
    assert distances(region, (1, 2), (7, 2)) == pytest.approx([-3, 3], abs=3e-4)
    square = geometry_of('POLYGON ((0 0, 2 0, 2 2, 0 2, 0 0))')
    wide = Region('w', (), 'map', buffer_of(square, 1))
    assert distances(wide, (1, 1), (4, 1)) == [-2, 1]
    with pytest.raises(SpaceError, match='the region is empty'):
        buffer_of(square, -1.5)
