"""Results of a check as one image, for documents."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from typing import Any, Final
from warnings import catch_warnings, filterwarnings

import numpy as np

from dyknow_common import NANOSECONDS, printable, shortened
from dyknow_recordings.evaluation.results import FormulaReport, Outcome, RecordingReport
from dyknow_recordings.reporting.judgement import Judgement
from dyknow_recordings.reporting.outputs import optional_library
from dyknow_recordings.reporting.pictures.panels import Marks, Panel, last_shown, marks, panels
from dyknow_recordings.reporting.pictures.timeline import Span, extent, gaps, segments

_FILLS: Final = {
    Outcome.TRUE: ('#4db89a', ''),
    Outcome.FALSE: ('#e8834a', '///'),
    Outcome.ERROR: ('#b07fd0', '|||'),
    Outcome.UNDECIDED: ('#c9cfd6', ''),
}
_SIGNALS: Final = ('#0067a5', '#a86a00', '#5a55c0')
_ORANGE: Final = '#c04800'
_WINDOW: Final = '#56b4e9'
_MAX_PANELS: Final = 3
"""The panels of a formula in an image; a page has more."""
_MAX_ROWS: Final = 60
_MAX_NAME: Final = 80
_STRIP_INCHES: Final = 0.62
_PANEL_INCHES: Final = 1.5
_FRAME_INCHES: Final = 0.7
"""The height of a panel without its rows of relations."""
_RELATION_INCHES: Final = 0.16
_WIDTH_INCHES: Final = 9.0
_LABELLED: Final = 0.12
"""The share of the line from which on a segment has room for its word."""


def report_image(reports: Sequence[RecordingReport], judgement: Judgement) -> bytes:
    """Return an image (PNG) of the verdicts over time and the decisive signals.

    Raises:
        RecordingError: if matplotlib is not installed.
    """
    figure_class = optional_library('matplotlib.figure', '--png').Figure
    rows = _rows(reports)
    shown = rows[:_MAX_ROWS]
    heights = [_STRIP_INCHES if panel is None else _panel_inches(panel) for _, _, panel in shown]
    figure = figure_class(figsize=(_WIDTH_INCHES, max(sum(heights), 1.0)), layout='constrained')
    grid = figure.subplots(max(len(shown), 1), 1, squeeze=False, height_ratios=heights or [1.0])
    recording = None
    for axes, (report, formula, panel) in zip(grid[:, 0], shown, strict=False):
        whole = extent(report)
        found = marks(formula, whole)
        if panel is None:
            heading = '' if report is recording else report.recording
            recording = report
            passes = 'passes' if judgement.passes(formula) else 'does not pass'
            title = f'{shortened(formula.name, _MAX_NAME)}: {formula.outcome_text}, {passes}'
            _draw_strip(axes, formula, whole, f'{heading}\n{title}' if heading else title)
        else:
            _draw_panel(axes, panel, found, whole)
        axes.set_xlim(*_ends(Span(whole.start, last_shown(whole, found)), whole))
    if not shown:
        grid[0, 0].set_axis_off()
        grid[0, 0].text(0, 0.5, 'no recording could be read')
    if len(rows) > len(shown):
        figure.supxlabel(f'{len(rows) - len(shown)} more rows are not shown', fontsize=8)
    content = BytesIO()
    with catch_warnings():
        filterwarnings('ignore', 'Glyph')  # Where the font lacks one, there is a box.
        figure.savefig(content, dpi=150, format='png')
    return content.getvalue()


def _panel_inches(panel: Panel) -> float:
    return max(_PANEL_INCHES, _FRAME_INCHES + _RELATION_INCHES * len(panel.relations))


def _rows(
    reports: Sequence[RecordingReport],
) -> list[tuple[RecordingReport, FormulaReport, Panel | None]]:
    """Return a row for each verdict, and for each panel below it."""
    rows: list[tuple[RecordingReport, FormulaReport, Panel | None]] = []
    for report in reports:
        for formula in report.formulas:
            rows.append((report, formula, None))
            rows += [(report, formula, each) for each in panels(formula)[0][:_MAX_PANELS]]
    return rows


def _draw_strip(axes: Any, formula: FormulaReport, whole: Span, title: str) -> None:
    axes.set_yticks([])
    axes.set_ylim(0, 1)
    axes.tick_params(labelbottom=False, bottom=False)
    for each in segments(formula, whole):
        start, end = map(whole.since_origin, (each.span.start, each.span.end))
        color, hatch = _FILLS[each.outcome]
        axes.axvspan(start, end, facecolor=color, hatch=hatch, edgecolor='white', linewidth=0)
        if whole.place(each.span.end) - whole.place(each.span.start) > _LABELLED:
            text = f' {each.outcome}'
            axes.text(start, 0.5, text, ha='left', va='center', fontsize=8)
    for gap in gaps(formula, whole):
        axes.axvspan(*_ends(gap, whole), facecolor='white', hatch='xxx', edgecolor='black')
    for violation in formula.violations:
        axes.axvline(whole.since_origin(violation.valid_time), color='black', linewidth=2)
    _set_title(axes, title, weight='bold')


def _draw_panel(axes: Any, panel: Panel, found: Marks, whole: Span) -> None:
    axes.margins(y=0.12)
    for signal, color in zip(panel.signals, _SIGNALS, strict=False):
        times = (signal.times - whole.origin) / NANOSECONDS[whole.unit]
        style = 'steps-post' if signal.words else 'default'
        axes.plot(times, signal.values, color=color, linewidth=1.2, drawstyle=style)
        if signal.band is not None:
            axes.fill_between(times, *signal.band, color=color, alpha=0.25, linewidth=0.6)
        if signal.words:
            axes.set_yticks(
                range(len(signal.words)), [_plain(printable(each)) for each in signal.words]
            )
    if panel.relations:
        _draw_relations(axes, panel.relations, found, whole)
    for threshold in panel.thresholds:
        axes.axhline(threshold.value, color=_ORANGE, linestyle='--', linewidth=1.2)
        axes.annotate(
            threshold.text, (1, threshold.value), xycoords=('axes fraction', 'data'),
            xytext=(3, 0), textcoords='offset points', va='center', fontsize=8, color=_ORANGE,
        )  # fmt: skip
    windows = found.windows if panel.is_decisive else ()
    for window in (*windows, *found.pending):
        axes.axvspan(*_ends(window, whole), color=_WINDOW, alpha=0.25, linewidth=0)
    for gap in found.gaps:
        axes.axvspan(*_ends(gap, whole), color='grey', alpha=0.35, linewidth=0)
    for span in (span for each in panel.signals for span in found.unknown.get(each.name, ())):
        axes.axvspan(
            *_ends(span, whole), facecolor='none', hatch='///', edgecolor='grey', linewidth=0
        )
    for time in found.violations:
        axes.axvline(whole.since_origin(time), color=_FILLS[Outcome.ERROR][0], linestyle=':')
    _draw_deciding_states(axes, panel, found, whole)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.3)
    axes.set_xlabel(f'time ({whole.unit})', fontsize=8)
    axes.set_ylabel(_plain(panel.unit), fontsize=8)
    names = ', '.join([each.name for each in panel.signals] or panel.atoms)
    _set_title(axes, f'{panel.objects}: {names}' if panel.objects else names)


def _draw_relations(axes: Any, relations: Sequence[str], found: Marks, whole: Span) -> None:
    for row, relation in enumerate(relations):
        for span in found.held[relation]:
            axes.plot(_ends(span, whole), [row, row], color=_SIGNALS[0], linewidth=5, marker='|')
    axes.set_yticks(range(len(relations)), [_plain(each) for each in relations])
    axes.invert_yaxis()


def _draw_deciding_states(axes: Any, panel: Panel, found: Marks, whole: Span) -> None:
    for state in found.deciding:
        time = whole.since_origin(state.time)
        axes.axvline(time, color=_ORANGE, linewidth=1.2)
        if not panel.is_decisive:
            continue
        values = [state.values.get(each.name, np.nan) for each in panel.signals]
        axes.plot([time] * len(values), values, 'D', color=_ORANGE, markersize=5)


def _set_title(axes: Any, text: str, weight: str = 'normal') -> None:
    axes.set_title(_plain(text), fontsize=8, loc='left', fontweight=weight)


def _ends(span: Span, whole: Span) -> tuple[float, float]:
    return whole.since_origin(span.start), whole.since_origin(span.end)


def _plain(text: str) -> str:
    """Return a text that matplotlib does not take for mathematics."""
    return text.replace('$', r'\$')
