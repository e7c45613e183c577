"""Results of a check as one page: interactive, self-contained, and readable without scripts."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from html import escape
from importlib import resources
from itertools import count
from pathlib import PurePath
from typing import Any, Final

from dyknow_common import NANOSECONDS, round_duration, with_readable_times
from dyknow_recordings.evaluation.observation import Signal
from dyknow_recordings.evaluation.results import FormulaReport, RecordingReport
from dyknow_recordings.reporting.judgement import Judgement, episode_counts, outcome_counts
from dyknow_recordings.reporting.outputs import optional_library
from dyknow_recordings.reporting.pictures.maps import map_image
from dyknow_recordings.reporting.pictures.panels import (
    Marks,
    Panel,
    formula_text,
    last_shown,
    marks,
    panels,
)
from dyknow_recordings.reporting.pictures.timeline import (
    OutcomeSegment,
    Span,
    episode_runs,
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

_MAX_ROWS: Final = 20
_FEW: Final = 2
"""The number of panels that have the whole width each."""

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

_MARGIN: Final = 0.01
"""The share of the time that is left free at both sides."""


def report_page(
    reports: Sequence[RecordingReport], unread: Sequence[str], judgement: Judgement
) -> str:
    """Return the page.

    Args:
        reports: the reports of the recordings.
        unread: why the other recordings were not checked.
        judgement: the judgement of undecided formulas.
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
    recordings = len(reports) + len(unread)
    passed = sum(map(judgement.passes, formulas))
    texts = [
        f'{recordings} recording{"s" * (recordings != 1)}',
        f'{passed} of {len(formulas)} formulas pass ({outcome_counts(formulas)})'
        if formulas
        else '',
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
        yield f'<p class="soft">Note: {escape(with_readable_times(note, whole.origin))}</p>\n'
    yield '</section>'


def _start_text(whole: Span) -> str:
    if whole.origin < _FIRST_DATE:
        return f'{whole.origin / NANOSECONDS["s"]:.3f} s'
    seconds, rest = divmod(whole.origin, NANOSECONDS['s'])
    date = datetime.fromtimestamp(seconds, UTC)
    return f'{date:%Y-%m-%d %H:%M:%S}.{rest // NANOSECONDS["ms"]:03} UTC'


def _ticks(whole: Span) -> Iterator[str]:
    for tick in whole.ticks:
        place = whole.place(tick)
        at_end = ' class="end"' if place > _END else ''
        text = f'{whole.since_origin(tick):g} {whole.unit}'
        yield f'<span{at_end} style="left:{place:.2%}">{text}</span>'


def _formula(
    formula: FormulaReport, whole: Span, judgement: Judgement, figures: PageFigures, number: int
) -> str:
    outcome, word = formula.outcome, formula.outcome_text
    name = '' if formula.name == formula.formula else escape(formula.name)
    shown = f'<span class="name">{name}</span>' if name else ''
    passes = judgement.passes(formula)
    is_open = '' if passes else figures.open_once()
    return (
        f'<details class="formula" data-formula="{number}"{is_open}>\n<summary class="row">'
        f'<div class="head"><span class="word {outcome}">{word}'
        f'<small class="{"passes" if passes else "fails"}">'
        f'{"passes" if passes else "does not pass"}</small></span>'
        f'<div>{shown}<code>{escape(formula_text(formula.formula))}</code></div></div>'
        f'<div class="strip" role="img" aria-label="{escape(_strip_text(formula, whole))}">'
        f'{"".join(_strip(formula, whole))}</div></summary>\n'
        f'<div class="body">{_body(formula, whole, judgement, figures)}</div>\n</details>\n'
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


def _body(formula: FormulaReport, whole: Span, judgement: Judgement, figures: PageFigures) -> str:
    """Return the content, and add its figures."""
    found, omitted = panels(formula)
    figures.add(found, marks(formula, whole))
    return ''.join(
        [
            f'<p><code>{escape(formula_text(formula.formula))}</code></p>',
            *_reasons(formula, whole, judgement),
            *_figures(found, omitted, formula),
            *_episodes(formula, whole),
            *_streams(formula, whole),
        ]
    )


def _reasons(formula: FormulaReport, whole: Span, judgement: Judgement) -> Iterator[str]:
    """Yield why the formula has its outcome."""
    outcome = formula.outcome
    verdict = 'passes' if judgement.passes(formula) else 'does not pass'
    episode = formula.decisive
    at = ''
    if episode is not None and episode.decided_at is not None:
        at = f' at {whole.text(episode.decided_at)}'
    text = _text(formula.reason, whole)
    if '\n' in text:  # It shows a place in the text of the formula.
        text = f'<pre>{text}</pre>'
    yield (
        f'<div class="why is-{outcome}"><span class="word {outcome}">{formula.outcome_text}</span>'
        f'{at}, {verdict}: {text}</div>'
    )
    facts = [f'{formula.states} states']
    if len(formula.episodes) > 1:
        facts.append(episode_counts(formula))
    if formula.waits_for:
        facts.append(formula.waits_for)
    yield f'<p class="soft">{escape("; ".join(facts))}</p>'


def _figures(found: Sequence[Panel], omitted: int, formula: FormulaReport) -> Iterator[str]:
    if not found:
        return
    few = ' few' if len(found) <= _FEW else ''
    yield f'<div class="panels{few}">'
    for number, each in enumerate(found):
        objects = f'<b>{escape(each.objects)}</b>' if each.objects else ''
        deciding = f' <span class="word {formula.outcome}">decides</span>' * (
            each.is_decisive and bool(objects)
        )
        signals = ''.join(
            f'<span class="signal">{escape(name)}</span>'
            for name in ([one.name for one in each.signals] or each.atoms)
        )
        yield (
            f'<figure><figcaption>{objects}{deciding} <span>{signals}</span></figcaption>'
            f'<div class="plot" data-panel="{number}"></div></figure>'
        )
    yield '</div>'
    hidden = omitted + (formula.signals.omitted if formula.signals else 0)
    if hidden:
        yield f'<p class="soft">{hidden} more are not shown</p>'


def _episodes(formula: FormulaReport, whole: Span) -> Iterator[str]:
    if len(formula.episodes) <= 1:
        return
    runs = episode_runs(formula)
    yield '<h3>Episodes</h3>'
    yield from _table(
        ('begin', 'episodes', 'outcome', 'first decided', 'why the first'),
        (
            (
                _time(first.begin, whole),
                str(1 + len(others)),
                f'<span class="word {first.outcome}">{first.outcome}</span>',
                _time(first.decided_at, whole),
                _text(first.reason, whole),
            )
            for first, *others in runs[:_MAX_ROWS]
        ),
        len(runs) - _MAX_ROWS,
    )


def _streams(formula: FormulaReport, whole: Span) -> Iterator[str]:
    """Yield gaps, violations and changes of streams."""
    if found := gaps(formula, whole):
        yield '<h3>Gaps</h3>'
        rows = ((_time(each.start, whole), _time(each.end, whole)) for each in found)
        yield from _table(('after', 'before'), rows, len(formula.gaps) - len(found))
    if formula.violations:
        yield '<h3>Violations</h3>'
        yield from _table(
            ('time', 'stream', 'violation'),
            (
                (
                    _time(each.valid_time, whole),
                    f'<code>{escape(each.stream_name)}</code>',
                    _text(each.message, whole),
                )
                for each in formula.violations[:_MAX_ROWS]
            ),
            len(formula.violations) - _MAX_ROWS,
        )
    if formula.events:
        yield '<h3>Changes of streams</h3>'
        yield ''.join(f'<p>{_text(each, whole)}</p>' for each in formula.events[:_MAX_ROWS])
    if formula.groundings:
        yield '<h3>Streams</h3>'
        rows_of = (
            (f'<code>{escape(str(each.symbol))}</code>', f'<code>{escape(each.stream)}</code>')
            for each in formula.groundings[:_MAX_ROWS]
        )
        more = len(formula.groundings) - _MAX_ROWS
        yield from _table(('feature', 'stream'), rows_of, more)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]], more: int) -> Iterator[str]:
    yield '<div class="scroll"><table><tr>'
    yield ''.join(f'<th>{each}</th>' for each in head)
    yield '</tr>'
    for row in rows:
        yield f'<tr>{"".join(f"<td>{each}</td>" for each in row)}</tr>'
    yield '</table></div>'
    if more > 0:
        yield f'<p class="soft">{more} more</p>'


