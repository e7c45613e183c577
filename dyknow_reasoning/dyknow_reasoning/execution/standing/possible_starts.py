"""The states from which a formula is undecided that has met unknown values.

What remains of the formula from each state on is progressed over all that the unknown values may
be; states from which the same remains have one future. Of the past, what the next state looks back
to is progressed once for all (`PossibleFormula.remember`). Example, `p -> eventually[0, 2 s] q`:

    time, s    p          q        what may remain, from the states
    0          true       false    E(2 s): 0
    1          unknown    false    E(2 s): 0; true or E(3 s): 1
    3          false      false    true or E(3 s): 1          false from 0; true from 3
    4          false      false                               from 1, no state decides it any more
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple, TypeAlias

from dyknow_common import amount, listed
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.automata.instance_states import InstanceVerdict
from dyknow_reasoning.execution.standing.runs import Run, StateTimes, number_in, union
from dyknow_reasoning.execution.unknown.possible_formulas import PossibleFormula, PossibleVerdict
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.gaps import Gap, Half

_MOST: Final = 100
"""All starts have at most this many times the possibilities that one formula may have."""

Loss: TypeAlias = Gap | PossibleFormula
"""Why no state decides a formula: missing states, or unknown values."""


class PossibleDecision(NamedTuple):
    """Starts with the same verdict.

    Args:
        formula: what remained of it.
        verdict: the verdict; None if no state decides it.
        runs: the starts.
        loss: why no state decides it.
    """

    formula: PossibleFormula
    verdict: PossibleVerdict | InstanceVerdict | None
    runs: Sequence[Run]
    loss: Loss | None = None

    @property
    def holds(self) -> bool:
        """True if the formula is true."""
        return self.verdict is not None and self.verdict.holds


class PossibleStarts:
    """The undecided start states of all instances of a formula; see `OpenStarts`.

    Args:
        beginning: the formula from the next state on.
        times: the valid times of the states.
        limit: of the possibilities of one formula.
    """

    def __init__(self, beginning: PossibleFormula, times: StateTimes, limit: int) -> None:
        self._beginning, self._times, self._limit = beginning, times, _MOST * limit
        self._groups: dict[Any, tuple[PossibleFormula, list[Run]]] = {}
        self.doubt: tuple[int, PossibleFormula] | None = None
        """The latest start from which the formula may be false, and what remained then."""
        self.is_new_doubt = False
        """True if the latest state was the first that made it possible from some start."""

    def add(self, formula: PossibleFormula, runs: Sequence[Run]) -> None:
        """Add starts from which a formula remains."""
        key = formula.key
        known, others = self._groups.get(key, (formula, []))
        if known is not formula:
            known.forget_deciding()
        self._groups[key] = known, union(others, runs)

    def step(self, values: Values) -> Iterator[PossibleDecision]:
        """Progress over the latest state, which has been appended to the times.

        Raises:
            ReasoningError: if the formula fails.
        """
        number = len(self._times) - 1
        now = self._times[number]
        begun = self._beginning.copy()
        self._beginning.remember(now, values)
        before, self._groups = [*self._groups.values()], {}
        self.is_new_doubt = False
        for formula, runs in (*before, (begun, [Run(number, number, now, now)])):
            doubted = formula.may_fail
            verdict = formula.progress(now, values)
            if verdict is not None:
                yield PossibleDecision(formula, verdict, runs)
                continue
            if formula.may_fail and not doubted:
                self._note_doubt(formula, runs[-1].last)
            if formula.is_open:
                self.add(formula, runs)
            else:
                yield PossibleDecision(formula, None, runs, formula)
        self._check_limits()

    def cross_gap(self, gap: Gap) -> Iterator[PossibleDecision]:
        """Continue after a gap that follows the latest state: no state decides these starts."""
        before, self._groups = self._groups, {}
        for formula, runs in before.values():
            yield PossibleDecision(formula, None, runs, gap)

    def _note_doubt(self, formula: PossibleFormula, number: int) -> None:
        self.is_new_doubt = True
        if self.doubt is None or number >= self.doubt[0]:
            self.doubt = number, formula.copy()

    def _check_limits(self) -> None:
        formulas = [formula for formula, _ in self._groups.values()]
        self._beginning.limit_memory(formulas)
        if sum(each.possibilities for each in formulas) > self._limit:
            wants = listed(
                list(dict.fromkeys(name for each in formulas for name in each.wants))[:3]
            )
            raise ReasoningError(
                f'the unknown values of {wants} leave more than {amount(self._limit)} '
                'possibilities from all states on; give the operators shorter intervals, or raise '
                "the limit 'possibility_limit'"
            )

    @staticmethod
    def verdict(decided: PossibleDecision, run: Run) -> PossibleVerdict | InstanceVerdict:  # noqa: ARG004
        """Return the verdict from a run of some starts on, which have one."""
        assert decided.verdict is not None  # noqa: S101
        return decided.verdict

    def at(self, number: int) -> PossibleFormula | None:
        """Return what remains of the formula from an undecided state on."""
        found = (each for each, runs in self._groups.values() if number_in(runs, number))
        return next(found, None)

    def runs(self, half: Half) -> Iterator[list[Run]]:
        """Yield the undecided start states; there are no halves."""
        return (runs for _, runs in self._groups.values() if half is Half.WHOLE)

    def has_open(self, number: int, *, pessimistic: bool) -> bool:  # noqa: ARG002
        """Return True if the formula is undecided from a state on."""
        return self.at(number) is not None

    def run_count(self) -> int:
        """Return the number of runs that are kept."""
        return sum(len(runs) for _, runs in self._groups.values())

    def oldest(self, *, own: bool) -> int:
        """Return the number of the first undecided start, or of the next state.

        Args:
            own: True if only times of states are needed, which it does not read.
        """
        firsts = (runs[0].first for _, runs in self._groups.values() if not own)
        return min(firsts, default=len(self._times))
