"""What a running monitor of formulas has found, for a second one that shows it.

`dyknow up robot.yaml` runs a `formula_monitor`. Another one for the same formulas would
evaluate each of them again, and run their triggers twice.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from collections.abc import Set as AbstractSet
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces.msg import EvaluationStatusArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from dyknow_bringup.monitored_formula import NOT_CONNECTED, WAITING, MonitoredFormula
from dyknow_bringup.processes.processes import MONITOR
from dyknow_bringup.ros.formula_monitor import MonitorNode
from dyknow_common import SECOND_NS
from dyknow_common.ros import LATCHED, STATUS, TICK_PERIOD_S, only_owner, started_at
from dyknow_configuration import RequestedFormula
from dyknow_coordinator import Answer, EvaluationPhase, EvaluationStatus, Progress, StandingVerdicts
from dyknow_coordinator.ros.reporting.evaluation_messages import status_from_message

REPORT_S: Final = 3.0
"""The longest wait for the report of a coordinator; the monitor waits for one that does not run."""

SEARCH_S: Final = 10.0
"""The longest search for the node that evaluates formulas; it ends as soon as it is found."""

STARTING_NS: Final = 30 * SECOND_NS
"""The age up to which a system may not have begun with its formulas."""

NOT_MONITORED: Final = (
    f'{MONITOR} does not evaluate it: it had its verdict some time ago, which its log has, or it '
    f'is not in the file that {MONITOR} was started with; start that anew'
)


def is_monitored(formulas: AbstractSet[str], coordinator: str) -> bool:
    """Return True if a coordinator evaluates formulas of these names for a running monitor.

    A process discovers one node after the other: where formulas are evaluated, it waits until the
    monitor is found that may have asked for them; and where a monitor starts with the system, until
    it has asked. ROS must be initialised.
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
    node: Node, executor: SingleThreadedExecutor, formulas: AbstractSet[str], coordinator: str
) -> bool:
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
        return [each for report in reports for each in report.evaluations if each.name in formulas]

    def is_there() -> bool:
        return sought in node.get_node_names_and_namespaces()

    waits_until(lambda: bool(reports and starts), REPORT_S)
    is_new = time.time_ns() - max(starts, default=0) < STARTING_NS
    if is_new and not named() and waits_until(is_there, REPORT_S):
        waits_until(lambda: bool(named()), SEARCH_S)
    is_running = any(each.phase != EvaluationPhase.ENDED for each in named())
    return bool(named()) and waits_until(is_there, SEARCH_S if is_running else REPORT_S)


class AttachedMonitor(MonitorNode):
    """Keeps the outcomes of formulas that a running monitor evaluates, by their names.

    Args:
        formulas: that the other monitor was started with.
        on_change: called with every formula whose outcome has changed.
        name: of the node.
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
        self.create_subscription(
            EvaluationStatusArray,
            f'{self.coordinator}/evaluations',
            self._on_evaluations,
            LATCHED,
            refusal=only_owner,
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """None: the triggers are those of the other monitor."""
        return ()

    @property
    def is_connected(self) -> bool:
        """True if the coordinator has reported what it evaluates."""
        return self._has_report

    def explain_wait(self, hint: str) -> None:
        """Report why there is no report; of a formula that is not in it, that is said once."""
        if not self._has_report:
            super().explain_wait(hint)

    @property
    def has_ended(self) -> bool:
        """True if all formulas have a verdict: after an error, the other monitor tries again."""
        return len(self._decided) == len(self.formulas)

    def cancel_all(self) -> None:
        """Leave the evaluations to the other monitor."""
        self._decided.update(each.name for each in self.formulas)

    def _on_evaluations(self, report: Any) -> None:
        self._has_report = True
        statuses = map(status_from_message, report.evaluations)
        latest = {each.name: each for each in sorted(statuses, key=lambda each: each.started)}
        for monitored in self.formulas:
            status = latest.get(monitored.name)
            if status is not None:
                self._follow_evaluation(monitored, status)
            elif monitored.outcome == NOT_CONNECTED:
                self.explain(monitored, NOT_MONITORED)

    def _follow_evaluation(self, monitored: MonitoredFormula, status: EvaluationStatus) -> None:
        if self.started.get(monitored.name) != status.started:
            self.started[monitored.name] = status.started
            monitored.verdicts = StandingVerdicts()
        is_new = monitored.outcome == NOT_CONNECTED
        if is_new:
            monitored.outcome, monitored.explanation = WAITING, ''
        if status.phase is not EvaluationPhase.ENDED:
            self.note_progress(monitored, _progress(status))
        elif monitored.name not in self._decided:
            # The first report is of a verdict that the other monitor had before.
            self.note_answer(
                monitored, _answer(status), known_at=status.decided_at if is_new else None
            )
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
