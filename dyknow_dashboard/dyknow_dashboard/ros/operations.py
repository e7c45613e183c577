"""Requests of operators on the page: formulas, their end, black boxes."""

from __future__ import annotations

from typing import Any, Final

from dyknow_interfaces.srv import CancelEvaluation, SaveBlackBox

from dyknow_common import ExitCode
from dyknow_common.ros import NodeAdapter, RemoteNode
from dyknow_coordinator.ros import FormulaClient, Monitor
from dyknow_dashboard.errors import DashboardError
from dyknow_dashboard.model.requests import AskedFormula
from dyknow_dashboard.ros.nodes_of_system import COORDINATOR, RECORDER

MAX_ASKED: Final = 50
"""The number of formulas that were asked on pages and run."""

SAVE_TIMEOUT_S: Final = 30.0
"""The time to write black boxes, which records on for some time after the request."""


class Operations:
    """Requests to the coordinator and the black box recorder.

    The formulas that were asked on pages end with this process, as its client does.

    Args:
        adapter: of the node that requests; its methods are called in the thread of its executor.
    """

    def __init__(self, adapter: NodeAdapter) -> None:
        self._adapter = adapter
        self._client = FormulaClient(adapter.node)
        self._coordinator = RemoteNode(adapter, COORDINATOR)
        self._monitors: set[Monitor] = set()

    def close(self) -> None:
        """Cancel all formulas that were asked here."""
        self._client.close()

    async def ask(self, asked: AskedFormula) -> None:
        """Have a formula monitored.

        Raises:
            DyKnowError: if there are too many, or if it could not be started.
        """
        if len(self._monitors) >= MAX_ASKED:
            raise DashboardError(
                f'{MAX_ASKED} formulas of this page run already; cancel one', ExitCode.UNAVAILABLE
            )
        monitor = self._client.monitor(
            asked.formula,
            name=asked.name,
            every_state=asked.every_state,
            margin=asked.margin,
            timeout=asked.timeout_s,
        )
        self._monitors.add(monitor)
        monitor.outcome.add_done_callback(lambda _: self._monitors.discard(monitor))
        await monitor.accepted
        if monitor.outcome.done():
            answer: Any = monitor.outcome.result()
            if answer.error is not None:
                raise answer.error

    async def cancel(self, name: str) -> int:
        """End the evaluations of a name, and return their number.

        Raises:
            DyKnowError: NOT_FOUND if there is none; UNAVAILABLE without a coordinator.
        """
        response = await self._coordinator.call(CancelEvaluation, name=name)
        return int(response.cancelled)

    async def save(self, name: str) -> list[str]:
        """Save the black boxes of a formula, or of all if the name is empty; return their paths.

        Raises:
            DyKnowError: NOT_FOUND if there is none; UNAVAILABLE without a recorder.
        """
        recorder = RemoteNode(self._adapter, RECORDER, timeout_s=SAVE_TIMEOUT_S)
        try:
            response = await recorder.call(SaveBlackBox, name=name)
        finally:
            recorder.release()
        return list(response.paths)
