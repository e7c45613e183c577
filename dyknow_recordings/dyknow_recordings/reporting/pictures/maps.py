"""Maps: regions in the colours of verdicts, tracks of objects, and the places of failures."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from html import escape
from operator import itemgetter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dyknow_recordings.evaluation.recorded_map import MAX_POINTS, RecordedMap, Track
from dyknow_recordings.evaluation.results import Episode, FormulaReport, Outcome, RecordingReport
from dyknow_recordings.markers import objects_of
from dyknow_recordings.reporting.pictures.timeline import Span, extent
from dyknow_space import WGS84, LocalPlane, SpaceError, geometry_of, shapely

_HEIGHT: Final = 26.0
"""The height of the image, in em; the width is at most twice the height."""

_DETAIL: Final = 1 / 2000
"""The share of the height that an outline may be away from its region: less than a pixel."""


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    """A region as it is drawn.

    Args:
        time: for a region that moves, since when it was there, for people; else empty.
    """

    name: str
    frame: str
    geometry: Any
    outcome: Outcome | None
    time: str = ''

    @property
    def text(self) -> str:
        """The region, for people."""
        when = f' at {self.time}' if self.time else ''
        return f'{self.name}{when}: {self.outcome}' if self.outcome else f'{self.name}{when}'


def map_image(
    found: RecordedMap, formulas: Sequence[FormulaReport], whole: Span, points: int = MAX_POINTS
) -> str:
    """Return a map as SVG; empty without regions of its frame.

    Args:
        found: the regions, and the tracks of objects.
        formulas: whose outcomes are shown.
        whole: the span in which times of failures are told.
        points: the most that are drawn of a track.
    """
    shapes = [each for each in _shapes(found, formulas, whole) if each.frame == found.frame]
    if not shapes:
        return ''
    tracks = {name: _finite(each) for name, each in found.tracks.items()}
    if found.frame == WGS84:
        plane = LocalPlane.of(shapes[0].geometry)
        shapes = [replace(each, geometry=plane.projected(each.geometry)) for each in shapes]
        tracks = {name: (at, *plane.coordinates(x, y)) for name, (at, x, y) in tracks.items()}
    tracks = {name: each for name, each in tracks.items() if len(each[0])}
    box, size = _extent((each.geometry for each in shapes), tracks.values())
    failures = [each for formula in formulas for each in _failures(tracks, formula, whole)]
    shapes = [replace(each, geometry=each.geometry.simplify(size * _DETAIL)) for each in shapes]
    parts = [
        *map(_region, shapes),
        *(_track(name, each, size / 160, points) for name, each in tracks.items()),
        *(_place_mark(*place, size / 80, text) for place, text in failures),
        *(_label(*place, size / 40, text.rpartition(': ')[2]) for place, text in failures),
        *(
            _label(*_inside(each.geometry), size / 30, each.name)
            for each in shapes
            if each.outcome or each.time
        ),
    ]
    label = escape(f'map in frame {found.frame}')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="map" viewBox="{box}" '
        f'style="max-height:{_HEIGHT}em" role="img" aria-label="{label}">{"".join(parts)}</svg>'
    )


def map_features(report: RecordingReport) -> Iterator[dict[str, Any]]:
    """Yield the regions, tracks and places of failures of a recording, as features of GeoJSON.

    Coordinates are in metres of the frame that each names, or in degrees in `wgs84`.
    """
    found, whole = report.map or RecordedMap(), extent(report)
    tracks = {name: _finite(each) for name, each in found.tracks.items()}
    for each in _shapes(found, report.formulas, whole):
        about = {'kind': 'region', 'name': each.name, 'frame': each.frame, 'outcome': each.outcome}
        when = {'time': each.time} if each.time else {}
        yield _feature(shapely().geometry.mapping(each.geometry), report, {**about, **when})
    for name, (times, x, y) in tracks.items():
        if len(times) > 1:
            line = _line(np.column_stack((x, y)), found.frame)
            yield _feature(line, report, {'kind': 'track', 'name': name, 'frame': found.frame})
    for formula in report.formulas:
        for place, text in _failures(tracks, formula, whole):
            point = {'type': 'Point', 'coordinates': place}
            yield _feature(point, report, {'kind': 'failure', 'name': text, 'frame': found.frame})


def _line(points: NDArray[np.float64], frame: str) -> dict[str, Any]:
    """Return a track; in degrees, cut at 180 (RFC 7946, section 3.1.9)."""
    cuts = np.flatnonzero(np.abs(np.diff(points[:, 0])) > 180) + 1  # noqa: PLR2004
    if frame != WGS84 or not len(cuts):
        return {'type': 'LineString', 'coordinates': points.tolist()}
    before, after = points[cuts - 1].T, points[cuts].T
    way = 360 - np.abs(after[0] - before[0])
    part = (180 - np.abs(before[0])) / np.where(way > 0, way, 1)
    side, at = np.copysign(180, before[0]), before[1] + part * (after[1] - before[1])
    ends = np.column_stack([side, at, -side, at]).reshape(-1, 2)
    joined = np.insert(points, np.repeat(cuts, 2), ends, axis=0)
    parts = np.split(joined, cuts + 2 * np.arange(len(cuts)) + 1)
    return {'type': 'MultiLineString', 'coordinates': [each.tolist() for each in parts]}


def _shapes(found: RecordedMap, formulas: Sequence[FormulaReport], whole: Span) -> Iterator[_Shape]:
    """Yield the regions as they are drawn; moving regions appear at failures and at the end."""
    outcomes = _outcomes(formulas)
    for each in found.regions:
        yield _Shape(each.name, each.frame, each.geometry, outcomes.get(each.name))
    for name, outlines in found.outlines.items():
        failures = [each.failure for each in formulas]
        moments = [each.decided_at or 0 for each in failures if each and name in _deciding(each)]
        indices = {bisect_right(outlines, time, key=itemgetter(0)) - 1 for time in moments}
        failed = dict.fromkeys(indices - {-1}, Outcome.FALSE)
        last = None if failed else outcomes.get(name)
        for index, outcome in sorted({len(outlines) - 1: last, **failed}.items()):
            time, text = outlines[index]
            # If an outline cannot be drawn, the formulas report a violation.
            with suppress(SpaceError):
                yield _Shape(name, found.frame, geometry_of(text), outcome, whole.text(time))


def _feature(
    geometry: Mapping[str, Any], report: RecordingReport, about: dict[str, Any]
) -> dict[str, Any]:
    properties = {'recording': report.recording, **about}
    return {'type': 'Feature', 'geometry': geometry, 'properties': properties}


def _finite(track: Track) -> Track:
    """Return the points of a track whose coordinates are numbers."""
    times, x, y = track
    kept = np.isfinite(x) & np.isfinite(y)
    return times[kept], x[kept], y[kept]


def _extent(geometries: Iterable[Any], tracks: Iterable[Track]) -> tuple[str, float]:
    """Return the box of all that is drawn, with a border, and its height if it is a wide one."""
    corners = [np.array(each.bounds).reshape(2, 2) for each in geometries]
    everything = np.concatenate([*corners, *(np.column_stack(each[1:]) for each in tracks)])
    low, high = everything.min(axis=0), everything.max(axis=0)
    size = float(max(high[1] - low[1], (high[0] - low[0]) / 2, 1e-3))
    low, sides = low - 0.05 * size, high - low + 0.1 * size
    # North is up: the y axis of SVG points down.
    box = f'{low[0]:.6g} {-(low[1] + sides[1]):.6g} {sides[0]:.6g} {sides[1]:.6g}'
    return box, size


def _outcomes(formulas: Iterable[FormulaReport]) -> dict[str, Outcome]:
    """Return the worst outcome of the formulas about each object.

    A formula that is false tells it of the objects that made it so, if it names these.
    """
    found: dict[str, Outcome] = {}
    for formula in formulas:
        outcome, names = formula.outcome, objects_of(formula.groundings)
        if outcome is Outcome.FALSE:
            names = _deciding(formula.failure) or names
        for name in names:
            found[name] = min(found.get(name, outcome), outcome, key=list(Outcome).index)
    return found


def _failures(
    tracks: Mapping[str, Track], formula: FormulaReport, whole: Span
) -> Iterator[tuple[tuple[float, float], str]]:
    """Yield the places of the objects that made a formula false, and the reason."""
    episode = formula.failure
    if episode is None or episode.decided_at is None:
        return
    for name in sorted(_deciding(episode) & tracks.keys()):
        times, x, y = tracks[name]
        index = int(np.searchsorted(times, episode.decided_at, 'right')) - 1
        text = f'{formula.name}: {name} at {whole.text(episode.decided_at)}'
        if index >= 0:
            yield (float(x[index]), float(y[index])), text


def _deciding(episode: Episode | None) -> frozenset[str]:
    """Return the objects that decide a formula."""
    parts = episode.objects.split(', ') if episode and episode.objects else ()
    return frozenset(part.partition(' = ')[2] for part in parts)


def _region(shape: _Shape) -> str:
    polygons = getattr(shape.geometry, 'geoms', [shape.geometry])
    rings = [ring for each in polygons for ring in (each.exterior, *each.interiors)]
    path = ' '.join(f'M{_points(*np.array(ring.coords)[:, :2].T)}Z' for ring in rings)
    kind = f' class="is-{shape.outcome}"' if shape.outcome else ''
    return f'<path{kind} d="{path}"><title>{escape(shape.text)}</title></path>'


def _inside(geometry: Any) -> tuple[float, float]:
    """Return a place in a region, in one of its parts."""
    found = geometry.representative_point()
    return found.x, found.y


def _label(x: float, y: float, height: float, text: str) -> str:
    """Return a text above a place."""
    style = f'x="{x:.6g}" y="{-y - height:.6g}" font-size="{height:.3g}"'
    return f'<text {style}>{escape(text)}</text>'


def _track(name: str, track: Track, radius: float, most: int) -> str:
    """Return a track as a line, and its last point."""
    _, x, y = track
    # Every n-th point, counted from the last.
    step = -(-len(x) // most)
    line = _points(x[::-step][::-1], y[::-step][::-1])
    return f'<polyline points="{line}"><title>{escape(name)}</title></polyline>' + _place_mark(
        float(x[-1]), float(y[-1]), radius, name, ' class="last"'
    )


def _place_mark(x: float, y: float, radius: float, text: str, kind: str = '') -> str:
    title = f'<title>{escape(text)}</title>'
    return f'<circle{kind} cx="{x:.6g}" cy="{-y:.6g}" r="{radius:.3g}">{title}</circle>'


def _points(x: Iterable[float], y: Iterable[float]) -> str:
    return ' '.join(f'{one:.6g},{-other:.6g}' for one, other in zip(x, y, strict=True))
