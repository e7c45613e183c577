"""How streams look on a terminal and as JSON."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from dyknow_common import round_duration
from dyknow_stream_processing.reporting.stream_report import (
    SourceReport,
    StreamReport,
    StreamState,
)

_STYLES = {
    StreamState.FLOWING: 'green',
    StreamState.WAITING: 'yellow',
    StreamState.FAILED: 'bold red',
    StreamState.REGISTERED: 'cyan',
}


_FIGURES = ('samples', 'rate', 'delay', 'max', 'dropped', 'violations')


def stream_table(accounts: Iterable[StreamReport], engines: Sequence[str]) -> Table:
    """A line for each stream.

    Args:
        accounts: of the streams.
        engines: the stream processing engines that live.
    """
    running = ', '.join(engines) or 'no stream processing engine is running'
    table = Table(caption=running, box=None, pad_edge=False)
    for header in ('stream', 'state'):
        table.add_column(header, no_wrap=True)
    for header in _FIGURES:
        table.add_column(header, justify='right', no_wrap=True)
    table.add_column('', overflow='fold')
    for account in accounts:
        figures = (
            _figures(account) if account.state is StreamState.FLOWING else [''] * len(_FIGURES)
        )
        remark = _remark(account, several_engines=len(engines) > 1)
        table.add_row(account.name, _state(account), *figures, _verbatim(remark))
    return table


def stream_details(account: StreamReport, now: int) -> RenderableType:
    """Everything that is known of one stream.

    Args:
        account: of the stream.
        now: when that was reported, nanoseconds.
    """
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style='dim', no_wrap=True)
    table.add_column(overflow='fold')
    for what, value in _details(account, now):
        table.add_row(what, _verbatim(value))
    if not account.specification:
        return table
    return Group(table, Text(), Text(account.specification))


def as_json(account: StreamReport) -> dict[str, Any]:
    """Everything that is known of one stream; durations in nanoseconds, the rate per second."""
    document = asdict(account)
    flow = document.pop('flow')
    for source in document['sources']:
        source['latest_ns'] = source.pop('latest')
    return {
        **document,
        'state': account.state.name,
        'constraints': {k: v for k, v in document['constraints'].items() if v is not None},
        'rate_hz': flow['rate'],
        'mean_delay_ns': flow['mean_delay'],
        'max_delay_ns': flow['max_delay'],
    }


def _remark(account: StreamReport, *, several_engines: bool) -> str:
    """Where a stream comes from, or why it does not."""
    if account.state is StreamState.FLOWING:
        return account.engine if several_engines else ''
    if account.state is StreamState.REGISTERED:
        return account.topic
    return account.message.partition('\n')[0]


def _figures(account: StreamReport) -> list[str]:
    return [
        str(account.samples),
        _rate(account),
        *_delays(account),
        str(sum(account.drops.values())),
        str(account.violations),
    ]


def _details(account: StreamReport, now: int) -> list[tuple[str, str | Text]]:
    drops = ', '.join(f'{count} {reason}' for reason, count in sorted(account.drops.items()))
    delay, max_delay = _delays(account)
    sources = '\n'.join(_source(source, now) for source in account.sources)
    found: list[tuple[str, str | Text]] = [
        ('stream', account.name),
        ('state', _state(account)),
        ('why', account.message),
        ('engine', account.engine),
        ('topic', account.topic),
        ('type', account.message_type),
        ('constraints', str(account.constraints)),
    ]
    if account.state is StreamState.FLOWING:
        found += [
            ('samples', f'{account.samples} ({_rate(account)} now)'),
            ('delay', f'{delay}, {max_delay} at most' if delay else ''),
            ('dropped', drops or 'none'),
            ('violations', str(account.violations)),
            ('made of', sources),
        ]
    return [(what, value) for what, value in found if value]


def _source(source: SourceReport, now: int) -> str:
    if source.latest is None:
        return f'{source.topic}: nothing has come yet'
    age = round_duration(max(0, now - source.latest))
    return f'{source.topic}: {source.samples} received, the latest {age} ago'


def _verbatim(value: str | Text) -> Text:
    """A text whose brackets mean nothing to the terminal."""
    return value if isinstance(value, Text) else Text(value)


def _state(account: StreamReport) -> Text:
    return Text(account.state.name.lower(), _STYLES[account.state])


def _rate(account: StreamReport) -> str:
    return f'{account.flow.rate:.1f} Hz'


def _delays(account: StreamReport) -> tuple[str, str]:
    if not account.flow.rate:
        return '', ''
    return round_duration(account.flow.mean_delay), round_duration(account.flow.max_delay)
