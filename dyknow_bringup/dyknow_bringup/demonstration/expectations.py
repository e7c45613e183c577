"""What is known of the formulas that are being monitored, and whether it is what was expected."""

from __future__ import annotations

from dataclasses import dataclass

from dyknow_bringup.demonstration.formulas import DescribedFormula
from dyknow_bringup.simulation.scenario import Expectation
from dyknow_common import round_time

UNDECIDED = 'undecided'

VERDICTS = (UNDECIDED, 'true', 'false')
"""The names of verdicts, by their numbers in dyknow_interfaces/msg/FormulaResult."""


@dataclass(slots=True)
class MonitoredFormula:
    """A formula and what became of it so far.

    Args:
        outcome: `true`, `false`, `undecided`, or the name of an exit status.
        known_at: when the outcome was known, in nanoseconds; none while undecided.
        explanation: why, for people.
        states: how many states it has been progressed over.
    """

    formula: DescribedFormula
    outcome: str = UNDECIDED
    known_at: int | None = None
    explanation: str = ''
    states: int = 0

    @property
    def is_decided(self) -> bool:
        """Whether there is an outcome."""
        return self.outcome != UNDECIDED


def unexpected(
    monitored: MonitoredFormula, expectation: Expectation | None, start: int
) -> str | None:
    """What is wrong about an outcome; none when it is as expected.

    Args:
        monitored: the formula and its outcome.
        expectation: of the scenario; none where it says nothing about the formula.
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
