"""Handle of a plan that is being monitored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

from dyknow_interfaces.srv import ReportPlanAction
from rclpy.task import Future

from dyknow_common.ros import RemoteNode, error_from_message
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.plan import (
    Event,
    FormulaPosition,
    PlanOutcome,
    PlanPhase,
    PlanVerdict,
)
from dyknow_coordinator.ros.client.action_call import ActionCall

SERVER_TIMEOUT_S: Final = 3.0
"""Time to wait for the coordinator before a report fails."""

REPORT_TIMEOUT_S: Final = 5.0


class PlanMonitor:
    """Handle of a plan that is being monitored; its executor reports the progress of the actions.

    Attributes:
        outcome: a future of the `PlanOutcome`; await it, or check `done()`.
    """

    def __init__(
        self, name: str, coordinator: RemoteNode, on_verdict: Callable[[PlanVerdict], Any]
    ) -> None:
        self.name = name
        self.outcome: Future = Future()
        self.call: ActionCall | None = None
        self._coordinator = coordinator
        self._on_verdict = on_verdict
        self._published: dict[FormulaPosition, PlanVerdict] = {}

    async def started(self, action: str) -> None:
        """Report that an action has started; return when its formulas are being started.

        Raises:
            DyKnowError: if the report is impossible, or cannot be sent.
        """
        await self._report(action, Event.STARTED)

    async def succeeded(self, action: str) -> None:
        """Report that an action has reached its goal; raises like `started`."""
        await self._report(action, Event.SUCCEEDED)

    async def failed(self, action: str) -> None:
        """Report that an action has failed or will not be started; raises like `started`."""
        await self._report(action, Event.FAILED)

    def cancel(self) -> None:
        """End the monitoring of the plan: the outcome is then CANCELLED."""
        if self.call is not None:
            self.call.cancel()

    def update(self, verdict: PlanVerdict) -> None:
        """Pass on a new status of a formula."""
        # Errors are never equal; the phase shows that there is one.
        comparable = replace(verdict, error=None)
        if self._published.get(verdict.position) != comparable:
            self._published[verdict.position] = comparable
            self._on_verdict(verdict)

    def end(self, outcome: PlanOutcome) -> None:
        """Set the outcome; it may arrive before the last verdicts."""
        self.outcome.set_result(outcome)
        for verdict in outcome.verdicts:
            if verdict.phase is not PlanPhase.PENDING:
                self.update(verdict)

    async def _report(self, action: str, event: Event) -> None:
        goal_id = bytes(16)
        if self.call is not None:
            await self.call.accepted
            # Another client's plan may have its name; then this plan is refused.
            goal_id = self.call.goal_id
        if self.outcome.done():
            raise self.outcome.result().error or CoordinationError(
                f"plan '{self.name}' is over; nothing can be reported of '{action}'"
            )
        request = ReportPlanAction.Request(
            plan=self.name, action=action, event=int(event), goal_id=list(goal_id)
        )
        response: Any = await self._coordinator.request(
            ReportPlanAction, request, SERVER_TIMEOUT_S, REPORT_TIMEOUT_S
        )
        if error := error_from_message(response.exit_status):
            raise error
