"""Asks the stream reasoning coordinator about the formulas of a file, all at once."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from dyknow_interfaces.action import MonitorFormula
from rclpy.action import ActionClient
from rclpy.task import Future

from dyknow_bringup.formulas import load_formulas
from dyknow_bringup.monitoring import VERDICTS, MonitoredFormula
from dyknow_bringup.resources import formulas_path
from dyknow_stream_processing import ExitCode, round_time
from dyknow_stream_processing.ros import (
    DyKnowNode,
    nanoseconds_to_duration,
    run,
)

if TYPE_CHECKING:
    from collections.abc import Callable

PASSING = (ExitCode.UNAVAILABLE, ExitCode.NOT_FOUND)
"""What may pass while the other nodes are still starting."""

START_UP = 10_000_000_000
"""Nanoseconds that the start of the other nodes may take."""

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
        self._client = ActionClient(self, MonitorFormula, f'{coordinator}/monitor_formula')
        self._goals: dict[str, Any] = {}
        self._retry_until = 0
        self._starter = self.create_timer(0.1, self._start_when_ready, clock=self.wall_clock)

    @property
    def is_running(self) -> bool:
        """Whether the coordinator has taken all formulas."""
        return len(self._goals) == len(self.formulas)

    def cancel_all(self) -> Future:
        """Lets the coordinator forget the formulas; the future is done when it has."""
        cancelled: Future = Future()
        pending = [goal.cancel_goal_async() for goal in self._goals.values()]

        def note(_: Future) -> None:
            if all(each.done() for each in pending) and not cancelled.done():
                cancelled.set_result(None)

        for each in pending:
            each.add_done_callback(note)
        return cancelled

    def destroy_node(self) -> None:
        """Frees the action client too."""
        self._client.destroy()
        super().destroy_node()

    def _start_when_ready(self) -> None:
        if not self._client.server_is_ready():
            return
        self.destroy_timer(self._starter)
        self._retry_until = self.now() + START_UP
        for monitored in self.formulas:
            self._send(monitored)

    def _send(self, monitored: MonitoredFormula) -> None:
        goal = MonitorFormula.Goal(
            name=monitored.formula.name,
            formula=monitored.formula.formula,
            timeout=nanoseconds_to_duration(round(self._timeout * 1e9)),
        )

        def feedback(message: Any) -> None:
            monitored.states = message.feedback.states_progressed

        def accepted(future: Any) -> None:
            self._goals[monitored.formula.name] = future.result()
            result = future.result().get_result_async()
            result.add_done_callback(lambda done: self._conclude(monitored, done.result().result))

        self._client.send_goal_async(goal, feedback).add_done_callback(accepted)

    def _conclude(self, monitored: MonitoredFormula, result: Any) -> None:
        code = ExitCode(result.exit_status.code)
        if code is ExitCode.CANCELLED:
            return
        if code in PASSING and self.now() < self._retry_until:
            again = self.deadlines.after(RETRY_PERIOD)
            again.add_done_callback(lambda _: self._send(monitored))
            return
        if code is ExitCode.SUCCESS:
            monitored.outcome = VERDICTS[result.verdict]
            monitored.explanation = result.explanation
        else:
            monitored.outcome = code.name
            monitored.explanation = result.exit_status.message
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
