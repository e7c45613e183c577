"""The command `dyknow monitor`: monitors the formulas of a robot.yaml, with a live table.

`dyknow up robot.yaml` runs a `formula_monitor`. Another one for the same formulas would evaluate
each of them again, and run their triggers twice. So the command then shows what the running monitor
has found. Reports do not name the client of an evaluation: while a `formula_monitor` runs, the
command also shows formulas that another client evaluates, such as another `dyknow monitor`.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, Final

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces.msg import EvaluationStatusArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rich.live import Live

from dyknow_bringup.errors import BringupError
from dyknow_bringup.monitored_formula import (
    HOLDS,
    NOT_CONNECTED,
    UNDECIDED,
    VIOLATED,
    WAITING,
    MonitoredFormula,
    formula_table,
    identity,
    is_any_evaluated,
)
from dyknow_bringup.processes.processes import MONITOR, NO_TIMEOUT_S
from dyknow_bringup.ros.formula_monitor import FormulaMonitor, MonitorNode
from dyknow_bringup.ros.system_start import where_coordinators_are
from dyknow_common import SECOND_NS, ExitCode, add_utc_option, duration_option, round_duration
from dyknow_common.executables import ERROR, FALSE, SUCCESS, describe, interruptible
from dyknow_common.ros import LATCHED, STATUS, TICK_PERIOD_S, RemoteNode, start_ros, started_at
from dyknow_common.tables import Terminal
from dyknow_configuration import RequestedFormula, read_robot, warn_of_notes
from dyknow_coordinator import Answer, EvaluationPhase, EvaluationStatus, Progress, StandingVerdicts
from dyknow_coordinator.ros.reporting.evaluation_messages import status_from_message
from dyknow_reactions.ros.triggers import find_target_faults

REPORT_S: Final = 5.0
"""The longest wait for the report of a coordinator; the monitor waits for one that does not run.

