"""Monitor the formulas of a file with the stream reasoning coordinator, all at once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rclpy.task import Future

from dyknow_bringup.demonstration.expectations import MonitoredFormula
from dyknow_bringup.demonstration.formulas import load_formulas
from dyknow_bringup.resources import formulas_path
from dyknow_common import SECOND_NS, ExitCode, round_time
from dyknow_common.ros import DyKnowNode, run
from dyknow_coordinator import Answer
from dyknow_coordinator.ros import FormulaClient, Monitor

RETRIED = (ExitCode.UNAVAILABLE, ExitCode.NOT_FOUND)
"""Errors worth retrying while the other nodes are still starting."""

START_UP_NS = 10 * SECOND_NS
"""Time that the other nodes may take to start after the coordinator."""

RETRY_DELAY_S = 0.5
"""Time until a formula is monitored again after an error worth retrying."""


class FormulaMonitor(DyKnowNode):
    """A client that monitors each formula by a MonitorFormula action, and keeps its outcome.

    Args:
        on_change: called with every formula that gets an outcome; None: it is logged.
    """

    def __init__(self, on_change: Callable[[MonitoredFormula], None] | None = None) -> None:
        super().__init__('formula_monitor')
        path = self.parameter('formulas', str(formulas_path()), 'YAML file with the formulas.')
        self._timeout = self.parameter(
            'timeout', 86_400.0, 'Seconds after which the monitoring of a formula ends.', (0.1, 1e9)
        )
        coordinator = self.parameter(
            'coordinator', 'stream_reasoning_coordinator', 'Name of the coordinator node.'
        )
        self.formulas = [MonitoredFormula(formula) for formula in load_formulas(Path(path))]
        self._on_change = on_change or self._log
        self._client = FormulaClient(self, coordinator)
        self._retry_until: int | None = None
        self._monitors: dict[str, Monitor] = {}
        for monitored in self.formulas:
            self._start(monitored).accepted.add_done_callback(self._on_start)

    @property
    def is_running(self) -> bool:
        """True if the coordinator monitors all formulas."""
        return all(monitor.accepted.done() for monitor in self._monitors.values())

    @property
    def has_ended(self) -> bool:
        """True if the monitoring of all formulas has ended."""
        return all(monitor.outcome.done() for monitor in self._monitors.values())

    def cancel_all(self) -> None:
        """Cancel the monitoring of all formulas."""
        for monitor in self._monitors.values():
            monitor.cancel()

    def destroy_node(self) -> None:
        """Cancel the evaluations and destroy the node."""
        self._client.close()
        super().destroy_node()

    def _on_start(self, _: Future) -> None:
        if self._retry_until is None:
            self._retry_until = self.now() + START_UP_NS

    def _start(self, monitored: MonitoredFormula) -> Monitor:
        monitor = self._monitors[monitored.formula.name] = self._client.monitor(
            monitored.formula.formula,
            on_verdict=lambda answer: self._on_verdict(monitored, answer),
            name=monitored.formula.name,
            timeout=self._timeout,
            wait=self._timeout,
        )
        return monitor

    def _on_verdict(self, monitored: MonitoredFormula, answer: Answer) -> None:
        error = answer.error
        if error is None:
            monitored.outcome = answer.verdict.name.lower()
            monitored.explanation = answer.explanation
        elif error.code is ExitCode.CANCELLED:
            return
        elif error.code in RETRIED and self.now() < (self._retry_until or 0):
            self.deadlines.after(RETRY_DELAY_S).add_done_callback(lambda _: self._start(monitored))
            return
        else:
            monitored.outcome = error.code.name
            monitored.explanation = error.message
        monitored.known_at = self.now()
        self._on_change(monitored)

    def _log(self, monitored: MonitoredFormula) -> None:
        logger = self.get_logger()
        # A formula that is not violated in its time ends with TIMEOUT.
        is_alarm = monitored.outcome not in {'true', ExitCode.TIMEOUT.name}
        text = (
            f'{monitored.formula.name}: {monitored.outcome} '
            f'at {round_time(monitored.known_at or 0)}: {monitored.explanation}'
        )
        # A logger of rclpy has one severity for each call in the code.
        if is_alarm:
            logger.warning(text)
        else:
            logger.info(text)


def main() -> int:
    """Run the executable formula_monitor."""
    return run(FormulaMonitor)
