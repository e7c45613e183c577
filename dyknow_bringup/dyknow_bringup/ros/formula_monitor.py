"""Asks the stream reasoning coordinator about the formulas of a file, all at once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rclpy.task import Future

from dyknow_bringup.demonstration.expectations import VERDICTS, MonitoredFormula
from dyknow_bringup.demonstration.formulas import load_formulas
from dyknow_bringup.resources import formulas_path
from dyknow_common import ExitCode, round_time
from dyknow_common.ros import DyKnowNode, run
from dyknow_coordinator import Answer, Progress
from dyknow_coordinator.ros import FormulaClient, Monitor

PASSING = (ExitCode.UNAVAILABLE, ExitCode.NOT_FOUND)
"""What may pass while the other nodes are still starting."""

START_UP = 10_000_000_000
"""Nanoseconds in which other nodes may still be starting when the coordinator is there."""

RETRY_PERIOD = 0.5
"""Seconds until a formula is asked again."""


class FormulaMonitor(DyKnowNode):
    """Keeps a MonitorFormula action going for each formula, and what is known of it.

    Args:
        on_change: is told of every formula that has an outcome now.
    """

    def __init__(self, on_change: Callable[[MonitoredFormula], None] | None = None) -> None:
        super().__init__('formula_monitor')
        path = self.parameter('formulas', str(formulas_path()), 'YAML file with the formulas.')
        self._timeout = self.parameter(
            'timeout', 86_400.0, 'Seconds after which a formula is given up.', (0.1, 1e9)
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
            self._start(monitored).taken.add_done_callback(self._note_start)

    @property
    def is_running(self) -> bool:
        """Whether the coordinator has taken on all formulas."""
        return all(monitor.taken.done() for monitor in self._monitors.values())

    def cancel_all(self) -> Future:
        """Lets the coordinator forget the formulas; the future is done when it has."""
        cancelled: Future = Future()
        pending = [monitor.outcome for monitor in self._monitors.values()]

        def note(_: Future) -> None:
            if all(each.done() for each in pending) and not cancelled.done():
                cancelled.set_result(None)

        for monitor in self._monitors.values():
            monitor.cancel()
        for each in pending:
            each.add_done_callback(note)
        return cancelled

    def destroy_node(self) -> None:
        """Ends the evaluations too."""
        self._client.close()
        super().destroy_node()

    def _note_start(self, _: Future) -> None:
        if self._retry_until is None:
            self._retry_until = self.now() + START_UP

    def _start(self, monitored: MonitoredFormula) -> Monitor:
        def note(progress: Progress) -> None:
            monitored.states = progress.states_progressed

        monitor = self._monitors[monitored.formula.name] = self._client.monitor(
            monitored.formula.formula,
            on_verdict=lambda answer: self._conclude(monitored, answer),
            on_feedback=note,
            name=monitored.formula.name,
            timeout=self._timeout,
            wait=self._timeout,
        )
        return monitor

    def _conclude(self, monitored: MonitoredFormula, answer: Answer) -> None:
        error = answer.error
        if error is None:
            monitored.outcome = VERDICTS[answer.verdict]
            monitored.explanation = answer.explanation
        elif error.code is ExitCode.CANCELLED:
            return
        elif error.code in PASSING and self.now() < (self._retry_until or 0):
            again = self.deadlines.after(RETRY_PERIOD)
            again.add_done_callback(lambda _: self._start(monitored))
            return
        else:
            monitored.outcome = error.code.name
            monitored.explanation = error.message
        monitored.known_at = self.now()
        self._on_change(monitored)

    def _log(self, monitored: MonitoredFormula) -> None:
        self.get_logger().info(
            f'{monitored.formula.name}: {monitored.outcome} '
            f'at {round_time(monitored.known_at or 0)}: {monitored.explanation}'
        )


def main() -> int:
    """The executable formula_monitor."""
    return run(FormulaMonitor)
