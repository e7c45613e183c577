"""Commands that show the reports of a node on a topic: the last one, or each new one."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from typing import Any, Final

from rich.console import RenderableType
from rich.live import Live

from dyknow_common.durations import SECOND_NS, add_utc_option, duration_option
from dyknow_common.errors import DyKnowError, ExitCode
from dyknow_common.ros.commands import CommandNode, run_with_node
from dyknow_common.ros.qos import LATCHED
from dyknow_common.tables import Terminal

_PATIENCE_NS: Final = SECOND_NS // 2
"""The longest wait for a report of another node, which may not run."""


@dataclass(frozen=True, slots=True)
class ReportCommand:
    """A command that shows a report, or the part of it that its argument `name` names.

    Args:
        name: the name of the command and of the topic, which is latched.
        message_type: the message type of the topic.
        document: makes the JSON document of a report, given the options of the command.
        rendered: the same for a terminal. Both raise NOT_FOUND, if there is no part of the name in
            the options.
        beside: the topic, relative to the namespace, and the type of a latched report of another
            node; the functions are given a pair of both then, with None if there is no other one.
        is_fresh: True to wait for the second report, as the first one was latched at some time; the
            node must publish each second while there is a subscriber.
    """

    name: str
    message_type: Any
    document: Callable[[Any, argparse.Namespace], Any]
    rendered: Callable[[Any, argparse.Namespace], RenderableType]
    beside: tuple[str, Any] | None = None
    is_fresh: bool = False

    def __call__(self, options: argparse.Namespace) -> int:
        """Run the command and return its exit code."""
        return run_with_node(self.name, lambda node: self._show(options, node))

    def _show(self, options: argparse.Namespace, command: CommandNode) -> None:
        reports = _Reports(command, f'{options.node}/{self.name}', self.message_type)
        other = None if self.beside is None else _Reports(command, *self.beside)
        if self.is_fresh:
            reports.next(options.timeout)
        console = Terminal()
        is_live = options.watch and console.is_terminal and not options.json
        with Live(console=console, auto_refresh=False) if is_live else nullcontext() as live:
            while True:
                report = reports.next(options.timeout)
                if other is not None:
                    report = report, other.latest()
                if options.json:
                    print(json.dumps(self.document(report, options)), flush=True)  # noqa: T201
                elif live:
                    live.update(self.rendered(report, options), refresh=True)
                else:
                    console.print(self.rendered(report, options))
                if not options.watch:
                    return


class _Reports:
    """The reports on a topic, relative to the namespace of the command or absolute."""

    def __init__(self, command: CommandNode, topic: str, message_type: Any) -> None:
        self._command = command
        self._report: Any = None
        self._patience_ns = _PATIENCE_NS
        self._topic = command.node.resolve_topic_name(topic)
        self._type = f'{message_type.__module__.partition(".")[0]}/msg/{message_type.__name__}'
        command.node.create_subscription(message_type, self._topic, self._on_report, LATCHED)

    def next(self, timeout_ns: int) -> Any:
        """Return the next report.

        Raises:
            DyKnowError: UNAVAILABLE, if there is none in time; it names other nodes that report.
        """
        self._report = None
        self._wait(timeout_ns)
        return self._report

    def latest(self) -> Any:
        """Return the latest report; the first call waits for one, None if none comes soon."""
        if self._patience_ns:
            with suppress(DyKnowError):
                self._wait(self._patience_ns)
            self._patience_ns = 0
        return self._report

    def _wait(self, timeout_ns: int) -> None:
        self._command.spin_until(
            lambda: self._report is not None,
            self._command.deadline(timeout_ns),
            lambda: self._no_report(timeout_ns),
        )

    def _on_report(self, report: Any) -> None:
        self._report = report

    def _no_report(self, timeout_ns: int) -> DyKnowError:
        node = self._command.node
        name, _, suffix = self._topic.rpartition('/')
        others = sorted(
            topic.removesuffix(f'/{suffix}')
            for topic, types in node.get_topic_names_and_types()
            if topic.endswith(f'/{suffix}')
            and self._type in types
            and topic != self._topic
            and node.count_publishers(topic)
        )
        hint = f'; there are: {", ".join(others)} (choose one by --node)' if others else ''
        lack = '' if node.count_publishers(self._topic) else ', as no such node runs'
        return DyKnowError(
            f'no report of {name} within {timeout_ns / SECOND_NS:g} s{lack}; is DyKnow running, in '
            f'this namespace and ROS domain?{hint}',
            ExitCode.UNAVAILABLE,
        )


def add_report_options(parser: argparse.ArgumentParser, node: str, role: str) -> None:
    """Add the options that all commands of this kind have.

    Args:
        parser: the parser of the command.
        node: the default node.
        role: the role of that node, in words.
    """
    parser.add_argument('--json', action='store_true', help='print a line of JSON for each report')
    add_utc_option(parser)
    parser.add_argument('--watch', action='store_true', help='show each new report')
    parser.add_argument(
        '--timeout', type=duration_option, default='5 s', help='to wait for a report (default: 5 s)'
    )
    parser.add_argument('--node', default=node, help=f'{role} that reports (default: {node})')
