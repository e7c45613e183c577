"""Requests to evaluate a formula."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dyknow_common import NO_CONSTRAINTS, BlackBoxOptions, StreamConstraints
from dyknow_coordinator.grounding.feature_sources import Grounding

FOLLOWED: Final = 'followed'
"""The last part of the name of the logger of formulas whose clients report their outcomes."""


@dataclass(frozen=True, slots=True)
class EvaluationRequest:
    """Request to evaluate a formula from now on.

    Args:
        grounding: how its symbols find their streams.
        constraints: of the state stream.
        timeout_s: limit in seconds of the wall clock; None for no limit.
        name: the name that operators see; empty for the formula itself.
        plan: name of the plan that the formula belongs to, if any.
        action: name of the action of that plan.
        is_monitored: True if the formula should hold: then false is an alarm, not an answer.
        is_followed: True if its client receives feedback, and reports what becomes of it.
        restart_on_change: restart when a sort in the formula gains or loses objects.
        margin: compute the margin.
        every_state: ask it at every state, until the timeout or a cancellation.
        record: the black box that is recorded when it fails; None for none.
        delay_s: the part of the timeout that had passed when the request was received, as the
            process was stopped.
    """

    formula: str
    grounding: Grounding = Grounding.AUTO
    constraints: StreamConstraints = NO_CONSTRAINTS
    timeout_s: float | None = None
    name: str = ''
    plan: str = ''
    action: str = ''
    is_monitored: bool = False
    is_followed: bool = False
    restart_on_change: bool = False
    margin: bool = False
    every_state: bool = False
    record: BlackBoxOptions | None = None
    delay_s: float = 0.0
