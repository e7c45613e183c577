"""Maps: regions in the colours of verdicts, tracks of objects, and the places of failures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from typing import Any, Final

import numpy as np

from dyknow_recordings.evaluation.recorded_map import MAX_POINTS, RecordedMap, Track
from dyknow_recordings.evaluation.results import Episode, FormulaReport, Outcome, RecordingReport
from dyknow_recordings.markers import objects_of
from dyknow_recordings.reporting.judgement import decisive_episode
from dyknow_recordings.reporting.pictures.timeline import Span, extent
from dyknow_space import WGS84, LocalPlane, shapely

_HEIGHT: Final = 26.0
"""Of the image, in em; its width is at most twice that."""

_DETAIL: Final = 1 / 2000
"""The share of the height that an outline may be away from its region: less than a pixel."""


def map_image(
    found: RecordedMap, formulas: Sequence[FormulaReport], whole: Span, points: int = MAX_POINTS
) -> str:
    """Return a map as SVG; empty without regions of one frame.

    Args:
        found: the regions, and the tracks of objects; those of other frames are not drawn.
        formulas: whose outcomes are shown.
        whole: the span in which times of failures are told.
        points: the most that are drawn of a track.
    """
    frame = found.regions[0].frame if found.regions else ''
    regions = {each.name: each.geometry for each in found.regions if each.frame == frame}
    if not regions:
        return ''
    tracks = {name: _finite(each) for name, each in found.tracks.items()}
    if frame == WGS84:
        plane = LocalPlane.of(found.regions[0].geometry)
        regions = {name: plane.projected(each) for name, each in regions.items()}
        tracks = {name: (at, *plane.coordinates(x, y)) for name, (at, x, y) in tracks.items()}
    tracks = {name: each for name, each in tracks.items() if len(each[0])}
    box, size = _extent(regions.values(), tracks.values())
    outcomes = _outcomes(formulas)
    failures = [each for formula in formulas for each in _failures(tracks, formula, whole)]
    shown = {name: each.simplify(size * _DETAIL) for name, each in regions.items()}
    shapes = [
        *(_region(name, each, outcomes.get(name)) for name, each in shown.items()),
        *(_track(name, each, size / 160, points) for name, each in tracks.items()),
        *(_place_mark(*place, size / 80, text) for place, text in failures),
        *(_label(*place, size / 40, text.rpartition(': ')[2]) for place, text in failures),
        *(_label(*_inside(shown[name]), size / 30, name) for name in outcomes if name in shown),
    ]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="map" viewBox="{box}" '
        f'style="max-height:{_HEIGHT}em" role="img" aria-label="map in frame {escape(frame)}">'
        f'{"".join(shapes)}</svg>'
    )


def map_features(report: RecordingReport) -> Iterator[dict[str, Any]]:
    """Yield the regions, tracks and places of failures of a recording, as features of GeoJSON.

    Coordinates are in metres of the frame that each names, or in degrees in `wgs84`.
    """
    found = report.map or RecordedMap()
    outcomes, whole = _outcomes(report.formulas), extent(report)
    tracks = {name: _finite(each) for name, each in found.tracks.items()}
    for region in found.regions:
        name, shape = region.name, shapely().geometry.mapping(region.geometry)
        about = {'kind': 'region', 'name': name, 'frame': region.frame}
        yield _feature(shape, report, {**about, 'outcome': outcomes.get(name)})
    frame = found.regions[0].frame if found.regions else ''
    for name, (times, x, y) in tracks.items():
        if len(times) > 1:
            line = {'type': 'LineString', 'coordinates': np.column_stack((x, y)).tolist()}
            yield _feature(line, report, {'kind': 'track', 'name': name, 'frame': frame})
    for formula in report.formulas:
        for place, text in _failures(tracks, formula, whole):
            point = {'type': 'Point', 'coordinates': place}
            yield _feature(point, report, {'kind': 'failure', 'name': text, 'frame': frame})


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
            names = _deciding(decisive_episode(formula)) or names
        for name in names:
            found[name] = min(found.get(name, outcome), outcome, key=list(Outcome).index)
    return found


def _failures(
    tracks: Mapping[str, Track], formula: FormulaReport, whole: Span
) -> Iterator[tuple[tuple[float, float], str]]:
    """Yield the places of the objects that made a formula false, and the reason."""
    episode = decisive_episode(formula)
    if episode is None or episode.decided_at is None or episode.outcome is not Outcome.FALSE:
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


def _region(name: str, geometry: Any, outcome: Outcome | None) -> str:
    polygons = getattr(geometry, 'geoms', [geometry])
    rings = [ring for each in polygons for ring in (each.exterior, *each.interiors)]
    path = ' '.join(f'M{_points(*np.array(ring.coords)[:, :2].T)}Z' for ring in rings)
    kind = f' class="is-{outcome}"' if outcome else ''
    text = escape(f'{name}: {outcome}' if outcome else name)
    return f'<path{kind} d="{path}"><title>{text}</title></path>'


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
