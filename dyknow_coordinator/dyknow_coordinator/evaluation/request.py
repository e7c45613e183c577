"""What callers ask of the coordinator."""

from __future__ import annotations

from dataclasses import dataclass

from dyknow_common import NO_CONSTRAINTS, StreamConstraints
from dyknow_coordinator.grounding.grounding import Grounding


@dataclass(frozen=True, slots=True)
class EvaluationRequest:
    """Whether a formula holds from now on.

    Args:
        formula: its text.
        grounding: how its symbols find their streams.
        constraints: of the state stream.
        timeout: seconds of the wall clock after which no answer is wanted; None: none.
        name: what operators see; by default the formula.
        plan: the plan that it belongs to.
        action: the action of that plan.
        restart_on_change: whether it begins anew when a sort in it gets or loses objects.
    """

    formula: str
    grounding: Grounding = Grounding.AUTO
    constraints: StreamConstraints = NO_CONSTRAINTS
    timeout: float | None = None
    name: str = ''
    plan: str = ''
    action: str = ''
    restart_on_change: bool = False
