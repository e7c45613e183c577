"""The positions of objects in a robot.yaml, and their distances to its regions.

    positions:
      - {of: {u: UAV}, frame: map, topic: '/{u}/odometry', field: pose.pose.position}
      - {of: {r: Rover}, frame: map, tf: '{r}/base_link'}
      - {of: {b: Boat}, frame: wgs84, topic: '/{b}/fix'}

For the object uav1 and the region dock, this makes the stream

    compunit dock: float region_distances((frame: string, x: float, y: float));
    stream uav1_region_distances = region_distances(
        select header.frame_id as frame, pose.pose.position.x as x, pose.pose.position.y as y
        from "/uav1/odometry", dock = "POLYGON ((0 0, 4 0, 4 3, 0 0)); frame map");
    sink uav1_region_distances

and the annotation `stream uav1_region_distances contains distance[uav1, dock] = dock`. With
`moves: straight`, there are the same of `swept_distance`. A region that moves has a stream of its
own for each object, which joins the two topics by time.

With the `orientation` or the `yaw` of some objects, the poses of all that have positions in their
frame are streams, too, computed by `planar_pose`. With `walls`, a sort of regions, so are the lines
of sight between the objects and all in their frame, computed by `sight_distance`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, product
from typing import Final

from dyknow_common import InlineText, listed, quoted
from dyknow_configuration.composed_text import ComposedText, constraint_parts
from dyknow_configuration.regions import (
    DISTANCES,
    POSES,
    POSITION_KEYS,
    SIGHT,
    MovingRegion,
    StatedRegion,
    drawn_regions,
    frame_of,
    position_variable,
)
from dyknow_configuration.robot import NO_MAP, RobotMap, RobotVocabulary
from dyknow_configuration.topics import MAX_TEXTS
from dyknow_configuration.yaml_values import YamlValue
from dyknow_space import ALL_HEIGHTS, WGS84, Region
from dyknow_stream_processing import parse_specification, specifications_by_sink

MAX_WALLS: Final = 10_000_000
"""The characters of the texts of walls, which each line of sight has."""

_SOURCES: Final = ('topic', 'stream', 'tf')


@dataclass(frozen=True, slots=True)
class PositionTexts:
    """What the positions of a robot.yaml make.

    Args:
        streams: the streams of the distances to regions, and of poses.
        annotations: the annotations of these streams.
        map: the map of the regions.
    """

    streams: tuple[InlineText, ...] = ()
    annotations: tuple[InlineText, ...] = ()
    map: RobotMap = NO_MAP


def read_positions(
    values: Mapping[str, YamlValue], vocabulary: RobotVocabulary, regions: Sequence[StatedRegion]
) -> PositionTexts:
    """Return the streams of the distances of objects to the regions of their frame.

    Args:
        values: the values by key.
        vocabulary: the vocabulary, with the objects.
        regions: the regions with their places.

    Raises:
        ConfigurationError: with the place of the fault; if no object has a position in the frame of
            a region, or headings are in several frames, or walls are in another frame.
    """
    if 'positions' not in values:
        return PositionTexts(map=_map_of(regions, ()))
    value = values['positions']
    sources = [_PositionSource(each, vocabulary) for each in value.one_or_more()]
    _check_frames(regions, {each.frame for each in sources})
    if len(_objects(sources)) * len(regions) > MAX_TEXTS:
        raise value.error(f'these are more than {MAX_TEXTS} distances; split the file')
    headings = _frame_of_headings(sources)
    streams: list[InlineText] = []
    annotations: list[InlineText] = []
    for source in sources:
        of_frame = [each.region for each in regions if each.region.frame == source.frame]
        has_poses = source.frame == headings
        streams += source.streams(of_frame, has_poses=has_poses)
        annotations += source.annotations(of_frame, has_poses=has_poses)
    for stream, annotation in _sight(sources, vocabulary, regions):
        streams.append(stream)
        annotations.append(annotation)
    return PositionTexts(tuple(streams), tuple(annotations), _map_of(regions, sources))


def _map_of(regions: Sequence[StatedRegion], sources: Sequence[_PositionSource]) -> RobotMap:
    """Return the map, in the frame of the first region that stands still, or else of the first."""
    drawn, everything = drawn_regions(regions), [each.region for each in regions]
    frame = next((each.frame for each in (*drawn, *everything)), '')
    return RobotMap(
        frame,
        tuple(drawn),
        {name: text for each in sources if each.frame == frame for name, text in each.positions()},
        {
            each.name: f'stream outline = {each.source}{_condition(frame) * each.is_checked}'
            for each in everything
            if isinstance(each, MovingRegion) and each.frame == frame and sources
        },
    )


def _condition(frame: str) -> str:
    """Return the condition that messages are in a frame: maps omit the others."""
    return f' where header.frame_id = {quoted(frame)}'


def _objects(sources: Iterable[_PositionSource]) -> set[str]:
    """Return the objects that have positions, each from one source."""
    found: set[str] = set()
    for source in sources:
        for name in source.objects:
            if name in found:
                raise source.value.error(f"'{name}' has a position already; keep one")
            found.add(name)
    return found


def _check_frames(regions: Sequence[StatedRegion], frames: set[str]) -> None:
    for each in regions:
        if frames and each.region.frame not in frames:  # Without any, a fault was removed.
            raise each.key.error(
                f"the region '{each.region.name}' is in frame '{each.region.frame}', but positions "
                f'are in {listed(sorted(frames))}; state both in one frame'
            )


def _frame_of_headings(sources: Iterable[_PositionSource]) -> str | None:
    """Return the frame of the objects that have a yaw: their relations need a common one."""
    found: str | None = None
    for each in sources:
        if each.orientation and found not in {None, each.frame}:
            raise each.orientation.error(
                f"this heading is in frame '{each.frame}', but others are in '{found}'; state all "
                'in one frame'
            )
        found = each.frame if each.orientation else found
    return found


def _sight(
    sources: Sequence[_PositionSource],
    vocabulary: RobotVocabulary,
    regions: Sequence[StatedRegion],
) -> Iterator[tuple[InlineText, InlineText]]:
    """Yield the streams of the lines of sight of all pairs of sources, with their annotations."""
    lines = characters = 0
    for one, other in combinations_with_replacement(sources, 2):
        stated = one.walls or other.walls
        if stated is None or one.frame != other.frame:
            continue
        if other.walls and other.walls.text() != stated.text():
            raise other.walls.error(
                f"others in this frame have the walls '{stated.text()}'; state the same sort"
            )
        walls = _walls(stated, vocabulary, regions, one.frame)
        count = len(one.pairs(other))
        lines += count
        characters += count * sum(len(each.text) for each in walls)
        if lines > MAX_TEXTS or characters > MAX_WALLS:
            raise stated.error(
                f'these are {lines} lines of sight past walls whose texts have {characters} '
                f'characters, more than {MAX_TEXTS} or {MAX_WALLS}; state walls for fewer objects, '
                'or simpler walls'
            )
        yield from one.sight_texts(other, walls)


def _walls(
    value: YamlValue, vocabulary: RobotVocabulary, regions: Sequence[StatedRegion], frame: str
) -> list[Region]:
    """Return the regions of a sort; all of them stand still in the frame of the positions."""
    sort = value.choice('sort', tuple(vocabulary.sorts))
    drawn = {each.name: each for each in drawn_regions(regions)}
    found = []
    for name in vocabulary.objects(sort):
        if name not in drawn:
            raise value.error(f"'{name}' is no region that stands still, so it is no wall")
        if drawn[name].frame != frame:
            raise value.error(
                f"the wall '{name}' is in frame '{drawn[name].frame}', but the positions are in "
                f"'{frame}'; state both in one frame"
            )
        found.append(drawn[name])
    if not found:
        raise value.error(f"no region is a '{sort}'; add one, or remove the walls")
    return found


class _PositionSource:
    """A topic, stream or transform that holds the positions of the objects of a sort."""

    def __init__(self, value: YamlValue, vocabulary: RobotVocabulary) -> None:
        self.value = value
        stated = value.mapping(POSITION_KEYS, ('of', 'frame'))
        given = [each for each in _SOURCES if each in stated]
        if len(given) != 1:
            raise value.error(f'give one of {", ".join(_SOURCES)}')
        (self._kind,) = given
        self._source = stated[self._kind]
        self._variable, sort = position_variable(stated['of'])
        self.objects = vocabulary.objects(sort.text().strip())
        self.frame = frame_of(stated['frame'])
        if self._kind == 'tf' and self.frame == WGS84:
            raise self._source.error(f'tf has no {WGS84}; give the topic of a NavSatFix')
        self._axes = _axes(stated.get('axes'), self.frame)
        self._field = stated['field'].text('a field').strip() if 'field' in stated else ''
        self._field_value = stated.get('field', self._source)
        has_header = stated['header'].truth() if 'header' in stated else self._kind == 'topic'
        # The header of a position in degrees names the antenna.
        is_checked = has_header and self.frame != WGS84
        self._frame_field = 'header.frame_id' if is_checked else ''
        self.is_swept = 'moves' in stated and bool(stated['moves'].choice('motion', ('straight',)))
        self._units = tuple(DISTANCES) if self.is_swept else tuple(DISTANCES)[:1]
        self._constraints = constraint_parts(stated, value)
        self.orientation = stated.get('orientation', stated.get('yaw'))
        """The field that has the orientation or the yaw."""
        self._heading = self._heading_fields(stated)
        self.walls = stated.get('walls')
        """The sort of the regions that hide objects from these."""

    def _heading_fields(self, stated: Mapping[str, YamlValue]) -> Mapping[str, str]:
        """Return the fields of the orientation, by their names for `planar_pose`."""
        if not self.orientation:
            return {}
        if {'orientation', 'yaw'} <= stated.keys():
            raise self.orientation.error('give orientation or yaw, not both')
        if self.frame == WGS84:
            raise self.orientation.error(f'{WGS84} has no headings; give a frame in metres')
        path = self.orientation.text('a field').strip()
        if 'yaw' in stated:
            return {'yaw': path}
        return {f'q{axis}': f'{path}.{axis}' for axis in 'xyzw'}

    def streams(
        self, regions: Sequence[Region | MovingRegion], *, has_poses: bool
    ) -> Iterator[InlineText]:
        """Yield the streams of the distances of all objects, and of their poses if wanted."""
        still = [each for each in regions if isinstance(each, Region)]
        if still:
            yield self._still_streams(still)
        for each in regions:
            if isinstance(each, MovingRegion):
                yield self._moving_streams(each)
        if has_poses:
            yield self._pose_streams()

    def _still_streams(self, regions: Sequence[Region]) -> InlineText:
        axes = _axes_for(regions)
        shapes = ', '.join(f'{each.name} = {quoted(each.text)}' for each in regions)
        fields = f'({_typed(each.name for each in regions)})', self._fields(axes)
        text = ComposedText()
        for unit in self._units:
            text.add(f'compunit {fields[0]} {unit}({fields[1]});\n', self.value)
        for name in self.objects:
            for unit in self._units:
                text.add(f'stream {name}_{unit} = {unit}(', self.value)
                self._add_position(text, name, axes)
                text.add(f', {shapes});\nsink {name}_{unit};\n', self.value)
        return self._checked(text)

    def _moving_streams(self, region: MovingRegion) -> InlineText:
        axes = _axes_for([region])
        text = ComposedText()
        inputs = f'{self._fields(axes)}, ({region.fields})'
        text.add(f'compunit {region.name}: float moving_distance({inputs});\n', self.value)
        for name in self.objects:
            text.add(f'stream {name}_distance_to_{region.name} = moving_distance(', self.value)
            self._add_position(text, name, axes)
            text.add(', ', self.value).add(region.source, region.origin)
            text.add_parts(region.constraints)
            text.add(f', {region.name} = {quoted(region.text)});\n', self.value)
            text.add(f'sink {name}_distance_to_{region.name};\n', self.value)
        return self._checked(text)

    def _checked(self, text: ComposedText) -> InlineText:
        with text.errors():
            specifications_by_sink(parse_specification(str(text)))
        return InlineText(self.value.place, str(text))

    def annotations(
        self, regions: Sequence[Region | MovingRegion], *, has_poses: bool
    ) -> Iterator[InlineText]:
        """Yield the annotations of the distances of each object, and of its pose if wanted."""
        still = [each for each in regions if isinstance(each, Region)]
        for name, unit in product(self.objects, self._units if still else ()):
            feature = DISTANCES[unit]
            contents = (f'{feature}[{name}, {each.name}] = {each.name}' for each in still)
            text = f'stream {name}_{unit} contains {", ".join(contents)};'
            yield InlineText(self.value.place, text)
        for name, region in product(self.objects, regions):
            if isinstance(region, MovingRegion):
                content = f'distance[{name}, {region.name}] = {region.name}'
                text = f'stream {name}_distance_to_{region.name} contains {content};'
                yield InlineText(self.value.place, text)
        for name in self.objects if has_poses else ():
            contents = (f'{feature}[{name}] = {of}' for feature, of in self._pose_fields().items())
            text = f'stream {name}_planar_pose contains {", ".join(contents)};'
            yield InlineText(self.value.place, text)

    def _pose_streams(self) -> InlineText:
        inputs = self._fields(['x', 'y', *self._heading])
        text = ComposedText()
        text.add(f'compunit ({_typed(self._pose_fields().values())}) ', self.value)
        text.add(f'planar_pose({inputs});\n', self.value)
        headings = ''.join(f'{path} as {name}, ' for name, path in self._heading.items())
        for name in self.objects:
            text.add(f'stream {name}_planar_pose = planar_pose(select ', self.value)
            text.add(headings, self.orientation or self.value)
            text.add(self._selections('xy'), self._field_value)
            self._add_source(text, name)
            text.add(f', frame = {quoted(self.frame)});\nsink {name}_planar_pose;\n', self.value)
        return self._checked(text)

    def pairs(self, other: _PositionSource) -> list[tuple[str, str]]:
        """Return the pairs of objects of this and another source, without their order."""
        if other is self:
            return [*combinations_with_replacement(self.objects, 2)]
        return [*product(self.objects, other.objects)]

    def sight_texts(
        self, other: _PositionSource, walls: Sequence[Region]
    ) -> Iterator[tuple[InlineText, InlineText]]:
        """Yield the stream of each line of sight to an object of a source, and its annotation."""
        axes = _axes_for(walls)
        shapes = ', '.join(f'{each.name} = {quoted(each.text)}' for each in walls)
        inputs = f'{self._fields(axes)}, {other._fields(axes)}'
        for name, seen in self.pairs(other):
            stream = f'sight_of_{name}_and_{seen}'
            text = ComposedText()
            text.add(f'compunit sight: float {SIGHT}({inputs});\n', self.value)
            text.add(f'stream {stream} = {SIGHT}(', self.value)
            self._add_position(text, name, axes)
            text.add(', ', self.value)
            other._add_position(text, seen, axes)
            text.add(f', {shapes});\nsink {stream};\n', self.value)
            orders = dict.fromkeys([(name, seen), (seen, name)])
            contents = ', '.join(f'{SIGHT}[{", ".join(each)}] = sight' for each in orders)
            annotation = f'stream {stream} contains {contents};'
            yield self._checked(text), InlineText(self.value.place, annotation)

    def _pose_fields(self) -> Mapping[str, str]:
        """Return the field of each feature of a pose; of an object without a heading, no yaw."""
        return {name: field for name, (field, _) in POSES.items() if name != 'yaw' or self._heading}

    def positions(self) -> Iterator[tuple[str, str]]:
        """Yield each object with the stream of its x and y, without constraints."""
        for name in self.objects:
            source = self._source_of(name) + _condition(self.frame) * bool(self._frame_field)
            yield name, f'stream position = select {self._selections("xy")} from {source}'

    def _selections(self, axes: str) -> str:
        frame = [f'{self._frame_field} as frame'] if self._frame_field else []
        before = f'{self._field}.' if self._field else ''
        if self._kind == 'tf':
            before = 'translation.'
        fields = zip(self._axes, axes, strict=False)
        return ', '.join([*frame, *(f'{before}{name} as {axis}' for name, axis in fields)])

    def _fields(self, names: Iterable[str]) -> str:
        frame = 'frame: string, ' if self._frame_field else ''
        return f'({frame}{_typed(names)})'

    def _add_position(self, text: ComposedText, name: str, axes: str) -> None:
        text.add('select ', self.value).add(self._selections(axes), self._field_value)
        self._add_source(text, name)

    def _add_source(self, text: ComposedText, name: str) -> None:
        text.add(f' from {self._source_of(name)}', self._source)
        text.add_parts(self._constraints)

    def _source_of(self, name: str) -> str:
        objects = {self._variable: name}
        source = str(ComposedText().add_template(self._source, objects)).strip()
        if self._kind == 'tf':
            return f'tf({quoted(self.frame)}, {quoted(source)})'
        return quoted(source) if self._kind == 'topic' else source


def _axes(value: YamlValue | None, frame: str) -> tuple[str, str, str]:
    """Return the fields of x, y and z; for positions in degrees, the fields of a NavSatFix."""
    if value is None:
        return ('longitude', 'latitude', 'altitude') if frame == WGS84 else ('x', 'y', 'z')
    names = [each.text('a field').strip() for each in value.one_or_more()]
    if len(names) != 3:  # noqa: PLR2004
        raise value.error(
            f'these are {len(names)} of three fields; write those of x, y and z, such as '
            '[lon, lat, alt]'
        )
    return names[0], names[1], names[2]


def _axes_for(regions: Iterable[Region | MovingRegion]) -> str:
    return 'xyz' if any(each.altitude != ALL_HEIGHTS for each in regions) else 'xy'


def _typed(names: Iterable[str]) -> str:
    return ', '.join(f'{each}: float' for each in names)
