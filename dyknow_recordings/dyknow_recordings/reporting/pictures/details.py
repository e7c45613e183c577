"""The part of a page that opens below a formula: why it has its verdict, and its signals."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from html import escape
from typing import Final

from dyknow_common import with_readable_times
from dyknow_recordings.evaluation.results import Episode, FormulaReport, Outcome
from dyknow_recordings.reporting.judgement import Judgement
from dyknow_recordings.reporting.pictures.figures import PageFigures
from dyknow_recordings.reporting.pictures.panels import Panel, formula_text, marks, panels
from dyknow_recordings.reporting.pictures.timeline import (
    Span,
    episode_runs,
    gaps,
)

_MAX_ROWS: Final = 20
_FEW: Final = 2
"""The number of panels that have the whole width each."""


def body(formula: FormulaReport, whole: Span, judgement: Judgement, figures: PageFigures) -> str:
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
    text = _text(_reason(formula, episode), whole)
    if '\n' in text:  # It shows a place in the text of the formula.
        text = f'<pre>{text}</pre>'
    yield (
        f'<div class="why is-{outcome}"><span class="word {outcome}">{outcome}</span>{at}, '
        f'{verdict}: {text}</div>'
    )
    facts = [f'{formula.states} states']
    if len(formula.episodes) > 1:
        facts.append(f'{len(formula.episodes)} episodes: {_counts(formula.episodes)}')
    if formula.waits_for:
        facts.append(formula.waits_for)
    yield f'<p class="soft">{escape("; ".join(facts))}</p>'


def _reason(formula: FormulaReport, episode: Episode | None) -> str:
    if formula.error is not None:
        return formula.error.message
    if episode is None:
        return 'no episode has begun'
    return _episode_reason(episode)


def _episode_reason(episode: Episode) -> str:
    if episode.error is not None:
        return episode.error.message
    if episode.outcome is Outcome.UNDECIDED:
        return episode.remainder
    return episode.explanation


def _counts(episodes: Iterable[Episode]) -> str:
    counts = dict.fromkeys(Outcome, 0)
    for each in episodes:
        counts[each.outcome] += 1
    return ', '.join(f'{number} {outcome}' for outcome, number in counts.items() if number)


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
                _time(run.first.begin, whole),
                str(len(run.episodes)),
                f'<span class="word {run.first.outcome}">{run.first.outcome}</span>',
                _time(run.first.decided_at, whole),
                _text(_episode_reason(run.first), whole),
            )
            for run in runs[:_MAX_ROWS]
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
    return escape(with_readable_times(text, whole.start))


def _time(time: int | None, whole: Span) -> str:
    return '' if time is None else f'<span class="time">{whole.text(time)}</span>'
