"""What callers ask of the coordinator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dyknow_coordinator.grounding import Grounding
from dyknow_stream_processing import NO_CONSTRAINTS

if TYPE_CHECKING:
    from dyknow_stream_processing import StreamConstraints


@dataclass(frozen=True, slots=True)
class Question:
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
