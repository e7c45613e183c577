"""Results of a check as tables on a terminal.

The module is imported where tables are printed alone, as rich is slow to import.
"""

from __future__ import annotations

import sys

from rich.table import Table
from rich.text import Text

from dyknow_common import date_time, round_duration, time_since, with_readable_times
from dyknow_common.tables import Terminal, figure, fixed, folded, framed_table
from dyknow_recordings.evaluation.results import FormulaReport, Outcome, RecordingReport
from dyknow_recordings.health.report import print_broken
from dyknow_recordings.reading.recording import RecordingReader
from dyknow_recordings.reporting.judgement import Judgement, reasons
from dyknow_recordings.reporting.outputs import CheckOutput
from dyknow_recordings.reporting.pictures.timeline import extent

_PLACE = '\n  '
"""What is before the line that an error quotes, with its caret."""

_STYLES = {Outcome.TRUE: 'green', Outcome.FALSE: 'red', Outcome.ERROR: 'red'}


class Tables(CheckOutput):
    """A table for each recording, on the standard output; errors go elsewhere."""

    def __init__(self, judgement: Judgement) -> None:
        self._judgement = judgement

    def add(self, report: RecordingReport) -> None:
        """Print the table of a recording."""
        table = recording_table(report, self._judgement) if report.formulas else _title(report)
        Terminal(highlight=False).print(table)
        for formula in report.formulas:
            _print_place(formula)
        print_broken(report.broken)
        sys.stdout.flush()


def recording_table(report: RecordingReport, judgement: Judgement) -> Table:
    """Return the results of one recording: a row for each formula."""
    start = extent(report).start
    has_margins = any(each.margin is not None for each in report.formulas)
    has_probabilities = any(each.probability is not None for each in report.formulas)
    margins = [folded('margin')] if has_margins else []
    margins += [folded('probability')] if has_probabilities else []
    return framed_table(
        [folded('formula'), fixed('outcome'), fixed('at'), *margins, folded('why')],
        (
            _row(
                each,
                judgement,
                start,
                has_margins=has_margins,
                has_probabilities=has_probabilities,
            )
            for each in report.formulas
        ),
        title=_title(report),
        title_justify='left',
    )


def _print_place(report: FormulaReport) -> None:
    """Print the line with the caret of an error, which a column would fold."""
    _, _, place = _reason(report).partition(_PLACE)
    if place:
        Terminal(highlight=False).print(Text(f'{report.name}:{_PLACE}{place}'), soft_wrap=True)


def _reason(report: FormulaReport) -> str:
    return '\n'.join(reasons(report))


def _title(report: RecordingReport) -> Text:
    duration = round_duration(report.end_time - report.start_time)
    return Text(f'{report.recording} ({duration} from {date_time(extent(report).start)} on)')


def print_topics(recording: RecordingReader) -> None:
    """Print the topics of a recording."""
    contents = recording.contents.items()
    rows = ((name, each.message_type, str(each.count)) for name, each in contents)
    columns = [folded('topic'), folded('message type'), figure('messages')]
    table = framed_table(columns, rows, title=Text(str(recording.path)), title_justify='left')
    Terminal(highlight=False).print(table)


def _row(
    report: FormulaReport,
    judgement: Judgement,
    start: int,
    *,
    has_margins: bool,
    has_probabilities: bool,
) -> tuple[Text, ...]:
    style = _STYLES.get(report.outcome, 'green' if judgement.passes(report) else 'red')
    decisive = report.decisive
    decided_at = None if decisive is None else decisive.decided_at
    at = '' if decided_at is None else time_since(decided_at, start)
    return (
        Text(report.name),
        Text(report.outcome, style=style),
        Text(at),
        *([Text('' if report.margin is None else str(report.margin))] if has_margins else []),
        *([Text(_probability(report))] if has_probabilities else []),
        Text(with_readable_times(_reason(report).partition(_PLACE)[0], start)),
    )


def _probability(report: FormulaReport) -> str:
    if report.probability is None or report.probability_so_far is None:
        return ''
    if report.probability == report.probability_so_far:
        return str(report.probability)
    return f'{report.probability}; so far {report.probability_so_far.bounds}'
