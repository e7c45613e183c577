"""A log of the verdicts from each state on, and their numbers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from dyknow_reasoning.execution.standing.groups import DecidedStarts
from dyknow_reasoning.execution.standing.runs import Run
from dyknow_reasoning.progression.gaps import Gap, Half


@dataclass(frozen=True, slots=True)
class StartCounts:
    """The numbers of start states, by their verdicts.

    Args:
        holds: from which the formula is true.
        fails: from which it is false.
        undecided: from which it is undecided yet.
        unknown: from which its verdict depends on states that are missing in a gap.
    """

    holds: int = 0
    fails: int = 0
    undecided: int = 0
    unknown: int = 0


class VerdictLog:
    """When the formula was decided from each state on, by the numbers of the states.

    States that are in no dictionary, and not undecided, are decided by themselves: true.

    Attributes:
        true_at: the time of the deciding state, in nanoseconds.
        false_at: the same; None if that is the state itself.
        unprovable: the gap that prevents that the formula becomes true.
    """

    def __init__(self) -> None:
        self.true_at: dict[int, int] = {}
        self.false_at: dict[int, int | None] = {}
        self.unprovable: dict[int, Gap] = {}

    def add(self, decided: DecidedStarts, now: int) -> None:
        """Add what a state decides; of many instances, the last to be true counts."""
        group, numbers = decided.group, _numbers(decided.runs)
        if decided.holds:
            self.true_at.update(dict.fromkeys(numbers, now))
        elif group.after_gap and group.half is Half.PESSIMISTIC:
            self.unprovable.update(dict.fromkeys(numbers, group.after_gap.gap))
        else:
            for number in numbers:
                self.false_at.setdefault(number, now)

    def add_at_once(self, run: Run) -> None:
        """Add states that decide by themselves that the formula is false."""
        self.false_at.update(dict.fromkeys(_numbers([run])))


def _numbers(runs: Iterable[Run]) -> list[int]:
    return [number for run in runs for number in range(run.first, run.last + 1)]
