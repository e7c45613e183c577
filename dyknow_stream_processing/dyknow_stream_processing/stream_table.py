"""How streams look on a terminal and as JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

from dyknow_stream_processing.account import StreamState
from dyknow_stream_processing.durations import round_duration

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rich.console import RenderableType

    from dyknow_stream_processing.account import StreamAccount

_STYLES = {
    StreamState.FLOWING: 'green',
    StreamState.WAITING: 'yellow',
    StreamState.FAILED: 'bold red',
    StreamState.REGISTERED: 'cyan',
}


def stream_table(accounts: Iterable[StreamAccount], engines: Sequence[str]) -> Table:
    """A line for each stream.

    Args:
        accounts: of the streams.
        engines: the stream processing engines that live.
    """
    running = ', '.join(engines) or 'no stream processing engine is running'
    table = Table(caption=running, box=None, pad_edge=False)
    for header in ('stream', 'state', 'engine', 'topic'):
        table.add_column(header, overflow='fold')
    for header in ('samples', 'rate', 'delay', 'max', 'dropped', 'violations'):
        table.add_column(header, justify='right', no_wrap=True)
    for account in accounts:
        table.add_row(*map(_verbatim, _row(account)))
    return table


def stream_details(account: StreamAccount) -> RenderableType:
    """Everything that is known of one stream."""
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style='dim', no_wrap=True)
    table.add_column(overflow='fold')
    for what, value in _details(account):
        table.add_row(what, _verbatim(value))
    if not account.specification:
        return table
    return Group(table, Text(), Text(account.specification))


def as_json(account: StreamAccount) -> dict[str, Any]:
    """Everything that is known of one stream; durations in nanoseconds, the rate per second."""
    document = asdict(account)
    flow = document.pop('flow')
    return {
        **document,
        'state': account.state.name,
        'constraints': {k: v for k, v in document['constraints'].items() if v is not None},
        'rate_hz': flow['rate'],
        'mean_delay_ns': flow['mean_delay'],
        'max_delay_ns': flow['max_delay'],
    }


def _row(account: StreamAccount) -> list[str | Text]:
    start: list[str | Text] = [account.name, _state(account), account.engine, account.topic]
    if account.state is StreamState.REGISTERED:
        return [*start, *[''] * 6]
    if account.state is not StreamState.FLOWING:
        return [*start[:3], account.message.partition('\n')[0], *[''] * 6]
    return [
        *start,
        str(account.samples),
        _rate(account),
        *_delays(account),
        str(sum(account.drops.values())),
        str(account.violations),
    ]


def _details(account: StreamAccount) -> list[tuple[str, str | Text]]:
    drops = ', '.join(f'{count} {reason}' for reason, count in sorted(account.drops.items()))
    delay, max_delay = _delays(account)
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
        ]
    return [(what, value) for what, value in found if value]


def _verbatim(value: str | Text) -> Text:
    """A text whose brackets mean nothing to the terminal."""
    return value if isinstance(value, Text) else Text(value)


def _state(account: StreamAccount) -> Text:
    return Text(account.state.name.lower(), _STYLES[account.state])


def _rate(account: StreamAccount) -> str:
    return f'{account.flow.rate:.1f} Hz'


def _delays(account: StreamAccount) -> tuple[str, str]:
    if not account.flow.rate:
        return '', ''
    return round_duration(account.flow.mean_delay), round_duration(account.flow.max_delay)
