"""The regions of a robot.yaml: objects that are parts of space.

    regions:
      dock: {is: Aisle, frame: map, wkt: 'POLYGON ((0 0, 4 0, 4 3, 0 0))', altitude: [0, 2.5]}
      tower: {is: NoFly, frame: map, circle: {center: [10, 4], radius: 3}}
      margin: {is: NoFly, frame: map, buffer: {of: dock, by: 1.5}}
      fences: {frame: wgs84, geojson: fences.geojson}
      keep_out: {is: KeepOut, frame: map, mask: keepout_mask.yaml}
      storm: {is: Storm, frame: map, topic: /storm_cell, max_gap: 30 s}

A file may hold several regions, which have their own names. A topic of PolygonStamped is a region
that moves. The relations of other drawn regions are computed; the relations of objects that are not
drawn may be told:

    relations: [kitchen NTPP flat, 'hall {EC, DC} flat']
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Any, Final

from dyknow_common import CONSTRAINT_KINDS, WKT, quoted, unknown
from dyknow_configuration.composed_text import constraint_parts
from dyknow_configuration.yaml_values import YamlValue
from dyknow_space import (
    ALL_HEIGHTS,
    MAX_RELATED,
    WGS84,
    ContradictionError,
    Region,
    SpaceError,
    SpatialKnowledge,
    SpatialStatement,
    buffer_of,
    circle,
    geometry_of,
    parse_statement,
    read_free_space,
    read_geojson,
    read_mask,
    read_zone_set,
)

_FILES: Final[Mapping[str, Callable[..., Iterable[Region]]]] = {
    'free': read_free_space,
    'geojson': read_geojson,
    'mask': read_mask,
    'vda5050': read_zone_set,
}
"""The readers of files, by the key that names the file."""

_METRIC: Final = frozenset({'free', 'mask', 'vda5050', 'topic'})
"""The sources that have no degrees; the points of a PolygonStamped would round them to metres."""

_SHAPES: Final = ('wkt', 'circle', 'buffer', *_FILES, 'topic')

_TIMES: Final = ('since', 'until')

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)

KNOWN_CONSTRAINTS: Final = tuple(name for name in CONSTRAINT_KINDS if name != 'expires')
"""The constraints of a position, an outline or a path, which cannot be unknown."""

_STAMPED: Final = {'max_delay': '1 s'}
"""Constraints of outlines with stamps that state no others: else, states wait for the next one."""

_MOVING_KEYS: Final = ('field', 'header', *KNOWN_CONSTRAINTS)

REGION_KEYS: Final = ('is', 'frame', *_SHAPES, 'altitude', *_TIMES, *_MOVING_KEYS)

POSITION_KEYS: Final = (
    'of', 'frame', 'topic', 'stream', 'tf', 'field', 'axes', 'header', 'moves',
    'orientation', 'yaw', 'walls', *KNOWN_CONSTRAINTS
)  # fmt: skip

DISTANCES: Final = {'region_distances': 'distance', 'swept_distances': 'swept_distance'}
"""The features that the units for regions compute; the second one of objects that move straight."""

POSES: Final = {'position_x': ('x', 'm'), 'position_y': ('y', 'm'), 'yaw': ('yaw', 'rad')}
"""The features of poses: the fields of `planar_pose`, and their units."""

SIGHT: Final = 'sight_distance'
"""The feature of the lines of sight, and the unit that computes it."""

POSITION_FEATURES: Final = frozenset({*DISTANCES.values(), *POSES, SIGHT})
"""The features that positions give."""

MAX_REGIONS: Final = 1_000
"""The number of regions of a robot.yaml."""


@dataclass(frozen=True, slots=True)
class MovingRegion:
    """A region whose outline is in the messages of a topic.

    Args:
        name: the name of the object that it is.
        sorts: the sorts of that object, as they are stated.
        frame: the frame of the outline, in metres.
        altitude: its lowest and highest height, in metres; infinite without a bound.
        source: the stream of its `outline`, and of its `frame` if that is checked, without its
            constraints.
        constraints: the constraints of that stream, as parts of a text with their values.
        is_checked: True if the frame of each message is compared.
        origin: where the file states it.
    """

    name: str
    sorts: tuple[str, ...]
    frame: str
    altitude: tuple[float, float]
    source: str
    constraints: tuple[tuple[str, YamlValue], ...]
    is_checked: bool
    origin: YamlValue

    @property
    def fields(self) -> str:
        """The fields of its stream, with their types."""
        return 'frame: string, outline: string' if self.is_checked else 'outline: string'

    @property
    def text(self) -> str:
        """The region but for its name, sorts and outline, for `moving_distance`."""
        bounded = self.altitude != ALL_HEIGHTS
        return f'frame {self.frame}' + '; altitude {} {}'.format(*self.altitude) * bounded


@dataclass(frozen=True, slots=True)
class StatedRegion:
    """A region with its place in the file.

    Args:
        region: its sorts are empty if only `objects` tells them.
        key: the name of its entry.
        sorts: the value of its key `is`, if there is one.
    """

    region: Region | MovingRegion
    key: YamlValue
    sorts: YamlValue | None


def read_regions(value: YamlValue) -> tuple[StatedRegion, ...]:
    """Return the regions that a mapping from names describes.

    Raises:
        ConfigurationError: with the place of the fault.
    """
    found: dict[str, StatedRegion] = {}
    for key, given in value.entries('a mapping from regions'):
        for region in _regions(key, given, found):
            if region.name in found:
                raise key.error(f"there is a second region '{region.name}'; keep one")
            found[region.name] = StatedRegion(region, key, given.mapping(REGION_KEYS).get('is'))
        if len(found) > MAX_REGIONS:
            raise key.error(f'the file has more than {MAX_REGIONS} regions; split it')
    return tuple(found.values())


def drawn_regions(regions: Iterable[StatedRegion]) -> list[Region]:
    """Return the regions that stand still."""
    return [each.region for each in regions if isinstance(each.region, Region)]


def read_relations(
    values: Mapping[str, YamlValue], regions: Sequence[StatedRegion], objects: Collection[str]
) -> dict[str, list[SpatialStatement]]:
    """Return what is known of the relations of regions, drawn or told, by the first of each two.

    Args:
        values: the values by key.
        regions: the drawn regions.
        objects: the names of all objects; regions that are not drawn are among them.

    Raises:
        ConfigurationError: with the place of the fault, or of a statement that contradicts others.
    """
    drawn = drawn_regions(regions)
    told: dict[SpatialStatement, YamlValue] = {}
    for each in values['relations'].one_or_more() if 'relations' in values else ():
        try:
            statement = parse_statement(each.text('a relation'))
        except SpaceError as error:
            raise each.error(error.message) from None
        for name in (statement.first, statement.second):
            if name not in objects:
                raise each.error(unknown('region', name, objects))
        told.setdefault(statement, each)
    if not told and len(drawn) > MAX_RELATED:
        return {}
    try:
        knowledge = SpatialKnowledge(told, drawn)
    except ContradictionError as error:
        place = next(told[each] for each in reversed(error.statements) if each in told)
        raise place.error(error.message) from None
    except SpaceError as error:
        raise values['relations'].error(error.message) from None
    found: dict[str, list[SpatialStatement]] = {}
    for statement in knowledge.statements:
        found.setdefault(statement.first, []).append(statement)
    return found


def _regions(
    key: YamlValue, value: YamlValue, known: Mapping[str, StatedRegion]
) -> Iterable[Region | MovingRegion]:
    stated = value.mapping(REGION_KEYS, ('frame',))
    shapes = [each for each in _SHAPES if each in stated]
    if len(shapes) != 1:
        raise value.error(f'give one of {", ".join(_SHAPES)}')
    (kind,) = shapes
    shape = stated[kind]
    name, frame = key.text('the name of a region').strip(), frame_of(stated['frame'])
    if kind in _METRIC and frame == WGS84:
        raise shape.error(f'{kind} is in metres; state its frame, which is not {WGS84}')
    for each in () if kind == 'topic' else _MOVING_KEYS:
        if each in stated:
            raise stated[each].error(f'only a region of a topic has {each}; remove it')
    sorts = tuple(each.text() for each in stated['is'].one_or_more()) if 'is' in stated else ()
    altitude = _altitude(stated['altitude']) if 'altitude' in stated else ALL_HEIGHTS
    if kind == 'topic':
        return [_moving(stated, name, sorts, frame, altitude)]
    since, until = (_time(stated[each]) if each in stated else None for each in _TIMES)
    try:
        if kind in _FILES:
            read = _FILES[kind](shape.file(), name, frame)
        else:
            read = [Region(name, (), frame, _geometry(kind, shape, known, frame))]
        return [
            replace(
                each,
                sorts=(*sorts, *(sort for sort in each.sorts if sort not in sorts)),
                altitude=altitude,
                times=(since, until),
            )
            for each in read
        ]
    except SpaceError as error:
        raise shape.error(error.message) from None


def _moving(
    stated: Mapping[str, YamlValue],
    name: str,
    sorts: tuple[str, ...],
    frame: str,
    altitude: tuple[float, float],
) -> MovingRegion:
    for each in _TIMES:
        if each in stated:
            raise stated[each].error(f'a region of a topic has no time in {each}; remove it')
    points = stated['field'].text('a field').strip() if 'field' in stated else 'polygon.points'
    is_checked = 'header' not in stated or stated['header'].truth()
    checked = 'header.frame_id as frame, ' if is_checked else ''
    topic = quoted(stated['topic'].text('a topic').strip())
    return MovingRegion(
        name,
        sorts,
        frame,
        altitude,
        f'select {checked}{WKT}({points}) as outline from {topic}',
        constraint_parts(stated, stated['topic'], **(_STAMPED if is_checked else {})),
        is_checked,
        stated['topic'],
    )


def _geometry(kind: str, shape: YamlValue, known: Mapping[str, StatedRegion], frame: str) -> Any:
    if kind == 'wkt':
        return geometry_of(shape.text('well-known text'))
    if kind == 'circle':
        given = shape.mapping(('center', 'radius'), ('center', 'radius'))
        x, y = numbers(given['center'], 2)
        (radius,) = numbers(given['radius'])
        return circle(x, y, radius, frame)
    given = shape.mapping(('of', 'by'), ('of', 'by'))
    other = known[given['of'].choice('region', tuple(known))].region
    if isinstance(other, MovingRegion):
        raise SpaceError(f"region '{other.name}' moves, and has no buffer")
    if other.frame != frame:
        raise SpaceError(f"region '{other.name}' is in frame '{other.frame}', not '{frame}'")
    (distance,) = numbers(given['by'])
    return buffer_of(other.geometry, distance, frame)


def frame_of(value: YamlValue) -> str:
    """Return the name of a frame."""
    name = value.text('a frame').strip()
    return WGS84 if name.lower() == WGS84 else name


def _time(value: YamlValue) -> int:
    """Return a date with a time and a zone, in nanoseconds since the epoch."""
    found = value.plain()
    try:
        date = found if isinstance(found, datetime) else datetime.fromisoformat(found)
    except (TypeError, ValueError):
        raise value.expected('a time, such as 2026-05-01T08:00:00+02:00,') from None
    if date.tzinfo is None:
        raise value.error('add the zone to the time: Z for UTC, or such as +02:00')
    return (date - _EPOCH) // timedelta(microseconds=1) * 1000


def _altitude(value: YamlValue) -> tuple[float, float]:
    low, high = numbers(value, 2)
    if not low < high:
        raise value.error('write the lower altitude first')
    return low, high


def numbers(value: YamlValue, count: int = 1) -> tuple[float, ...]:
    """Return some numbers, in a list if they are more than one."""
    found = value.items() if value.is_list and count > 1 else [value]
    if len(found) != count or not all(each.is_number for each in found):
        raise value.expected('a number' if count == 1 else f'a list of {count} numbers')
    return tuple(each.number() for each in found)


def states_any(value: YamlValue, keys: Collection[str]) -> bool:
    """Return True if a file states one of some keys beside the positions of objects."""
    return any(
        not each.mapping(POSITION_KEYS, ('of', 'frame')).keys().isdisjoint(keys)
        for each in value.one_or_more()
    )


def positioned_sorts(value: YamlValue) -> list[YamlValue]:
    """Return the sorts whose positions a file tells."""
    return [
        position_variable(each.mapping(POSITION_KEYS, ('of', 'frame'))['of'])[1]
        for each in value.one_or_more()
    ]


def position_variable(value: YamlValue) -> tuple[str, YamlValue]:
    """Return the variable and the sort of `{u: UAV}`."""
    entries = value.entries('a mapping from a variable to a sort')
    if len(entries) != 1:
        raise value.error('give one variable with its sort, such as {u: UAV}')
    ((variable, sort),) = entries
    return variable.text().strip(), sort
