"""Maps of recordings in pages: regions, tracks, and where a formula became false."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded import RecordedSample, at, recording, sample

from dyknow_common import InlineText, Verdict
from dyknow_configuration import RobotMap
from dyknow_coordinator import Grounding, SymbolGrounding
from dyknow_recordings.evaluation.recorded_map import MAX_POINTS, RecordedMap, recorded_map
from dyknow_recordings.evaluation.results import Episode, FormulaReport, RecordingReport
from dyknow_recordings.reporting.judgement import Judgement
from dyknow_recordings.reporting.pictures.files import PictureFiles
from dyknow_recordings.reporting.pictures.maps import map_features, map_image
from dyknow_recordings.reporting.pictures.timeline import Span
from dyknow_space import WGS84, Region, geometry_of

HOLE = 'POLYGON ((0 0, 4 0, 4 4, 0 4, 0 0), (1 1, 2 1, 2 2, 1 2, 1 1))'
DOCK = Region('dock', ('Zone',), 'map', geometry_of(HOLE))
POSITION = 'stream position = select x, y from "/{}/pose"'
FAR = Region('far', ('Zone',), 'odom', geometry_of('POLYGON ((90 0, 94 0, 94 4, 90 0))'))


def recorded(count: int = 10) -> RecordedMap:
    messages = [sample('/r1/pose', index / 10, x=float(index), y=2.0) for index in range(count)]
    positions = {name: POSITION.format(name) for name in ('r1', 'r2')}
    return recorded_map(recording(messages, batch=4), RobotMap('map', (DOCK, FAR), positions))


def drawn(image: str) -> ET.Element:
    return ET.fromstring(image.replace(' xmlns="http://www.w3.org/2000/svg"', ''))  # noqa: S314


def test_tracks_are_those_of_the_topics() -> None:
    found = recorded()
    assert [*found.tracks] == ['r1']
    times, x, y = found.tracks['r1']
    assert times.tolist() == [at(index / 10) for index in range(10)]
    assert (x.tolist(), set(y.tolist())) == ([*map(float, range(10))], {2.0})
    assert len(recorded(2 * MAX_POINTS + 1).tracks['r1'][0]) <= MAX_POINTS


def test_the_place_of_a_failure() -> None:
    episode = Episode(at(0), Verdict.FALSE, at(0.34), objects='r = r1, z = dock')
    formulas = [FormulaReport('<out>', 'true', (episode,)), FormulaReport('b', 'true')]
    image = map_image(recorded(), formulas, Span(at(0), at(1)))
    root = drawn(image)
    (region,) = root.findall('path')  # That of another frame is not drawn.
    assert region.get('class') == 'is-false'
    assert region.get('d', '').count('Z') == 2
    last, mark = root.findall('circle')
    assert (last.get('class'), last.get('cx')) == ('last', '9')
    assert (mark.get('cx'), mark.get('cy')) == ('3', '-2')
    assert mark.findtext('title') == '<out>: r1 at 0.340 s'
    (track,) = root.findall('polyline')
    assert track.get('points', '').startswith('0,-2 1,-2')


def test_regions_have_the_worst_outcome_of_the_formulas_about_them() -> None:
    about = [
        SymbolGrounding(f'distance[r1, {name}]', Grounding.SEMANTIC, '') for name in ('dock', 'b')
    ]
    holds = Episode(at(0), Verdict.TRUE, at(0))
    good = FormulaReport('good', 'true', (holds,), groundings=(*about,))
    assert region_class(good) == 'is-true'
    assert region_class(good, replace(good, episodes=(Episode(at(0)),))) == 'is-undecided'
    bad = replace(good, episodes=(holds, Episode(at(0), Verdict.FALSE, at(0), objects='z = b')))
    assert region_class(bad, good) == 'is-true', 'it is about the other region'
    assert region_class(replace(bad, episodes=(Episode(at(0), Verdict.FALSE),))) == 'is-false'
    assert region_class() is None


def region_class(*formulas: FormulaReport) -> str | None:
    (region,) = drawn(map_image(recorded(), formulas, Span(at(0), at(1)))).findall('path')
    return region.get('class')


def test_a_map_for_other_tools() -> None:
    episode = Episode(at(0), Verdict.FALSE, at(0.34), objects='r = r1, z = dock')
    out = FormulaReport('out', 'true', (episode,))
    report = RecordingReport('bag', at(0), at(1), (out,), map=recorded())
    found = json.loads(json.dumps([*map_features(report)]))
    about = [{**each['properties'], 'type': each['geometry']['type']} for each in found]
    assert {each.pop('recording') for each in about} == {'bag'}
    assert about == [
        {'kind': 'region', 'name': 'dock', 'frame': 'map', 'outcome': 'false', 'type': 'Polygon'},
        {'kind': 'region', 'name': 'far', 'frame': 'odom', 'outcome': None, 'type': 'Polygon'},
        {'kind': 'track', 'name': 'r1', 'frame': 'map', 'type': 'LineString'},
        {'kind': 'failure', 'name': 'out: r1 at 0.340 s', 'frame': 'map', 'type': 'Point'},
    ]
    assert found[0]['geometry']['coordinates'][1][0] == [1, 1], 'the hole'
    assert found[3]['geometry']['coordinates'] == [3, 2]
    assert [*map_features(replace(report, map=None))] == []


@pytest.mark.parametrize(
    ('x', 'lines'),
    [
        ([179.0, 180.0], [[[179, 0], [180, 1]]]),
        ([179.0, -179.0], [[[179, 0], [180, 0.5]], [[-180, 0.5], [-179, 1]]]),
        (
            [-180.0, 180.0, -177.0],
            [[[-180, 0], [-180, 0]], [[180, 0], [180, 1], [180, 1]], [[-180, 1], [-177, 2]]],
        ),
    ],
)
def test_tracks_are_cut_at_180_degrees(x: list[float], lines: object) -> None:
    track = np.arange(len(x)), np.array(x), np.arange(len(x), dtype=np.float64)
    report = RecordingReport('bag', at(0), at(1), (), map=RecordedMap(WGS84, (), {'r1': track}))
    (found,) = map_features(report)
    kind, coordinates = found['geometry']['type'], found['geometry']['coordinates']
    assert ([coordinates] if kind == 'LineString' else coordinates) == lines


def test_the_file_for_other_tools(tmp_path: Path) -> None:
    report = RecordingReport('bag', at(0), at(1), (), map=recorded())
    files = PictureFiles(None, None, Judgement.AUTO, tmp_path / 'map.geojson')
    files.add(report)
    files.close(())
    written = json.loads((tmp_path / 'map.geojson').read_text(encoding='utf-8'))
    assert written == {
        'type': 'FeatureCollection',
        'features': json.loads(json.dumps([*map_features(report)])),
    }


def test_tracks_end_at_their_last_place() -> None:
    times = np.arange(3)
    bad = {
        'a': (times, np.array([1.0, np.nan, 2.0]), np.zeros(3)),
        'b': (times, np.full(3, np.inf), np.zeros(3)),
    }
    root = drawn(map_image(RecordedMap('map', (DOCK,), bad), (), Span(0, 1), 1))
    (line,) = root.findall('polyline')
    assert line.get('points') == '2,-0', 'one point is asked for'


def test_without_regions_there_is_no_map() -> None:
    assert not map_image(RecordedMap(), (), Span(0, 1))
    lonely = RecordedMap('map', (DOCK,))
    assert '<path' in map_image(lonely, (), Span(0, 1))


def cell(seconds: float, x: float, frame: str = 'map') -> RecordedSample:
    outline = f'POLYGON (({x} 0, {x + 1} 0, {x + 1} 1, {x} 0))'
    return sample('/cell', seconds, frame=frame, outline=outline)


def moving(*cells: RecordedSample, moments: tuple[float, ...] = (), batch: int = 4) -> RecordedMap:
    """The map of a robot whose topic has a frame, and of a cell that moves."""
    poses = [
        sample('/r1/pose', index / 10, frame='odom' if index == 9 else 'map', x=float(index), y=2.0)
        for index in range(10)
    ]
    known = RobotMap(
        'map',
        (),
        {'r1': 'stream position = select x, y from "/r1/pose" where frame = "map"'},
        {'cell': 'stream outline = select outline from "/cell" where frame = "map"'},
    )
    read = recording([*poses, *cells], batch)
    return recorded_map(read, known, moments=[at(each) for each in moments])


@pytest.mark.parametrize('batch', [1, 4, 1 << 14])
def test_a_region_that_moves_is_drawn_at_failures_and_at_the_end(batch: int) -> None:
    cells = [cell(index / 5, float(index)) for index in range(5)]
    found = moving(*cells, cell(0.9, 50.0, 'odom'), moments=(0.25, 0.45), batch=batch)
    assert [time for time, _ in found.outlines['cell']] == [at(each) for each in (0.2, 0.4, 0.8)]
    assert found.tracks['r1'][0].tolist() == [at(index / 10) for index in range(9)], 'in the frame'
    episode = Episode(at(0), Verdict.FALSE, at(0.45), objects='r = r1, z = cell')
    report = FormulaReport('clear', 'true', (episode,))
    whole = Span(at(0), at(1))
    failed, last = drawn(map_image(found, [report], whole)).findall('path')
    assert (failed.get('class'), failed.findtext('title')) == ('is-false', 'cell at 0.400 s: false')
    assert (last.get('class'), last.findtext('title')) == (None, 'cell at 0.800 s')
    about = (SymbolGrounding('distance[r1, cell]', Grounding.SEMANTIC, ''),)
    good = FormulaReport('clear', 'true', (Episode(at(0), Verdict.TRUE, at(0)),), groundings=about)
    (only,) = drawn(map_image(found, [good], whole)).findall('path')
    assert (only.get('class'), only.findtext('title')) == ('is-true', 'cell at 0.800 s: true')
    early = replace(report, episodes=(replace(episode, decided_at=at(-1)),))
    assert len(drawn(map_image(found, [early], whole)).findall('path')) == 1, 'before the first'
    bag = RecordingReport('bag', at(0), at(1), (report,), map=found)
    times = [each['properties'].get('time') for each in map_features(bag)]
    assert times == ['0.400 s', '0.800 s', None, None]


def test_outlines_that_cannot_be_drawn() -> None:
    bow = sample('/cell', 0.5, frame='map', outline='POLYGON ((0 0, 2 2, 0 2, 2 0, 0 0))')
    assert not map_image(moving(bow), (), Span(at(0), at(1)))
    assert not map_image(moving(), (), Span(at(0), at(1))), 'the cell has no message'


def test_the_place_at_a_failure_is_exact_on_a_long_track() -> None:
    count = 3 * MAX_POINTS
    messages = [sample('/r1/pose', index / 10, x=float(index), y=2.0) for index in range(count)]
    known = RobotMap('map', (DOCK,), {'r1': POSITION.format('r1')})
    times, x, _ = recorded_map(recording(messages), known, moments=[at(100.1)]).tracks['r1']
    assert len(times) <= MAX_POINTS + 2
    assert {1001.0, count - 1.0} <= {*x.tolist()}


def test_stamps_far_from_the_clock_are_on_the_map() -> None:
    late = [
        sample('/r1/pose', index, delay=-90 if index > 5 else 5, x=1.0 * index, y=2.0)
        for index in range(10)
    ]
    known = RobotMap('map', (DOCK,), {'r1': POSITION.format('r1')})
    assert len(recorded_map(recording(late), known).tracks['r1'][0]) > 3


def test_a_stream_that_cannot_be_made_has_no_track() -> None:
    messages = [sample('/r1/pose', index / 10, x='east', y=2.0) for index in range(3)]
    positions = {
        'r1': POSITION.format('r1'),
        'r2': 'stream position = select z as x, y from "/r1/pose"',
        'r3': 'stream position = select x, y from nothing',
        'r4': 'stream position = select x, y from "/r4/pose"',
    }
    known = RobotMap('map', (DOCK,), positions)
    assert not recorded_map(recording(messages), known).tracks


def test_positions_from_a_stream_of_a_file() -> None:
    messages = [
        sample('/fleet', index / 10, id='r1' if index % 2 else 'r2', east=float(index), north=0.0)
        for index in range(10)
    ]
    text = 'stream first = select east, north from "/fleet" where id = "r1"; sink first'
    known = RobotMap(
        'map', (DOCK,), {'r1': 'stream position = select east as x, north as y from first'}
    )
    found = recorded_map(recording(messages), known, [InlineText('robot.yaml', text)])
    assert found.tracks['r1'][1].tolist() == [1, 3, 5, 7, 9]
