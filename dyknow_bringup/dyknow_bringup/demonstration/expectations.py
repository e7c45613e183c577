"""Outcomes of the monitored formulas, compared with those that a scenario expects."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from dyknow_bringup.simulation.scenario import UNDECIDED, Expectation
from dyknow_common import Margin, round_time
from dyknow_configuration import RequestedFormula
from dyknow_coordinator import StandingVerdicts

HOLDS: Final = 'holds'
"""The outcome of a formula that is asked at every state, outside of its episodes."""

VIOLATED: Final = 'violated'
"""Its outcome while an episode lasts."""

NOT_CONNECTED: Final = 'not connected'
"""The outcome of a formula until the coordinator accepts it."""

WAITING: Final = 'waiting'
"""Its outcome from then on until its first state."""

_OPEN: Final = frozenset({NOT_CONNECTED, WAITING, UNDECIDED})


@dataclass(slots=True)
class MonitoredFormula:
    """A formula and its outcome so far.

    Args:
        outcome: NOT_CONNECTED, WAITING, `undecided`, `true`, `false`, or the name of an exit
            status; also HOLDS or VIOLATED for a formula that is asked at every state.
        known_at: when the outcome was known, in nanoseconds; None while undecided.
        explanation: the reason, for people.
        waits_for: why no state comes, for people; empty while states come.
        presumably_false: True if it is undecided, and would be false if no further state came.
        has_states: True if it ever had a state, or a verdict.
        margin: the latest, if it is asked for.
        verdicts: of the present evaluation, for a formula that is asked at every state.
        has_failed: True if it was false once.
    """

    formula: RequestedFormula
    outcome: str = NOT_CONNECTED
    known_at: int | None = None
    explanation: str = ''
    waits_for: str = ''
    presumably_false: bool = False
    has_states: bool = False
    margin: Margin | None = None
    verdicts: StandingVerdicts = field(default_factory=StandingVerdicts)
    has_failed: bool = False

    @property
    def name(self) -> str:
        """The name of the formula."""
        return self.formula.name or self.formula.text

    @property
    def status(self) -> str:
        """The outcome, as tables show it."""
        holds_so_far = self.outcome == UNDECIDED and not self.presumably_false
        return 'holds so far' if holds_so_far else self.outcome

    @property
    def is_decided(self) -> bool:
        """True if there is a verdict or an error."""
        return self.outcome not in _OPEN


def unexpected(
    monitored: MonitoredFormula, expectation: Expectation | None, start: int
) -> str | None:
    """Return how an outcome differs from the expected one; None if it does not.

    Args:
        monitored: the formula and its outcome.
        expectation: of the scenario; None if it expects nothing of the formula.
        start: of the scenario, in nanoseconds.
    """
    if expectation is None:
        return None
    if monitored.outcome != expectation.outcome:
        return f'{monitored.outcome} instead of {expectation.outcome}'
    if expectation.decided_between is None or monitored.known_at is None:
        return None
    earliest, latest = expectation.decided_between
    elapsed = monitored.known_at - start
    if earliest <= elapsed <= latest:
        return None
    return (
        f'{monitored.outcome} at {round_time(elapsed)} instead of between '
        f'{round_time(earliest)} and {round_time(latest)}'
    )
