"""Streams on a terminal and as JSON."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from dyknow_common import NANOSECONDS, round_duration
from dyknow_common.tables import (
    Cell,
    ReportTable,
    details_table,
    figure,
    fixed,
    folded,
    json_document,
    named,
)
from dyknow_stream_processing.reporting.stream_report import (
    SourceReport,
    StreamReport,
    StreamState,
)
from dyknow_stream_processing.reporting.stream_users import (
    StreamUser,
    UsedTopic,
    formulas_over,
    shown_name,
)

_STYLES = {
    StreamState.FLOWING: 'green',
    StreamState.WAITING: 'yellow',
    StreamState.FAILED: 'bold red',
    StreamState.REGISTERED: 'cyan',
}

_NONE = (
    'There are no named streams; formulas over topics need none. To have some, add them to '
    '"streams" of a robot.yaml.\n'
)

_SHOWN_NS = 100 * NANOSECONDS['ms']
"""From this delay on, the table shows where a topic loses time: a sender needs some time."""

_TIMES = ('latest', 'delay', 'before_sending', 'transport')
_FIGURES = ('samples', 'rate', 'delay', 'max', 'dropped', 'violations')
_FIGURES_OF_TOPICS = ('received', 'rate', 'delay', 'lost', 'dropped')


def stream_table(
    reports: Iterable[StreamReport],
    engines: Sequence[str],
    hidden: int = 0,
    users: Collection[StreamUser] = (),
) -> RenderableType:
    """Return a table with a line for each stream, or how to make the first one.

    Args:
        reports: the reports of the streams.
        engines: the stream processing engines that run.
        hidden: the number of streams that are not shown.
        users: the formulas that are evaluated.
    """
    rows = (_row(report, users, several_engines=len(engines) > 1) for report in reports)
    columns = (named('stream'), fixed('state'), *map(figure, _FIGURES), folded())
    caption = ', '.join(engines) or 'no stream processing engine is running'
    if hidden:
        caption += f"; {hidden} of DyKnow's own streams not shown (--all shows them)"
    listed = list(rows)
    return ReportTable(columns, listed, caption=caption) if listed else Text(_NONE + caption)


def topic_table(topics: Iterable[UsedTopic]) -> RenderableType:
    """Return a table with a line for each topic that streams are made of."""
    columns = (named('topic'), *map(figure, _FIGURES_OF_TOPICS), folded('formulas'), folded())
    rows: list[list[Cell]] = [
        [
            each.source.topic,
            str(each.source.samples),
            f'{each.source.rate:.1f} Hz',
            '' if each.source.latest is None else _delay(each.source.delay),
            str(each.lost),
            str(each.dropped),
            ', '.join(each.formulas),
            each.reason.partition('\n')[0],
        ]
        for each in topics
    ]
    return ReportTable(columns, rows, texts=2) if rows else Text()


def stream_details(report: StreamReport, now: int) -> RenderableType:
    """Return everything that is known of one stream.

    Args:
        report: the report of the stream.
        now: the time of the report, nanoseconds.
    """
    table = details_table(_details(report, now))
    if not report.specification:
        return table
    return Group(table, Text(), Text(report.specification))


def as_json(report: StreamReport, users: Iterable[StreamUser] = ()) -> dict[str, Any]:
    """Return everything that is known of one stream; durations in nanoseconds, rates in Hz.

    Args:
        report: the report of the stream.
        users: the formulas that are evaluated; formulas with its samples as states are listed.
    """
    document = json_document(report, times=_TIMES)
    flow = document.pop('flow')
    for source in document['sources']:
        source['rate_hz'] = source.pop('rate')
    return {
        **document,
        'constraints': {k: v for k, v in document['constraints'].items() if v is not None},
        'formulas': formulas_over(report, users),
        'rate_hz': flow['rate'],
        'mean_delay_ns': flow['mean_delay'],
        'max_delay_ns': flow['max_delay'],
    }


def topic_as_json(used: UsedTopic) -> dict[str, Any]:
    """Return everything that is known of one topic; durations in nanoseconds, the rate in Hz."""
    document = json_document(used, times=_TIMES)
    source = document.pop('source')
    return {**source, 'rate_hz': source.pop('rate'), **document}


def _row(report: StreamReport, users: Iterable[StreamUser], *, several_engines: bool) -> list[Cell]:
    counts = report.samples, sum(report.drops.values()), report.violations
    is_flowing = report.state is StreamState.FLOWING
    # A stream that has fallen silent still has what it had before.
    samples, dropped, violations = map(str, counts) if is_flowing or any(counts) else [''] * 3
    rate = _rate(report) if is_flowing else ''
    figures = [samples, rate, *_delays(report), dropped, violations]
    if is_flowing:
        remark = report.engine if several_engines else ''
    elif report.state is StreamState.REGISTERED:
        remark = report.message or report.topic
    else:
        remark = report.message.partition('\n')[0]
    return [shown_name(report, users), _state(report), *figures, remark]


def _details(report: StreamReport, now: int) -> Iterator[tuple[str, Cell]]:
    yield 'stream', report.name
    yield 'state', _state(report)
    yield 'why', report.message
    yield 'engine', report.engine
    yield 'topic', report.topic
    yield 'type', report.message_type
    yield 'constraints', str(report.constraints)
    if report.engine:
        delay, max_delay = _delays(report)
        drops = ', '.join(f'{count} {reason}' for reason, count in sorted(report.drops.items()))
        yield 'samples', f'{report.samples} ({_rate(report)} now)'
        yield 'delay', f'{delay}, {max_delay} at most' if max_delay else delay
        yield 'dropped', drops or 'none'
        yield 'violations', str(report.violations)
        yield 'made of', '\n'.join(_source(source, now) for source in report.sources)


def _source(source: SourceReport, now: int) -> str:
    if source.latest is None:
        return f'{source.topic}: nothing has come yet'
    age = round_duration(max(0, now - source.latest))
    stamped = f', stamped {_delay(source.delay)}' if source.delay < 0 else ''
    if source.before_sending >= _SHOWN_NS:
        stamped += f', stamped {round_duration(source.before_sending)} before it was sent'
    if abs(source.transport) >= _SHOWN_NS:
        side = 'behind' if source.transport > 0 else 'ahead'
        stamped += f', clock of the sender {round_duration(abs(source.transport))} {side}'
    return f'{source.topic}: {source.samples} received, the latest {age} ago{stamped}'


def _state(report: StreamReport) -> Text:
    return Text(report.state.name.lower(), _STYLES[report.state])


def _rate(report: StreamReport) -> str:
    return f'{report.flow.rate:.1f} Hz'


def _delays(report: StreamReport) -> tuple[str, str]:
    if report.flow.rate:
        return _delay(report.flow.mean_delay), _delay(report.flow.max_delay)
    # The samples of a topic that is stamped too far ahead of the clock are dropped.
    least = min((source.delay for source in report.sources), default=0)
    return (_delay(least), '') if least < 0 else ('', '')


def _delay(nanoseconds: int) -> str:
    if nanoseconds < 0:
        return f'ahead {round_duration(-nanoseconds)}'
    return round_duration(nanoseconds)