def _text(text: str, whole: Span) -> str:
    return escape(with_readable_times(text, whole.origin))


def _time(time: int | None, whole: Span) -> str:
    return '' if time is None else f'<span class="time">{whole.text(time)}</span>'


class PageFigures:
    """Collects the panels of all formulas; signals of several formulas are stored once."""

    def __init__(self) -> None:
        self._signals: list[dict[str, Any]] = []
        # The signals are kept, so that their ids stay theirs.
        self._indices: dict[int, tuple[int, Signal]] = {}
        self._formulas: list[dict[str, Any]] = []
        self._units: list[str] = []
        self._whole = Span(0, 1)
        self._is_any_open = False

    def open_once(self) -> str:
        """Return the attribute that opens the details of a formula, for the first call alone."""
        is_first, self._is_any_open = not self._is_any_open, True
        return ' open' if is_first else ''

    def begin_recording(self, whole: Span) -> None:
        """Begin the formulas of another recording."""
        self._whole = whole
        self._units.append(whole.unit)

    def add(self, panels: list[Panel], marks: Marks) -> None:
        """Add a formula."""
        start, end = map(self._time, (self._whole.start, last_shown(self._whole, marks)))
        margin = _MARGIN * (end - start)
        self._formulas.append(
            {
                'recording': len(self._units) - 1,
                'range': [start - margin, end + margin],
                'panels': [self._panel(each) for each in panels],
                'marks': self._marks(marks),
            }
        )

    def document(self) -> dict[str, Any]:
        """Return all data."""
        return {'signals': self._signals, 'formulas': self._formulas, 'unit': self._units}

    def _panel(self, panel: Panel) -> dict[str, Any]:
        return {
            'is_decisive': panel.is_decisive,
            'unit': escape(panel.unit),
            'signals': [self._signal(each) for each in panel.signals],
            'relations': [escape(each) for each in panel.relations],
            'thresholds': [
                {'value': each.value, 'text': escape(each.text)} for each in panel.thresholds
            ],
        }

    def _marks(self, marks: Marks) -> dict[str, Any]:
        return {
            'deciding': [
                {
                    'time': self._time(each.time),
                    'verdict': each.verdict,
                    'values': {escape(name): _number(value) for name, value in each.values.items()},
                }
                for each in marks.deciding
            ],
            'windows': [self._span(each) for each in marks.windows],
            'pending': [self._span(each) for each in marks.pending],
            'gaps': [self._span(each) for each in marks.gaps],
            'unknown': self._named(marks.unknown),
            'held': self._named(marks.held),
            'violations': [self._time(each) for each in marks.violations],
        }

    def _signal(self, signal: Signal) -> int:
        if id(signal) not in self._indices:
            self._indices[id(signal)] = len(self._signals), signal
            self._signals.append(
                {
                    'name': escape(signal.name),
                    't': [self._time(int(each)) for each in signal.times],
                    **lines(signal),
                    'words': [escape(each) for each in signal.words],
                }
            )
        return self._indices[id(signal)][0]

    def _named(self, spans: Mapping[str, Sequence[Span]]) -> dict[str, list[list[float]]]:
        return {escape(name): [*map(self._span, found)] for name, found in spans.items() if found}

    def _span(self, span: Span) -> list[float]:
        return [self._time(span.start), self._time(span.end)]

    def _time(self, time: int) -> float:
        return round(self._whole.since_origin(time), 6)


def lines(signal: Signal, first: int = 0) -> dict[str, list[float | None]]:
    """Return the values of a signal and the ends of its band from a point on, for scripts."""
    low, high = signal.band or ((), ())
    named = {'v': signal.values, 'low': low, 'high': high}
    return {name: [_number(float(each)) for each in line[first:]] for name, line in named.items()}


def _number(value: float) -> float | None:
    """Return a number with the digits that can be seen; None for a missing one."""
    return float(f'{value:.7g}') if math.isfinite(value) else None


def plotly_script() -> str:
    """Return the JavaScript of plotly.

    Raises:
        RecordingError: naming the mend, if plotly is not installed.
    """
    script: str = optional_library('plotly.offline', '--html').get_plotlyjs()
    return script
