"""Results of a check as one page: interactive, self-contained, and readable without scripts."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from html import escape
from importlib import resources
from itertools import count
from pathlib import PurePath
from typing import Final

from dyknow_common import NANOSECONDS, round_duration, with_readable_times
from dyknow_recordings.evaluation.results import FormulaReport, Outcome, RecordingReport
from dyknow_recordings.reporting.judgement import Judgement
from dyknow_recordings.reporting.pictures.details import body
from dyknow_recordings.reporting.pictures.figures import PageFigures
from dyknow_recordings.reporting.pictures.libraries import plotly_script
from dyknow_recordings.reporting.pictures.maps import map_image
from dyknow_recordings.reporting.pictures.panels import formula_text
from dyknow_recordings.reporting.pictures.timeline import (
    OutcomeSegment,
    Span,
    extent,
    gaps,
    segments,
)

_FIRST_DATE: Final = 1_000_000_000 * NANOSECONDS['s']
"""Earlier times come from a simulation that starts at zero; they are no dates."""

_END: Final = 0.95
"""The place on the line from which on there is room to the left only."""

_LABELLED: Final = 0.2
"""The share of the line from which on a segment has room for its word."""


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
        yield f'<p class="soft">Note: {escape(with_readable_times(note, whole.start))}</p>\n'
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
