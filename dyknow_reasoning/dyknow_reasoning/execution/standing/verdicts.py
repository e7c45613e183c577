"""The verdicts on a formula from each state on: failures, a log, and their numbers."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from dyknow_reasoning.execution.automata.instance_states import InstanceVerdict
from dyknow_reasoning.execution.standing.groups import DecidedStarts
from dyknow_reasoning.execution.standing.possible_starts import Loss, PossibleDecision
from dyknow_reasoning.execution.standing.runs import Run, union
from dyknow_reasoning.execution.unknown.possible_formulas import PossibleVerdict
from dyknow_reasoning.progression.atoms import Values


@dataclass(eq=False, slots=True)
class Failure:
    """Consecutive start states: from each of them, the formula is false.

    Args:
        run: the states.
        verdict: the verdict on the instance that was false from the first state on.
        decided_at: the valid time of the state that decided this verdict, in nanoseconds.
        values: the values of the deciding state.
        has_ended: True once the formula holds from the state after the last one on.
    """

    run: Run
    verdict: InstanceVerdict | PossibleVerdict
    decided_at: int
    values: Values = field(repr=False)
    has_ended: bool = False


class Failures:
    """The failures of a formula, in the order of their states.

    Attributes:
        kept: the failures that are not forgotten.
        waiting: the failures that have not ended.
        count: the number of all failures, including forgotten ones.
    """

    def __init__(self) -> None:
        self.kept: list[Failure] = []
        self.waiting: list[Failure] = []
        self.count = 0

    def add(self, run: Run, failure_of: Callable[[Run], Failure]) -> bool:
        """Join states with adjacent failures; return True if there are none.

        Args:
            run: the states.
            failure_of: returns the failure that begins with them.
        """
        kept = self.kept
        begin = bisect_left(kept, run.first - 1, key=lambda each: each.run.last)
        end = bisect_right(kept, run.last + 1, key=lambda each: each.run.first)
        touched = kept[begin:end]
        joined = touched[0] if touched and touched[0].run.first <= run.first else failure_of(run)
        if touched:
            last = touched[-1]
            if joined is last and run.last <= last.run.last:
                return False
            joined.has_ended = last.has_ended and run.last <= last.run.last
            joined.run = union([each.run for each in touched], [run])[0]
        kept[begin:end] = [joined]
        self.waiting = [each for each in self.waiting if each not in touched]
        if not joined.has_ended:
            self.waiting.append(joined)
        self.count += 1 - len(touched)
        return not touched

    def end(self, failure: Failure) -> None:
        """Record that the formula holds after a failure."""
        failure.has_ended = True
        self.waiting.remove(failure)

    def last_around(self, number: int) -> int | None:
        """Return the last state of the failure that contains a state; None if no failure does."""
        at = bisect_left(self.kept, number, key=lambda each: each.run.last)
        if at < len(self.kept) and self.kept[at].run.first <= number:
            return self.kept[at].run.last
        return None

    @property
    def runs(self) -> list[Run]:
        """The states of the kept failures."""
        return [each.run for each in self.kept]


class VerdictLog:
    """When the formula was decided from each state on, by the numbers of the states.

    A state that is in no dictionary, and not undecided, is true, and decided by itself.

    Attributes:
        true_at: the time of the deciding state, in nanoseconds.
        false_at: the same for the verdict false.
        unprovable: the gap that keeps the formula from becoming true; what remained of the
            formula if its verdict depends on unknown values.
    """

    def __init__(self) -> None:
        self.true_at: dict[int, int] = {}
        self.false_at: dict[int, int] = {}
        self.unprovable: dict[int, Loss] = {}

    def add(self, decided: DecidedStarts | PossibleDecision, now: int) -> None:
        """Add what a state decides; of many instances, the last to be true counts."""
        numbers = _numbers(decided.runs)
        if decided.holds:
            self.true_at.update(dict.fromkeys(numbers, now))
        elif decided.loss is not None:
            self.unprovable.update(dict.fromkeys(numbers, decided.loss))
        else:
            for number in numbers:
                self.false_at.setdefault(number, now)


def _numbers(runs: Iterable[Run]) -> list[int]:
    return [number for run in runs for number in range(run.first, run.last + 1)]
