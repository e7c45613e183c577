"""Documents with regions: GeoJSON, zone sets of VDA 5050, and masks of Nav2 (PGM and YAML)."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml
from numpy.typing import NDArray

from dyknow_common import ExitCode, read_regular, read_text
from dyknow_space.errors import SpaceError
from dyknow_space.regions.library import shapely
from dyknow_space.regions.region import MAX_VERTICES, Region

MAX_PIXELS: Final = 64_000_000
"""The pixels of a mask."""

_HEADER: Final = re.compile(
    rb'(P5)\s(?:#[^\n]*\n|\s)*(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,5})\s'
)
_NAME: Final = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')


def read_geojson(path: Path, name: str, frame: str) -> list[Region]:
    """Return the polygons of a GeoJSON file, with coordinates in metres of a frame.

    A feature of a collection has the property `name`, and may have `sort`, a text or a list.

    Args:
        path: the file.
        name: the name of the region, if the file has one polygon without a name.
        frame: the frame of the coordinates.

    Raises:
        SpaceError: naming the file, the feature and the fault.
    """
    document = _json(path)
    features = document.get('features') if document.get('type') == 'FeatureCollection' else None
    if features is None:
        return [_feature_region(path, document, name, frame)]
    if not isinstance(features, list) or not all(isinstance(each, dict) for each in features):
        raise SpaceError(f'{path}: "features" must be a list of features')
    return [_feature_region(path, each, '', frame) for each in features]


def _feature_region(path: Path, feature: Mapping[str, Any], name: str, frame: str) -> Region:
    properties = feature.get('properties') or {}
    stated = properties.get('name', name) if isinstance(properties, dict) else name
    named = _object_name(path, stated)
    sorts = properties.get('sort', ()) if isinstance(properties, dict) else ()
    sorts = [sorts] if isinstance(sorts, str) else sorts
    if not isinstance(sorts, (list, tuple)) or not all(isinstance(each, str) for each in sorts):
        raise SpaceError(f'{path}: region \'{named}\': "sort" is a text or a list of texts')
    geometry = feature.get('geometry') if feature.get('type') == 'Feature' else feature
    library = shapely()
    with _place(path, named):
        try:
            found = library.from_geojson(json.dumps(geometry))
        except library.errors.ShapelyError as error:
            raise SpaceError(f'no geometry of GeoJSON: {error}') from None
        return Region(named, tuple(sorts), frame, found)


def read_zone_set(path: Path, name: str, frame: str) -> list[Region]:  # noqa: ARG001
    """Return the zones of a zone set of VDA 5050 (version 3.0); the sort is the type of the zone.

    Args:
        path: the file in JSON: a zone set, or a message that holds one.
        name: not used: zones have identifiers.
        frame: the frame of the map of the zones.

    Raises:
        SpaceError: naming the file, the zone and the fault.
    """
    document = _json(path)
    document = document.get('zoneSet', document)
    zones = document.get('zones') if isinstance(document, dict) else None
    if not isinstance(zones, list) or not all(isinstance(each, dict) for each in zones):
        raise SpaceError(f'{path}: a zone set has "zones", a list')
    found = []
    for zone in zones:
        named = _object_name(path, zone.get('zoneId'))
        with _place(path, named):
            vertices = zone.get('vertices')
            try:
                points = [(float(each['x']), float(each['y'])) for each in vertices or ()]
                polygon = shapely().Polygon(points)
            except (TypeError, KeyError, ValueError) as error:
                raise SpaceError(f'"vertices" must be a list of x and y: {error}') from None
            found.append(Region(named, (str(zone.get('zoneType', 'Zone')),), frame, polygon))
    return found


def read_mask(path: Path, name: str, frame: str, *, is_free: bool = False) -> list[Region]:
    """Return the occupied cells of a mask of Nav2, or of an occupancy map, as one region.

    Args:
        path: the YAML file with `image` (a binary PGM), `resolution`, `origin`, `negate`,
            `occupied_thresh` and `free_thresh`, which are as map_server has them.
        name: the name of the region.
        frame: the frame of the map.
        is_free: True to return the free cells instead.

    Raises:
        SpaceError: naming the file and the fault.
    """
    with _place(path, name):
        try:
            stated = yaml.safe_load(read_text(path, 'mask', SpaceError))
            image = path.parent / stated['image']
            size = float(stated['resolution'])
            x, y, yaw = (float(each) for each in stated['origin'])
            is_negated = bool(int(stated.get('negate', 0)))
            occupied = float(stated.get('occupied_thresh', 0.65))
            free = float(stated.get('free_thresh', 0.196))
        except (yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError) as error:
            raise SpaceError(
                f'no description of a map, with image, resolution and origin: {error}'
            ) from None
        if not 0 < size < math.inf:
            raise SpaceError(f'the resolution is positive, not {size}')
        shades = _pixels(image)
        fraction = shades if is_negated else 1 - shades
        geometry = _cells(fraction < free if is_free else fraction > occupied)
        cosine, sine = math.cos(yaw), math.sin(yaw)
        turned = size * np.array([[cosine, sine], [-sine, cosine]])
        placed = shapely().transform(geometry, lambda points: points @ turned + (x, y))
        return [Region(name, (), frame, placed)]


read_free_space: Final = partial(read_mask, is_free=True)
"""Returns the free cells of an occupancy map, as one region."""


def _pixels(path: Path) -> NDArray[np.float64]:
    """Return the shades of a binary PGM, from 0 to 1, with the lowest row first."""
    try:
        content = read_regular(path, 2 * MAX_PIXELS + 1000)
    except OSError as error:
        raise SpaceError(f'cannot read {path}: {error.strerror}', ExitCode.NOT_FOUND) from None
    header = _HEADER.match(content)
    if header is None:
        raise SpaceError(f'{path} is no binary PGM (P5)')
    width, height, most = (int(each) for each in header.groups()[1:])
    kind = np.dtype(np.uint8) if most < 256 else np.dtype('>u2')  # noqa: PLR2004
    if not 0 < width * height <= MAX_PIXELS or not 0 < most < 65536:  # noqa: PLR2004
        raise SpaceError(f'{path} has {width} x {height} pixels; it may have {MAX_PIXELS}')
    if len(content) - header.end() < width * height * kind.itemsize:
        raise SpaceError(f'{path} ends before its {width} x {height} pixels')
    pixels = np.frombuffer(content, kind, width * height, header.end())
    found: NDArray[np.float64] = pixels.astype(np.float64).reshape(height, width)[::-1] / most
    return found


def _cells(is_inside: NDArray[np.bool_]) -> Any:
    """Return the union of cells of 1 by 1, given by rows."""
    library = shapely()
    padded = np.pad(is_inside, ((0, 0), (1, 1))).astype(np.int8)
    rows, begins = np.nonzero(np.diff(padded, axis=1) == 1)
    _, ends = np.nonzero(np.diff(padded, axis=1) == -1)
    if not len(rows):
        raise SpaceError('the map has no such cell, so the region is empty')
    if len(rows) > 10 * MAX_VERTICES:
        raise SpaceError(f'the cells are in {len(rows)} pieces; simplify the mask')
    # Cells that touch in corners only remain apart, as polygons are valid so.
    union = library.union_all(library.box(begins, rows, ends, rows + 1))
    return library.simplify(union, 0)  # Only vertices on straight edges are removed.


@contextmanager
def _place(path: Path, name: str) -> Iterator[None]:
    """Name the file and the region in the errors of a block."""
    try:
        yield
    except SpaceError as error:
        raise SpaceError(f"{path}: region '{name}': {error.message}", error.code) from None


def _json(path: Path) -> Mapping[str, Any]:
    text = read_text(path, 'regions', SpaceError)
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise SpaceError(f'{path} is no JSON: {error}') from None
    if not isinstance(found, dict):
        raise SpaceError(f'{path}: the document must be an object of JSON')
    return found


def _object_name(path: Path, name: object) -> str:
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise SpaceError(
            f'{path}: a region is named {name!r}; use letters, digits and _, and begin with no '
            'digit'
        )
    return name
