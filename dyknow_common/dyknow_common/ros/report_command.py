"""Commands that show what a node reports on a topic: once, or report by report."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from rich.console import Console, RenderableType
from rich.live import Live

from dyknow_common.durations import SECOND_NS
from dyknow_common.errors import DyKnowError, ExitCode
from dyknow_common.ros.commands import CommandNode, duration, run_command
from dyknow_common.ros.qos import LATCHED


class ReportListener:
    """Hears what a node reports of itself.

    Args:
        command: the node that listens.
        reporter: the one that reports; absolute or relative to the namespace of the command.
        topic: its latched topic, without the name of the node.
        message_type: of the topic.
    """

    def __init__(self, command: CommandNode, reporter: str, topic: str, message_type: Any) -> None:
        self.report: Any = None
        self.count = 0
        self._command = command
        self._suffix = f'/{topic}'
        package = message_type.__module__.partition('.')[0]
        self._type = f'{package}/msg/{message_type.__name__}'
        self._topic = command.node.resolve_topic_name(f'{reporter}{self._suffix}')
        command.node.create_subscription(message_type, self._topic, self._hear, LATCHED)

    def next(self, timeout: int) -> Any:
        """The next report.

        Args:
            timeout: how long to wait for it, nanoseconds.

        Raises:
            DyKnowError: UNAVAILABLE, when none comes in time; it says who else reports.
        """
        heard = self.count
        end = self._command.end_of_wait(timeout)
        self._command.spin_until(lambda: self.count > heard, end, lambda: self._silence(timeout))
        return self.report

    def _hear(self, report: Any) -> None:
        self.report = report
        self.count += 1

    def _silence(self, timeout: int) -> DyKnowError:
        node = self._command.node
        reporters = sorted(
            topic.removesuffix(self._suffix)
            for topic, types in node.get_topic_names_and_types()
            if self._type in types and topic != self._topic and node.count_publishers(topic)
        )
        name = self._topic.removesuffix(self._suffix)
        others = f'; there are: {", ".join(reporters)} (choose one by --node)' if reporters else ''
        return DyKnowError(
            f'nothing was heard of {name} within {timeout / SECOND_NS:g} s; is DyKnow running, in '
            f'this namespace and ROS domain?{others}',
            ExitCode.UNAVAILABLE,
        )


@dataclass(frozen=True, slots=True)
class ReportCommand:
    """A command that shows a report, or a part of it that its argument `name` names.

    Args:
        name: of the command, which is also that of the topic.
        message_type: of the topic.
        document: what is shown of a report for programs, given the part to show; empty: all.
        rendered: the same for people. Both raise NOT_FOUND, when that part is not there.
    """

    name: str
    message_type: Any
    document: Callable[[Any, str], Any]
    rendered: Callable[[Any, str], RenderableType]

    def run(self, options: Callable[[Sequence[str]], argparse.Namespace]) -> int:
        """The main function of its executable; the exit code is 2 where nobody reports."""
        return run_command(self.name, options, self._show, _exit_code)

    def _show(self, chosen: argparse.Namespace, command: CommandNode) -> None:
        listener = ReportListener(command, chosen.node, self.name, self.message_type)
        with self._teller(chosen) as tell:
            tell(listener.next(chosen.timeout))
            while chosen.watch:
                tell(listener.next(chosen.timeout))

    @contextmanager
    def _teller(self, chosen: argparse.Namespace) -> Iterator[Callable[[Any], None]]:
        """How reports are shown: as JSON, in place on a terminal, or one after the other."""
        console = Console()

        def rendered(report: Any) -> RenderableType:
            return self.rendered(report, chosen.name)

        if chosen.json:
            yield lambda report: print(  # noqa: T201 - a command
                json.dumps(self.document(report, chosen.name)), flush=True
            )
        elif chosen.watch and console.is_terminal:
            with Live(console=console, auto_refresh=False) as live:
                yield lambda report: live.update(rendered(report), refresh=True)
        else:
            yield lambda report: console.print(rendered(report))


def add_report_options(parser: argparse.ArgumentParser, reporter: str, what: str) -> None:
    """The options that all such commands have.

    Args:
        parser: is given them.
        reporter: the node that is asked by default.
        what: that node, in words.
    """
    parser.add_argument('--json', action='store_true', help='print a line of JSON a report')
    parser.add_argument('--watch', action='store_true', help='go on, report by report')
    parser.add_argument(
        '--timeout', type=duration, default='5 s', help='to wait for a report (default: 5 s)'
    )
    parser.add_argument(
        '--node', default=reporter, help=f'{what} that is asked (default: {reporter})'
    )


def _exit_code(error: DyKnowError) -> int:
    return 1 if error.code is ExitCode.NOT_FOUND else 2
