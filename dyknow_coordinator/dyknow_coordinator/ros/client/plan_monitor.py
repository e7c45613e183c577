"""A plan that is being monitored, as its executor sees it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from dyknow_interfaces.srv import ReportPlanAction
from rclpy.task import Future

from dyknow_common.ros import RemoteNode
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.plans.plan import (
    Event,
    FormulaPosition,
    PlanOutcome,
    PlanPhase,
    PlanVerdict,
)
from dyknow_coordinator.ros.client.action_call import ActionCall
from dyknow_coordinator.ros.reporting.evaluation_messages import error_of

PATIENCE = 3.0
"""Seconds to wait for the coordinator to be there for a report."""

LIMIT = 5.0
"""Seconds that a report may take."""


class PlanMonitor:
    """A plan that is being monitored; its executor reports how the actions go.

    Attributes:
        outcome: a future of the `PlanOutcome`; await it, or look whether it is `done()`.
    """

    def __init__(
        self, name: str, peer: RemoteNode, on_verdict: Callable[[PlanVerdict], Any]
    ) -> None:
        self.name = name
        self.outcome: Future = Future()
        self.errand: ActionCall | None = None
        self._peer = peer
        self._on_verdict = on_verdict
        self._told: dict[FormulaPosition, PlanVerdict] = {}

    async def started(self, action: str) -> None:
        """Reports that an action has begun; returns when its formulas are being started.

        Raises:
            DyKnowError: when that cannot be, or cannot be told.
        """
        await self._report(action, Event.STARTED)

    async def succeeded(self, action: str) -> None:
        """Reports that an action has reached its goal.

        Raises:
            DyKnowError: when that cannot be, or cannot be told.
        """
        await self._report(action, Event.SUCCEEDED)

    async def failed(self, action: str) -> None:
        """Reports that an action has not reached its goal, or will not be begun.

        Raises:
            DyKnowError: when that cannot be, or cannot be told.
        """
        await self._report(action, Event.FAILED)

    def cancel(self) -> None:
        """Has the plan monitored no more: the outcome is then CANCELLED."""
        if self.errand is not None:
            self.errand.cancel()

    def tell(self, verdict: PlanVerdict) -> None:
        """Something new is known of a formula."""
        if not self.outcome.done():
            self._tell_new(verdict)

    def end(self, outcome: PlanOutcome) -> None:
        """The plan is over; the outcome may overtake the last verdicts."""
        self.outcome.set_result(outcome)
        for verdict in outcome.verdicts:
            if verdict.phase is not PlanPhase.PENDING:
                self._tell_new(verdict)

    def _tell_new(self, verdict: PlanVerdict) -> None:
        # Errors are equal only to themselves; the phase tells that there is one.
        known = replace(verdict, error=None)
        if self._told.get(verdict.place) != known:
            self._told[verdict.place] = known
            self._on_verdict(verdict)

    async def _report(self, action: str, event: Event) -> None:
        if self.errand is not None:
            await self.errand.accepted
        if self.outcome.done():
            raise self.outcome.result().error or CoordinationError(
                f"plan '{self.name}' is over; nothing can be reported of '{action}'"
            )
        request = ReportPlanAction.Request(plan=self.name, action=action, event=int(event))
        response: Any = await self._peer.request(ReportPlanAction, request, PATIENCE, LIMIT)
        error = error_of(response.exit_status)
        if error is not None:
            raise error
