"""The command `dyknow monitor`: monitors the formulas of a robot.yaml, with a live table."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rich.live import Live

from dyknow_bringup.demonstration.expectations import HOLDS, VIOLATED, MonitoredFormula
from dyknow_bringup.demonstration.tables import formula_table
from dyknow_bringup.errors import BringupError
from dyknow_bringup.ros.formula_monitor import FormulaMonitor
from dyknow_bringup.simulation.scenario import UNDECIDED
from dyknow_common import SECOND_NS, duration_option
from dyknow_common.executables import ERROR, FALSE, SUCCESS, describe, interruptible
from dyknow_common.ros import TICK_PERIOD_S, start_ros
from dyknow_common.tables import Terminal
from dyknow_configuration import RequestedFormula, read_robot, warn_of_notes

COORDINATOR_TIMEOUT_S = 10.0
"""Time to wait for the coordinator, which may just have been started."""

REFRESH_PERIOD_S = 0.25
"""The time between two tables on a terminal."""

END_TIMEOUT_S = 3.0
"""Time to wait until the coordinator has ended the evaluations."""

CODES = {'true': SUCCESS, HOLDS: SUCCESS, UNDECIDED: SUCCESS, 'false': FALSE, VIOLATED: FALSE}
"""The exit codes of outcomes; those of others are ERROR."""


def monitor(options: argparse.Namespace) -> int:
    """Monitor the formulas of a file until a signal, or until all have a verdict."""
    formulas = read_robot(options.robot).formulas
    if not formulas:
        raise BringupError(f"{options.robot}: there is no formula; add one under 'formulas'")
    warn_of_notes(each.text for each in formulas)
    console = Terminal()
    is_live = console.is_terminal and not options.json
    with _watching(options, formulas, is_live=is_live) as watch:
        with (
            suppress(KeyboardInterrupt),
            interruptible(),
            Live(console=console, auto_refresh=False) if is_live else nullcontext() as live,
        ):
            for table in watch.tables():
                if live is not None:
                    live.update(table, refresh=True)
        watch.end()
        if not options.json and not is_live:
            console.print(watch.table())
        return watch.code


class _MonitorRun:
    """A monitor of formulas that runs for some time.

    Args:
        monitor: the node.
        duration: how long to run, in nanoseconds; None: until all formulas have ended.
    """

    def __init__(self, monitor: FormulaMonitor, duration: int | None) -> None:
        self._monitor = monitor
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(monitor)
        self._begin = monitor.now()
        self._end = None if duration is None else time.monotonic() + duration / SECOND_NS

    def tables(self) -> Iterator[Any]:
        """Run, and yield the present table every REFRESH_PERIOD_S, and at the end."""
        due = 0.0
        while not self._monitor.has_ended and (self._end is None or time.monotonic() < self._end):
            self._executor.spin_once(timeout_sec=TICK_PERIOD_S)
            if time.monotonic() > due:
                due = time.monotonic() + REFRESH_PERIOD_S
                yield self.table()
        yield self.table()

    def table(self) -> Any:
        """Return the table of all formulas."""
        now = self._monitor.now()
        return formula_table(self._monitor.formulas, self._begin, now - self._begin)

    def end(self) -> None:
        """End the evaluations."""
        self._monitor.cancel_all()
        limit = time.monotonic() + END_TIMEOUT_S
        while not self._monitor.has_ended and time.monotonic() < limit:
            self._executor.spin_once(timeout_sec=TICK_PERIOD_S)

    def close(self) -> None:
        """Leave the ROS graph."""
        self._executor.shutdown()
        self._monitor.destroy_node()

    @property
    def code(self) -> int:
        """The exit code: that of the worst outcome; at least FALSE if a formula was false once."""
        outcomes = (CODES.get(each.outcome, ERROR) for each in self._monitor.formulas)
        has_failed = any(each.has_failed for each in self._monitor.formulas)
        return max(FALSE if has_failed else SUCCESS, *outcomes)


@contextmanager
def _watching(
    options: argparse.Namespace, formulas: tuple[RequestedFormula, ...], *, is_live: bool
) -> Iterator[_MonitorRun]:
    parameters = ['-p', f'coordinator:={json.dumps(options.coordinator)}', '-p', 'timeout:=1.0e+9']
    # Lines of the log would disturb the table; they are still on /rosout.
    quiet = ['--disable-stdout-logs'] if is_live else []
    start_ros([*sys.argv, '--ros-args', *parameters, *quiet])
    try:
        node = FormulaMonitor(
            formulas,
            lambda monitored: _report(node, monitored, as_json=options.json),
            name=f'dyknow_monitor_{os.getpid()}',
            wait=None if options.retry else COORDINATOR_TIMEOUT_S,
            retries=options.retry,
        )
        for warning in node.warnings if is_live else ():
            sys.stderr.write(f'warning: {warning}\n')
        watch = _MonitorRun(node, options.duration)
        try:
            yield watch
        finally:
            watch.close()
    finally:
        rclpy.try_shutdown()


def _report(node: FormulaMonitor, monitored: MonitoredFormula, *, as_json: bool) -> None:
    node.log(monitored)
    if as_json:
        document = {
            'name': monitored.name,
            'formula': monitored.formula.text,
            'severity': monitored.formula.severity,
            'outcome': monitored.outcome,
            'time_ns': node.now(),
            'explanation': monitored.explanation,
        }
        if monitored.margin is not None:
            document['margin'] = monitored.margin.document
        print(json.dumps(document), flush=True)  # noqa: T201 - this is a command


def add_monitor_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.set_defaults(command=monitor)
    describe(
        parser,
        'Monitor the formulas of a robot.yaml with the running system, which "dyknow up '
        'robot.yaml" starts. A formula that is false is logged as a warning or an error, as its '
        'severity says. Ends by Ctrl-C, or when all formulas have a verdict.',
        (
            'dyknow monitor robot.yaml',
            'dyknow monitor robot.yaml --retry',
            'dyknow monitor robot.yaml --duration 60 --json',
        ),
        '0 if no formula was false, 1 if one was, 2 for an error',
    )
    parser.add_argument('robot', type=Path, help='robot.yaml, which describes the robot')
    parser.add_argument(
        '--duration', type=duration_option, metavar='TIME', help="such as 60 or '5 min'"
    )
    parser.add_argument(
        '--retry',
        action='store_true',
        help='monitor a formula again after an error, such as a stream that broke its constraints',
    )
    parser.add_argument('--coordinator', default='stream_reasoning_coordinator', metavar='NODE')
    parser.add_argument('--json', action='store_true', help='print a line of JSON for each change')
