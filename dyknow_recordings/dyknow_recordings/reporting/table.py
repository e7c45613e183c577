"""Results of a check, and the health of recordings, as tables on a terminal.

The module is imported where tables are printed alone, as rich is slow to import.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final

from rich.table import Table
from rich.text import Text

from dyknow_common import date_time, round_duration, round_time, time_since, with_readable_times
from dyknow_common.tables import (
    ReportTable,
    Terminal,
    figure,
    fixed,
    folded,
    framed_table,
    json_document,
    named,
)
from dyknow_recordings.evaluation.results import FormulaReport, Outcome, RecordingReport
from dyknow_recordings.health import BrokenExpectation, RecordingHealth, TopicHealth
from dyknow_recordings.reading.recording import RecordingReader
from dyknow_recordings.reporting.judgement import Judgement, reasons
from dyknow_recordings.reporting.outputs import CheckOutput
from dyknow_recordings.reporting.pictures.timeline import extent

_PLACE = '\n  '
"""What is before the line that an error quotes, with its caret."""

_STYLES = {Outcome.TRUE: 'green', Outcome.FALSE: 'red', Outcome.ERROR: 'red'}

_TIMES: Final = frozenset({
    'start', 'end', 'begin', 'gap', 'gap_begin', 'gap_end', 'offset', 'offset_spread', 'duration',
    'interval', 'least_interval', 'greatest_interval', 'jitter', 'delays', 'lead', 'silence',
})  # fmt: skip
"""The fields in nanoseconds."""


RETRY_HINT: Final = (
    'a formula has ended with an error before the end; --retry evaluates it again after it'
)


class Tables(CheckOutput):
    """A table for each recording, on the standard output; errors go elsewhere.

    Args:
        judgement: the judgement of undecided formulas.
        may_retry: True to name the option --retry if it may help.
    """

    def __init__(self, judgement: Judgement, *, may_retry: bool = False) -> None:
        self._judgement = judgement
        self._may_retry, self._hint = may_retry, ''

    def add(self, report: RecordingReport) -> None:
        """Print the table of a recording."""
        table = recording_table(report, self._judgement) if report.formulas else _title(report)
        Terminal(highlight=False).print(table)
        for formula in report.formulas:
            _print_place(formula)
        print_broken(report.broken)
        if self._may_retry and report.ends_early:
            self._hint = RETRY_HINT
        sys.stdout.flush()

    def close(self, unchecked: Sequence[str]) -> None:  # noqa: ARG002
        """Print the hint, once for all recordings."""
        if self._hint:
            sys.stdout.write(f'{self._hint}\n')


def recording_table(report: RecordingReport, judgement: Judgement) -> Table:
    """Return the results of one recording: a row for each formula."""
    start = extent(report).origin
    measures = {'margin': _margin, 'probability': _probability}
    shown = {name: text for name, text in measures.items() if any(map(text, report.formulas))}
    return framed_table(
        [folded('formula'), fixed('outcome'), fixed('at'), *map(folded, shown), folded('why')],
        (
            _row(each, judgement, start, [text(each) for text in shown.values()])
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
    return Text(f'{report.recording} ({duration} from {date_time(extent(report).origin)} on)')


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
    measures: Iterable[str],
) -> tuple[Text, ...]:
    style = _STYLES.get(report.outcome, 'green' if judgement.passes(report) else 'red')
    decisive = report.decisive
    decided_at = None if decisive is None else decisive.decided_at
    at = '' if decided_at is None else time_since(decided_at, start)
    return (
        Text(report.name),
        Text(report.outcome_text, style=style),
        Text(at),
        *map(Text, measures),
        Text(with_readable_times(_reason(report).partition(_PLACE)[0], start)),
    )


def _margin(report: FormulaReport) -> str:
    return '' if report.margin is None else str(report.margin)


def _probability(report: FormulaReport) -> str:
    if report.probability is None or report.probability_so_far is None:
        return ''
    if report.probability == report.probability_so_far:
        return str(report.probability)
    return f'{report.probability}; so far {report.probability_so_far.bounds}'


def health_document(health: RecordingHealth) -> dict[str, Any]:
    """Return the health of a recording as a line of JSON."""
    return {**json_document(health, _TIMES), 'error': None}


def print_health(health: RecordingHealth) -> None:
    """Print a table of the topics, and the expectations that are broken."""
    duration = round_duration(health.end - health.start)
    columns = [
        named('topic'),
        *map(figure, ('messages', 'rate', 'jitter', 'gap', 'at', 'delay', 'greatest')),
        folded('type and faults'),
    ]
    rows = [_health_row(each, health.start) for each in health.health]
    title = Text(f'{health.recording} ({duration} from {date_time(health.start)} on)')
    Terminal(highlight=False).print(title, ReportTable(columns, rows), sep='\n')
    print_broken(health.broken_expectations)
    sys.stdout.flush()


def print_broken(found: Iterable[BrokenExpectation]) -> None:
    """Print the expectations that a recording breaks."""
    for each in found:
        Terminal(highlight=False).print(Text(str(each), style='red'))


def _health_row(topic: TopicHealth, start: int) -> Sequence[str]:
    timing, text = topic.timing, '; '.join([topic.message_type, *_remarks(topic)])
    if timing is None or topic.gap is None or topic.gap_begin is None:
        return (topic.topic, str(topic.messages), *6 * ('',), text)
    jitter = '' if timing.interval is None else round_duration(timing.jitter)
    delays = () if timing.delays is None else (timing.delays[0], timing.delays[-1])
    return (
        topic.topic,
        str(topic.messages),
        '' if timing.rate is None else f'{timing.rate:.3g} Hz',
        jitter,
        round_duration(topic.gap),
        round_time(topic.gap_begin - start),
        *(map(round_duration, delays) if delays else ('', '')),
        text,
    )


def _remarks(topic: TopicHealth) -> Iterator[str]:
    if topic.timing is not None:
        numbers = {
            'without a stamp': topic.unstamped or 0,
            f'stamped ahead by up to {round_duration(topic.timing.lead)}': topic.stamped_ahead,
            'out of order': topic.timing.disorders,
            'missing by the sequence numbers': topic.missing,
        }
        if topic.unstamped is None:
            yield 'no stamp'
        elif topic.timing.delays is None:
            yield 'stamps of another clock'
        yield from (f'{number} {text}' for text, number in numbers.items() if number)
    yield from topic.faults
    if topic.offset is not None and topic.offset_spread is not None:
        distance, spread = map(round_duration, (abs(topic.offset), topic.offset_spread))
        side = 'after' if topic.offset >= 0 else 'before'
        yield f'{distance} {side} {topic.offset_from}, give or take {spread}'
