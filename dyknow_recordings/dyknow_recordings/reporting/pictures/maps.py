"""The map of a recording as an image in a page: regions, tracks, and the places of failures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from html import escape
from typing import Final

import numpy as np

from dyknow_recordings.evaluation.recorded_map import RecordedMap
from dyknow_recordings.evaluation.results import FormulaReport, Outcome
from dyknow_recordings.reporting.pictures.timeline import Span
from dyknow_recordings.reporting.reasons import decisive_episode
from dyknow_space import WGS84, LocalPlane

_HEIGHT: Final = 26.0
"""Of the image, in em; its width is at most twice that."""


def map_image(found: RecordedMap, formulas: Iterable[FormulaReport], whole: Span) -> str:
    """Return the map of a recording as SVG; empty without regions of one frame."""
    frame = found.regions[0].frame if found.regions else ''
    regions = {each.name: each.geometry for each in found.regions if each.frame == frame}
    if not regions:
        return ''
    if frame == WGS84:
        plane = LocalPlane.of(found.regions[0].geometry)
        regions = {name: plane.projected(each) for name, each in regions.items()}
        tracks = {name: (at, *plane.coordinates(x, y)) for name, (at, x, y) in found.tracks.items()}
        found = replace(found, tracks=tracks)
    corners = np.array([each.bounds for each in regions.values()]).reshape(-1, 2)
    points = [np.column_stack(track[1:]) for track in found.tracks.values()]
    everything = np.concatenate([corners, *points])
    everything = everything[np.isfinite(everything).all(axis=1)]
    low, high = everything.min(axis=0), everything.max(axis=0)
    size = float(max(high[1] - low[1], (high[0] - low[0]) / 2, 1e-3))
    low, extent = low - 0.05 * size, high - low + 0.1 * size
    failures = [each for formula in formulas for each in _failures(found, formula, whole)]
    # North is up: the y axis of SVG points down.
    box = f'{low[0]:.6g} {-(low[1] + extent[1]):.6g} {extent[0]:.6g} {extent[1]:.6g}'
    named = {name for _, names, _ in failures for name in names}
    return (
        f'<svg class="map" viewBox="{box}" style="max-height:{_HEIGHT}em" role="img" '
        f'aria-label="map in frame {escape(frame)}">'
        + ''.join(_region(name, each, name in named) for name, each in regions.items())
        + ''.join(_track(name, track[1], track[2]) for name, track in found.tracks.items())
        + ''.join(_mark(*place, size / 80, text) for place, _, text in failures)
        + '</svg>'
    )


def _failures(
    found: RecordedMap, formula: FormulaReport, whole: Span
) -> Iterator[tuple[tuple[float, float], set[str], str]]:
    """Yield the places of the objects that made a formula false, their names, and the reason."""
    episode = decisive_episode(formula)
    if episode is None or episode.decided_at is None or episode.outcome is not Outcome.FALSE:
        return
    names = {part.partition(' = ')[2] for part in episode.objects.split(', ')}
    for name in sorted(names & found.tracks.keys()):
        times, x, y = found.tracks[name]
        index = max(int(np.searchsorted(times, episode.decided_at, 'right')) - 1, 0)
        text = f'{formula.name}: {name} at {whole.text(episode.decided_at)}'
        yield (float(x[index]), float(y[index])), names, text


def _region(name: str, geometry: object, is_broken: bool) -> str:  # noqa: FBT001
    polygons = getattr(geometry, 'geoms', [geometry])
    rings = [ring for each in polygons for ring in (each.exterior, *each.interiors)]
    path = ' '.join(f'M{_points(*np.array(ring.coords)[:, :2].T)}Z' for ring in rings)
    kind = ' class="is-broken"' if is_broken else ''
    return f'<path{kind} d="{path}"><title>{escape(name)}</title></path>'


def _track(name: str, x: Iterable[float], y: Iterable[float]) -> str:
    return f'<polyline points="{_points(x, y)}"><title>{escape(name)}</title></polyline>'


def _mark(x: float, y: float, radius: float, text: str) -> str:
    title = f'<title>{escape(text)}</title>'
    return f'<circle cx="{x:.6g}" cy="{-y:.6g}" r="{radius:.3g}">{title}</circle>'


def _points(x: Iterable[float], y: Iterable[float]) -> str:
    return ' '.join(f'{one:.6g},{-other:.6g}' for one, other in zip(x, y, strict=True))
