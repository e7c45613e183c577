"""The streams command: what has become of each stream."""

from __future__ import annotations

import argparse
import json
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from dyknow_interfaces.msg import StreamStatusArray
from rich.console import Console
from rich.live import Live

from dyknow_stream_processing.errors import ExitCode, StreamError
from dyknow_stream_processing.ros.commands import CommandNode, duration, run_command
from dyknow_stream_processing.ros.introspection import account_from_message
from dyknow_stream_processing.ros.runtime import LATCHED
from dyknow_stream_processing.stream_table import as_json, stream_details, stream_table

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from rich.console import RenderableType

    from dyknow_stream_processing.account import StreamAccount
    from dyknow_stream_processing.errors import DyKnowError

_TYPE = 'dyknow_interfaces/msg/StreamStatusArray'


class StreamsListener:
    """Hears what a stream manager, or an engine, reports of streams.

    Args:
        command: the node that listens.
        reporter: its name, absolute or relative to the namespace of the command.
    """

    def __init__(self, command: CommandNode, reporter: str) -> None:
        self.report: Any = None
        self.count = 0
        self._command = command
        self._topic = command.node.resolve_topic_name(f'{reporter}/streams')
        command.node.create_subscription(StreamStatusArray, self._topic, self._hear, LATCHED)

    def next(self, timeout: int) -> Any:
        """The next report.

        Args:
            timeout: how long to wait for it, nanoseconds.

        Raises:
            StreamError: UNAVAILABLE, when none comes in time; it says who else reports.
        """
        heard = self.count
        end = self._command.end_of_wait(timeout)
        self._command.spin_until(lambda: self.count > heard, end, lambda: self._silence(timeout))
        return self.report

    def _hear(self, report: Any) -> None:
        self.report = report
        self.count += 1

    def _silence(self, timeout: int) -> StreamError:
        node = self._command.node
        reporters = sorted(
            topic.removesuffix('/streams')
            for topic, types in node.get_topic_names_and_types()
            if _TYPE in types and topic != self._topic and node.count_publishers(topic)
        )
        name = self._topic.removesuffix('/streams')
        others = f'; there are: {", ".join(reporters)} (choose one by --node)' if reporters else ''
        return StreamError(
            f'nothing was heard of {name} within {timeout / 1e9:g} s; is DyKnow running, in this '
            f'namespace and ROS domain?{others}',
            ExitCode.UNAVAILABLE,
        )


def show(chosen: argparse.Namespace, listener: StreamsListener) -> None:
    """Prints one report, or each as it comes.

    Raises:
        StreamError: NOT_FOUND, when the stream asked for is not there; UNAVAILABLE, when nobody
            reports in time.
    """
    with _teller(chosen) as tell:
        tell(listener.next(chosen.timeout))
        while chosen.watch:
            tell(listener.next(chosen.timeout))


@contextmanager
def _teller(chosen: argparse.Namespace) -> Iterator[Callable[[Any], None]]:
    """How reports are shown: as JSON, in place on a terminal, or one after the other."""
    console = Console()
    if chosen.json:
        yield lambda report: print(_json(chosen, report), flush=True)  # noqa: T201 - a command
    elif chosen.watch and console.is_terminal:
        with Live(console=console, auto_refresh=False) as live:
            yield lambda report: live.update(_rendered(chosen, report), refresh=True)
    else:
        yield lambda report: console.print(_rendered(chosen, report))


def _json(chosen: argparse.Namespace, report: Any) -> str:
    if chosen.name:
        return json.dumps(as_json(_find(report, chosen.name)))
    accounts = [as_json(account_from_message(status)) for status in report.streams]
    return json.dumps({'engines': list(report.engines), 'streams': accounts})


def _rendered(chosen: argparse.Namespace, report: Any) -> RenderableType:
    if chosen.name:
        return stream_details(_find(report, chosen.name))
    return stream_table(map(account_from_message, report.streams), list(report.engines))


def _find(report: Any, name: str) -> StreamAccount:
    accounts = {status.name: account_from_message(status) for status in report.streams}
    if name not in accounts:
        known = ', '.join(accounts) or 'none'
        raise StreamError(f"there is no stream '{name}' (there are: {known})", ExitCode.NOT_FOUND)
    return accounts[name]


def options(arguments: Sequence[str]) -> argparse.Namespace:
    """The options on the command line."""
    parser = argparse.ArgumentParser(
        prog='streams',
        description=f'{__doc__} Exit code 0: shown, 1: no such stream, 2: nobody reports.',
    )
    parser.add_argument('name', nargs='?', metavar='NAME', help='show all about this stream')
    parser.add_argument('--json', action='store_true', help='print a line of JSON a report')
    parser.add_argument('--watch', action='store_true', help='go on, report by report')
    parser.add_argument(
        '--timeout', type=duration, default='5 s', help='to wait for a report (default: 5 s)'
    )
    parser.add_argument(
        '--node',
        default='stream_manager',
        help='the stream manager, or the engine, that is asked (default: stream_manager)',
    )
    return parser.parse_args(arguments)


def _work(chosen: argparse.Namespace, command: CommandNode) -> None:
    show(chosen, StreamsListener(command, chosen.node))


def _exit_code(error: DyKnowError) -> int:
    return 1 if error.code is ExitCode.NOT_FOUND else 2


def main() -> int:
    """The executable streams."""
    return run_command('streams', options, _work, _exit_code)