A process whose answer to an announcement is lost is discovered up to 3 s later.
"""

SEARCH_S: Final = 10.0
"""The longest search for the node that evaluates formulas; it ends as soon as it is found."""

STARTING_NS: Final = 30 * SECOND_NS
"""Until this age, a system may not have begun with its formulas yet."""

NOT_MONITORED: Final = (
    f'{MONITOR} does not evaluate it: it has not begun yet, it had its verdict some time ago, '
    f'which its log has, or it is not in the file that {MONITOR} was started with; start that anew'
)

NOT_RUNNING: Final = (
    'the coordinator does not answer any more: it has ended or was stopped; unless "dyknow up" '
    'still runs and restarts it, start "dyknow up" again'
)

NOTICE_S = 3.0
"""Time without a connection after which a warning says what is waited for."""

REFRESH_PERIOD_S = 0.25
"""The time between two tables on a terminal."""

MAX_NAMED = 3
"""The formulas that an error names."""

FIRST_STATES_S = 10.0
"""Time from the connection on in which the first states of all formulas may come."""

END_TIMEOUT_S = 3.0
"""Time to wait until the coordinator has ended the evaluations."""

CODES = {'true': SUCCESS, HOLDS: SUCCESS, UNDECIDED: SUCCESS, 'false': FALSE, VIOLATED: FALSE}
"""The exit codes of outcomes; all others have ERROR."""


def is_monitored(formulas: Sequence[MonitoredFormula], coordinator: str) -> bool:
    """Return True if a coordinator evaluates one of some formulas for a running monitor.

    A process discovers one node after the other: where formulas are evaluated, it waits until the
    monitor is found that may have asked for them; and where a monitor starts with the system, until
    it has asked. ROS must be initialised.

    Raises:
        BringupError: if it evaluates another formula of the same name.
    """
    node = Node(f'dyknow_monitor_search_{os.getpid()}', start_parameter_services=False)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        return _finds_monitor(node, executor, formulas, coordinator)
    finally:
        executor.shutdown()
        node.destroy_node()


def _finds_monitor(
    node: Node,
    executor: SingleThreadedExecutor,
    formulas: Sequence[MonitoredFormula],
    coordinator: str,
) -> bool:
    names = {each.identity[0] for each in formulas}
    reports: list[Any] = []
    starts: list[int] = []
    topic = node.resolve_topic_name(f'{coordinator}/evaluations')
    sought = MONITOR, topic.rsplit('/', 2)[0] or '/'
    node.create_subscription(EvaluationStatusArray, topic, reports.append, LATCHED)
    node.create_subscription(
        DiagnosticStatus,
        f'{coordinator}/_status',
        lambda status: starts.append(started_at(status)),
        STATUS,
    )

    def waits_until(condition: Callable[[], bool], limit_s: float) -> bool:
        end = time.monotonic() + limit_s
        while not condition() and time.monotonic() < end:
            executor.spin_once(timeout_sec=TICK_PERIOD_S)
        return condition()

    def named() -> list[Any]:
        return [each for report in reports for each in report.evaluations if each.name in names]

    def is_there() -> bool:
        return sought in node.get_node_names_and_namespaces()

    waits_until(lambda: bool(reports and starts), REPORT_S)
    is_new = time.time_ns() - max(starts, default=0) < STARTING_NS
    if is_new and not named() and waits_until(is_there, REPORT_S):
        waits_until(lambda: bool(named()), SEARCH_S)
    is_running = any(each.phase != EvaluationPhase.ENDED for each in named())
    is_found = bool(named()) and waits_until(is_there, SEARCH_S if is_running else REPORT_S)
    return is_found and is_any_evaluated(formulas, map(status_from_message, named()))


class AttachedMonitor(MonitorNode):
    """Keeps the outcomes of formulas that a running monitor evaluates.

    Args:
        formulas: the formulas that the other monitor was started with.
        on_change: called with every formula whose outcome has changed.
        name: the name of the node.
    """

    def __init__(
        self,
        formulas: Sequence[RequestedFormula],
        on_change: Callable[[MonitoredFormula], None],
        *,
        name: str,
    ) -> None:
        super().__init__(name, on_change)
        self.formulas = [MonitoredFormula(formula) for formula in formulas]
        self.started: dict[str, int] = {}
        """When the evaluations of the formulas began, by name, nanoseconds."""
        self._decided: set[str] = set()
        self._has_report = False
        # After a loss of the coordinator, the states in the first report on each formula.
        self._states_before: dict[str, int | None] = {}
        coordinator = RemoteNode(self, self.coordinator)
        coordinator.on_lost.append(self._on_lost)
        self.create_report_subscription(
            EvaluationStatusArray, f'{self.coordinator}/evaluations', self._on_evaluations
        )

    @property
    def is_connected(self) -> bool:
        """True if the coordinator has reported what it evaluates."""
        return self._has_report

    def explain_wait(self, hint: str) -> None:
        """Explain a missing report; formulas that a report lacks are explained once, elsewhere."""
        if not self._has_report:
            super().explain_wait(hint)

    @property
    def has_ended(self) -> bool:
        """True if all formulas have a verdict: after an error, the other monitor tries again."""
        return len(self._decided) == len(self.formulas)

    def cancel_all(self) -> None:
        """Leave the evaluations to the other monitor."""
        self._decided.update(each.name for each in self.formulas)

    def _on_lost(self) -> None:
        self._states_before = {each.name: None for each in self.formulas}
        self._disconnect(self.formulas, NOT_RUNNING)

    def _is_outdated(self, name: str, status: EvaluationStatus) -> bool:
        """Return True if a coordinator that was stopped reports what it knew before.

        An alarm stays until a state shows that the formula holds again.
        """
        is_running = status.phase is EvaluationPhase.RUNNING
        is_violated = status.episodes is not None and status.episodes.is_violated
        if name not in self._states_before or not is_running or is_violated:
            return False
        before = self._states_before[name]
        if self.started.get(name) != status.started:
            return False
        self._states_before[name] = status.states_progressed
        return before in {None, status.states_progressed}

    def _on_evaluations(self, report: Any) -> None:
        self._has_report = True
        statuses = map(status_from_message, report.evaluations)
        latest = {identity(each): each for each in sorted(statuses, key=lambda each: each.started)}
        for monitored in self.formulas:
            status = latest.get(monitored.identity)
            if status is not None:
                self._follow_evaluation(monitored, status)
            else:
                self._disconnect([monitored], NOT_MONITORED)

    def _disconnect(self, formulas: Sequence[MonitoredFormula], reason: str) -> None:
        """Note that formulas are not evaluated any more, if they have no verdict."""
        for each in formulas:
            if each.name not in self._decided:
                each.outcome, each.known_at = NOT_CONNECTED, None
                self.explain(each, reason)

    def _follow_evaluation(self, monitored: MonitoredFormula, status: EvaluationStatus) -> None:
        if self._is_outdated(monitored.name, status):
            return
        self._states_before.pop(monitored.name, None)
        if self.started.get(monitored.name) != status.started:
            self.started[monitored.name] = status.started
            self._decided.discard(monitored.name)
            monitored.verdicts = StandingVerdicts()
        is_new = monitored.outcome == NOT_CONNECTED
        if is_new:
            monitored.outcome, monitored.explanation = WAITING, ''
        if status.phase is not EvaluationPhase.ENDED:
            # Episodes in the first report may have passed long ago.
            self.note_progress(monitored, _progress(status), is_past=is_new)
        elif monitored.name not in self._decided:
            # The first report is of a verdict that the other monitor had before.
            self.note_answer(monitored, _answer(status), is_past=is_new)
            if status.error is None:
                self._decided.add(monitored.name)


def _progress(status: EvaluationStatus) -> Progress:
    return Progress(
        status.states_progressed,
        status.latest_valid_time or 0,
        status.residual_formula,
        status.presumably_false,
        waits_for=status.waits_for,
        margin=status.margin,
        probability=status.probability,
        episodes=status.episodes,
    )


def _answer(status: EvaluationStatus) -> Answer:
    return Answer(
        status.verdict,
        status.decided_at,
        status.formula,
        status.explanation,
        margin=status.margin,
        error=status.error,
        episodes=status.episodes,
    )


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
        watch.check_states()
        return watch.code


class _MonitorRun:
    """A monitor of formulas that runs for some time.

    Args:
        monitor: the node.
        wait: the longest wait for the coordinator, in nanoseconds; None: without end.
        duration: how long to run, in nanoseconds, from when all formulas have had a state, at the
            latest from FIRST_STATES_S after the connection; None: until all have ended.
    """

    def __init__(
        self, monitor: FormulaMonitor | AttachedMonitor, wait: int | None, duration: int | None
    ) -> None:
        self._monitor = monitor
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(monitor)
        self._wait, self._duration = wait, duration
        self._begin, self._begin_ns = time.monotonic(), monitor.now()
        self._connected_at: float | None = None
        self._started_at: float | None = None

    def tables(self) -> Iterator[Any]:
        """Run, and yield the present table every REFRESH_PERIOD_S, and at the end.

        Raises:
            BringupError: UNAVAILABLE, if the coordinator is not found in time.
        """
        due = 0.0
        while not (self._monitor.has_ended or self._is_over()):
            self._executor.spin_once(timeout_sec=TICK_PERIOD_S)
            if time.monotonic() > due:
                due = time.monotonic() + REFRESH_PERIOD_S
                yield self.table()
        yield self.table()

    def _is_over(self) -> bool:
        now = time.monotonic()
        if self._connected_at is None:
            if not self._monitor.is_connected:
                self._check_wait(now - self._begin)
                return False
            self._connected_at = now
        if self._started_at is None:
            if self._monitor.idle and now - self._connected_at < FIRST_STATES_S:
                return False
            self._started_at = now
        return self._duration is not None and now - self._started_at > self._duration / SECOND_NS

    def _check_wait(self, waited_s: float) -> None:
        name = self._monitor.coordinator
        if self._wait is not None and waited_s > self._wait / SECOND_NS:
            hint = where_coordinators_are(self._monitor, name)
            text = f'not connected: {name} has not been found within {round_duration(self._wait)}'
            raise BringupError(f'{text}{hint}', ExitCode.UNAVAILABLE)
        if waited_s > NOTICE_S:
            self._monitor.explain_wait(where_coordinators_are(self._monitor, name))

    def table(self) -> Any:
        """Return the table of all formulas."""
        now, begin = self._monitor.now(), self._begin_ns
        if isinstance(self._monitor, AttachedMonitor):
            begin = min([begin, *self._monitor.started.values()])
        return formula_table(self._monitor.formulas, begin, now - begin)

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

    def check_states(self) -> None:
        """Check that each formula had a state, and does not wait for states at the end.

        Raises:
            BringupError: UNAVAILABLE, if one had none and no error says why, or waits.
        """
        idle = self._monitor.idle
        waiting = idle or [each for each in self._monitor.formulas if each.outcome == WAITING]
        if waiting:
            named = [f"'{each.name}' ({each.waits_for or each.outcome})" for each in waiting]
            more = f', and {len(named) - MAX_NAMED} more' if len(named) > MAX_NAMED else ''
            fault = 'no state came for' if idle else 'not known at the end:'
            text = f'{fault} {", ".join(named[:MAX_NAMED])}{more}'
            raise BringupError(text, ExitCode.UNAVAILABLE)

    @property
    def code(self) -> int:
        """The exit code of the worst outcome; at least FALSE if a formula was false once."""
        outcomes = (CODES.get(each.outcome, ERROR) for each in self._monitor.formulas)
        has_failed = any(each.has_failed for each in self._monitor.formulas)
        return max(FALSE if has_failed else SUCCESS, *outcomes)


@contextmanager
def _watching(
    options: argparse.Namespace, formulas: tuple[RequestedFormula, ...], *, is_live: bool
) -> Iterator[_MonitorRun]:
    parameters = [
        '-p',
        f'coordinator:={json.dumps(options.coordinator)}',
        '-p',
        f'timeout:={NO_TIMEOUT_S}',
    ]
    # Lines of the log would disturb the table; they are still on /rosout.
    quiet = ['--disable-stdout-logs'] if is_live else []
    # The last of several values counts: one of the command line.
    start_ros(['--ros-args', *parameters, *quiet, '--', *sys.argv])
    try:
        node: FormulaMonitor | AttachedMonitor
        name = f'dyknow_monitor_{os.getpid()}'

        def report(monitored: MonitoredFormula) -> None:
            _report(node, monitored, as_json=options.json)

        if is_monitored([MonitoredFormula(each) for each in formulas], options.coordinator):
            # A report does not name the client of an evaluation.
            sys.stderr.write(
                'formulas are shown as the system evaluates them already, for '
                f'{MONITOR} or another client\n'
            )
            node = AttachedMonitor(formulas, report, name=name)
        else:
            node = FormulaMonitor(formulas, report, name=name, retries=options.retry)
        watch = _MonitorRun(node, options.wait, options.duration)
        try:
            if isinstance(node, FormulaMonitor):
                _check_targets(node, formulas)
            yield watch
        finally:
            watch.close()
    finally:
        rclpy.try_shutdown()


def _check_targets(node: FormulaMonitor, formulas: tuple[RequestedFormula, ...]) -> None:
    """Refuse triggers whose targets have another type; warn of triggers without a target."""
    for fault in find_target_faults(node, formulas):
        if not fault.is_missing:
            raise fault.error
        sys.stderr.write(f'warning: {fault.warning}\n')


def _report(node: MonitorNode, monitored: MonitoredFormula, *, as_json: bool) -> None:
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
        if monitored.probability is not None:
            document['probability'] = monitored.probability.document
        print(json.dumps(document), flush=True)  # noqa: T201 - this is a command


def add_monitor_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.set_defaults(command=monitor)
    describe(
        parser,
        'Monitor the formulas of a robot.yaml with the running system, which "dyknow up '
        'robot.yaml" starts. A formula that is false is logged as a warning or an error, as its '
        'severity says. Waits for the system. Ends by Ctrl-C, or when all formulas have a verdict. '
        'If "dyknow up" monitors them already, shows what it finds.',
        (
            'dyknow monitor robot.yaml',
            'dyknow monitor robot.yaml --retry',
            'dyknow monitor robot.yaml --wait 30 --duration 60 --json',
        ),
        '0 if no formula was false, 1 if one was, 2 for an error, or for a formula that waits for '
        'states at the end',
    )
    parser.add_argument('robot', type=Path, help='robot.yaml, which describes the robot')
    parser.add_argument(
        '--wait',
        type=duration_option,
        metavar='TIME',
        help='for the system, such as 30, after which the exit code is 2 (default: without end)',
    )
    parser.add_argument(
        '--duration',
        type=duration_option,
        metavar='TIME',
        help="such as 60 or '5 min', from when all formulas have had a state; at the latest from "
        f'{FIRST_STATES_S:g} s after the connection',
    )
    parser.add_argument(
        '--retry',
        action='store_true',
        help='monitor a formula again after an error, such as a stream that broke its constraints',
    )
    parser.add_argument('--coordinator', default='stream_reasoning_coordinator', metavar='NODE')
    parser.add_argument('--json', action='store_true', help='print a line of JSON for each change')
    add_utc_option(parser)
