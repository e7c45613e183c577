"""Results of a check as one page: interactive, self-contained, and readable without scripts."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from html import escape
from importlib import resources
from itertools import count
from pathlib import PurePath
from typing import Any, Final

import numpy as np

from dyknow_common import NANOSECONDS, round_duration
from dyknow_recordings.evaluation.recorded_map import RecordedMap
from dyknow_recordings.evaluation.results import FormulaReport, Outcome, RecordingReport
from dyknow_recordings.reporting.judgement import Judgement
from dyknow_recordings.reporting.pictures.details import body
from dyknow_recordings.reporting.pictures.figures import PageFigures
from dyknow_recordings.reporting.pictures.libraries import plotly_script
from dyknow_recordings.reporting.pictures.panels import formula_text
from dyknow_recordings.reporting.pictures.timeline import (
    OutcomeSegment,
    Span,
    extent,
    gaps,
    segments,
)
from dyknow_recordings.reporting.reasons import decisive_episode
from dyknow_space import WGS84, LocalPlane

_FIRST_DATE: Final = 1_000_000_000 * NANOSECONDS['s']
"""Earlier times come from a simulation that starts at zero; they are no dates."""

_END: Final = 0.95
"""The place on the line from which on there is room to the left only."""

_LABELLED: Final = 0.2
"""The share of the line from which on a segment has room for its word."""

_HEIGHT: Final = 26.0
"""Of the image, in em; its width is at most twice that."""


def report_page(
    reports: Sequence[RecordingReport], unread: Sequence[str], judgement: Judgement
) -> str:
    """Return the page.

    Args:
        reports: of the recordings.
        unread: why the other recordings were not checked.
        judgement: of undecided formulas.
    """
    figures = PageFigures()
    numbers = count()
    sections = [''.join(_section(each, judgement, figures, numbers)) for each in reports]
    errors = ''.join(
        f'<p class="why is-error"><span class="word error">error</span> {escape(each)}</p>'
        for each in unread
    )
    # A "<" in a text must not end the element.
    data = json.dumps(figures.document(), allow_nan=False).replace('<', '\\u003c')
    return _PAGE.format(
        title=escape(_title(reports, judgement)),
        style=_resource('page.css'),
        summary=escape(_summary(reports, unread, judgement)),
        errors=errors,
        sections='\n'.join(sections),
        plotly=plotly_script(),
        data=data,
        script=_resource('drawing.js') + _resource('page.js'),
    )


_PAGE: Final = """\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
{style}</style>
</head>
<body>
<h1>Check of recordings</h1>
<p>{summary}</p>
<div class="legend">
<span><span class="key threshold"></span>threshold</span>
<span><span class="key deciding"></span>deciding state</span>
<span><span class="key window"></span>window of an obligation</span>
<span><span class="key band"></span>interval: 95 % of errors, or of a probability</span>
<span><span class="key gap"></span>gap: states may be missing</span>
<span><span class="key unknown"></span>no value</span>
<span><span class="key violation"></span>violation of a constraint</span>
</div>
{errors}
{sections}
<script type="text/plain" id="plotly">{plotly}</script>
<script type="application/json" id="data">{data}</script>
<script>
{script}</script>
</body>
</html>
"""


def _title(reports: Sequence[RecordingReport], judgement: Judgement) -> str:
    """Return the title of the tab: the number of formulas that fail, and the recordings."""
    failing = sum(not judgement.passes(each) for report in reports for each in report.formulas)
    number = f'({failing}) ' if failing else ''
    more = f' and {len(reports) - 1} more' if len(reports) > 1 else ''
    name = f'{_name(reports[0])}{more}' if reports else 'check of recordings'
    return f'{number}{name} - DyKnow'


def _name(report: RecordingReport) -> str:
    """Return the name of the file or folder of a recording."""
    return PurePath(report.recording).name or report.recording


def _summary(
    reports: Sequence[RecordingReport], unread: Sequence[str], judgement: Judgement
) -> str:
    formulas = [formula for report in reports for formula in report.formulas]
    counts = dict.fromkeys(Outcome, 0)
    for each in formulas:
        counts[each.outcome] += 1
    parts = [f'{number} {outcome}' for outcome, number in counts.items() if number]
    recordings = len(reports) + len(unread)
    passed = sum(map(judgement.passes, formulas))
    texts = [
        f'{recordings} recording{"s" * (recordings != 1)}',
        f'{passed} of {len(formulas)} formulas pass ({", ".join(parts)})' if formulas else '',
        f'{len(unread)} not checked' if unread else '',
    ]
    return ', '.join(filter(None, texts))


def _section(
    report: RecordingReport, judgement: Judgement, figures: PageFigures, numbers: Iterator[int]
) -> Iterator[str]:
    whole = extent(report)
    figures.begin_recording(whole)
    duration = round_duration(report.end_time - report.start_time)
    yield f'<section>\n<h2>{escape(_name(report))}</h2>\n'
    yield f'<p class="soft">{escape(report.recording)}: {duration}; times count from '
    yield f'{_start_text(whole)}</p>\n'
    if report.map is not None:
        yield map_image(report.map, report.formulas, whole)
    yield f'<div class="row axis"><div>{"".join(_ticks(whole))}</div></div>\n'
    # Formulas that fail come first.
    for formula in sorted(report.formulas, key=judgement.passes):
        yield _formula(formula, whole, judgement, figures, next(numbers))
    for note in report.notes:
        yield f'<p class="soft">Note: {escape(note)}</p>\n'
    yield '</section>'


def _start_text(whole: Span) -> str:
    if whole.start < _FIRST_DATE:
        return f'{whole.start / NANOSECONDS["s"]:.3f} s'
    seconds, rest = divmod(whole.start, NANOSECONDS['s'])
    date = datetime.fromtimestamp(seconds, UTC)
    return f'{date:%Y-%m-%d %H:%M:%S}.{rest // NANOSECONDS["ms"]:03} UTC'


def _ticks(whole: Span) -> Iterator[str]:
    for tick in whole.ticks:
        place = whole.place(tick)
        at_end = ' class="end"' if place > _END else ''
        text = f'{whole.since_start(tick):g} {whole.unit}'
        yield f'<span{at_end} style="left:{place:.2%}">{text}</span>'


def _formula(
    formula: FormulaReport, whole: Span, judgement: Judgement, figures: PageFigures, number: int
) -> str:
    outcome = formula.outcome
    name = '' if formula.name == formula.formula else escape(formula.name)
    shown = f'<span class="name">{name}</span>' if name else ''
    passes = judgement.passes(formula)
    is_open = '' if passes else figures.open_once()
    return (
        f'<details class="formula" data-formula="{number}"{is_open}>\n<summary class="row">'
        f'<div class="head"><span class="word {outcome}">{outcome}'
        f'<small class="{"passes" if passes else "fails"}">'
        f'{"passes" if passes else "does not pass"}</small></span>'
        f'<div>{shown}<code>{escape(formula_text(formula.formula))}</code></div></div>'
        f'<div class="strip" role="img" aria-label="{escape(_strip_text(formula, whole))}">'
        f'{"".join(_strip(formula, whole))}</div></summary>\n'
        f'<div class="body">{body(formula, whole, judgement, figures)}</div>\n</details>\n'
    )


def _strip(formula: FormulaReport, whole: Span) -> Iterator[str]:
    for each in segments(formula, whole):
        start, end = whole.place(each.span.start), whole.place(each.span.end)
        word = each.outcome if end - start >= _LABELLED else ''
        yield _mark(f'is-{each.outcome}', start, end, _segment_text(each, whole), word)
    for gap in gaps(formula, whole):
        text = f'gap from {whole.text(gap.start)} to {whole.text(gap.end)}'
        yield _mark('gap', whole.place(gap.start), whole.place(gap.end), text)
    for violation in formula.violations[:20]:
        place = whole.place(violation.valid_time)
        yield _mark('violation', place, place, f'violation at {whole.text(violation.valid_time)}')


def _mark(kind: str, start: float, end: float, title: str, word: str = '') -> str:
    # A narrow segment at the end of the line has its least width to the left of it.
    side = f'left:{start:.3%}' if start < _END else f'right:{1 - end:.3%}'
    style = f'{side};width:{end - start:.3%}'
    return f'<i class="{kind}" style="{style}" title="{escape(title)}">{word}</i>'


def _segment_text(each: OutcomeSegment, whole: Span) -> str:
    return f'{each.outcome} from {whole.text(each.span.start)} to {whole.text(each.span.end)}'


def _strip_text(formula: FormulaReport, whole: Span) -> str:
    return '; '.join(_segment_text(each, whole) for each in segments(formula, whole)[:10])


def _resource(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding='utf-8')


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
        + ''.join(_place_mark(*place, size / 80, text) for place, _, text in failures)
        + ''.join(_label(name, regions[name], size / 30) for name in sorted(named & regions.keys()))
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


def _label(name: str, geometry: Any, height: float) -> str:
    """Return the name of a region, as text above its middle."""
    (left, bottom, right, top) = geometry.bounds
    x, y = (left + right) / 2, (bottom + top) / 2 + height
    style = f'x="{x:.6g}" y="{-y:.6g}" font-size="{height:.3g}"'
    return f'<text {style}>{escape(name)}</text>'


def _track(name: str, x: Iterable[float], y: Iterable[float]) -> str:
    return f'<polyline points="{_points(x, y)}"><title>{escape(name)}</title></polyline>'


def _place_mark(x: float, y: float, radius: float, text: str) -> str:
    title = f'<title>{escape(text)}</title>'
    return f'<circle cx="{x:.6g}" cy="{-y:.6g}" r="{radius:.3g}">{title}</circle>'


def _points(x: Iterable[float], y: Iterable[float]) -> str:
    return ' '.join(f'{one:.6g},{-other:.6g}' for one, other in zip(x, y, strict=True))
