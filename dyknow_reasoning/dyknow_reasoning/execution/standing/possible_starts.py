"""The states from which a formula is undecided, once it has met unknown values.

The remaining formula from each state on is progressed over all possible values; states with the
same remaining formula have one future. What the next state looks back to is progressed once, for
all states (`PossibleFormula.remember`). Example, `p -> eventually[0, 2 s] q`:

    time, s    p          q        what may remain, from the states
    0          true       false    E(2 s): 0
    1          unknown    false    E(2 s): 0; true or E(3 s): 1
    3          false      false    true or E(3 s): 1          false from 0; true from 3
    4          false      false                               from 1, no state decides it any more

A start is *unknown* once no state can decide it any more. In some cases, the formula may still be
undecided from such a start, and become false later: a guard must then be closed. So these cases are
progressed further, without a verdict. If they become too many, the doubt lasts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final, NamedTuple, TypeAlias

from dyknow_common import amount, listed
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.automata.instance_states import InstanceVerdict
from dyknow_reasoning.execution.standing.runs import (
    Run,
    StateTimes,
    difference,
    number_in,
    union,
    union_of,
)
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
        formula: what remained of the formula.
        verdict: the verdict; None if no state decides it.
        runs: the starts.
        loss: why no state decides the verdict.
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
        limit: the most possibilities of one formula.
    """

    def __init__(self, beginning: PossibleFormula, times: StateTimes, limit: int) -> None:
        self._beginning, self._times, self._limit = beginning, times, _MOST * limit
        self._groups: dict[Any, tuple[PossibleFormula, list[Run]]] = {}
        # Starts that are unknown, in the cases in which they are still undecided, and what remained
        # when they became unknown.
        self._cases: dict[Any, tuple[PossibleFormula, list[Run], PossibleFormula]] = {}
        self._has_failed = False
        # The starts with too many cases, and what remained from one of them.
        self._lost: list[Run] = []
        self._lost_origin = beginning
        # Starts before undecided ones, from which the formula may be false, and is false.
        self._suspects: list[Run] = []
        self._false: list[Run] = []
        self.doubt: tuple[int, PossibleFormula] | None = None
        """The latest start from which the formula may be false, and what remained then."""
        self.is_new_doubt = False
        """True if the latest state made it possible that the formula is false from some start."""

    def add(self, formula: PossibleFormula, runs: Sequence[Run]) -> None:
        """Add starts from which a formula remains."""
        key = formula.key
        known, others = self._groups.get(key, (formula, []))
        if known is not formula:
            known.forget_deciding()
        self._groups[key] = known, union(others, runs)

    def step(self, values: Values) -> list[PossibleDecision]:
        """Progress over the latest state, which has been appended to the times.

        Raises:
            ReasoningError: if the formula fails; then the state decides nothing.
        """
        number = len(self._times) - 1
        now = self._times[number]
        begun = self._beginning.copy()
        before = [*self._groups.values(), (begun, [Run(number, number, now, now)])]
        self._groups = {}
        self.is_new_doubt = False
        try:
            self._beginning.remember(now, values)
            self._step_cases(now, values)
            decided = list(self._progressed(before, now, values))
            self._check_limits()
        except ReasoningError:
            self._groups = dict(enumerate(before))
            self._has_failed = True
            raise
        self._end_suspicions(number)
        return decided

    def _progressed(
        self, before: Iterable[tuple[PossibleFormula, list[Run]]], now: int, values: Values
    ) -> Iterator[PossibleDecision]:
        for formula, runs in before:
            verdict = formula.progress(now, values)
            if verdict is not None:
                if not verdict.holds:
                    self.add_false(runs)
                yield PossibleDecision(formula, verdict, runs)
                continue
            if formula.fails_now:
                self._note_doubt(formula, runs)
            for cases in formula.take_dropped():
                self._add_cases(cases, runs, formula.copy())
            if formula.is_open:
                self.add(formula, runs)
            else:
                yield PossibleDecision(formula, None, runs, formula)

    def add_false(self, runs: Sequence[Run]) -> None:
        """Add starts from which the formula is false in all cases."""
        self._false = union(self._false, runs)
        cases, self._cases = self._cases.values(), {}
        for formula, others, origin in cases:
            if left := difference(others, runs):
                self._add_cases(formula, left, origin)
        self._lost = difference(self._lost, runs)

    def _add_cases(
        self, formula: PossibleFormula, runs: Sequence[Run], origin: PossibleFormula
    ) -> None:
        key = formula.key
        known, others, first = self._cases.get(key, (formula, [], origin))
        self._cases[key] = known, union(others, runs), first

    def _step_cases(self, now: int, values: Values) -> None:
        """Progress the cases of unknown starts, in which they may still become false."""
        before, self._cases = self._cases.values(), {}
        for formula, runs, origin in before:
            try:
                formula.step_cases(now, values)
            except ReasoningError:  # The formula goes on: it needs no verdict on these starts.
                self._lose_cases(runs, origin)
                continue
            if formula.fails_now:
                self._note_doubt(origin, runs)
            if formula.is_open:
                self._add_cases(formula, runs, origin)
        if self._lost:
            self._note_doubt(self._lost_origin, self._lost)

    def _lose_cases(self, runs: Sequence[Run], origin: PossibleFormula) -> None:
        """Let the formula be in doubt at each state from now on."""
        self._lost, self._lost_origin = union(self._lost, runs), origin

    def _end_suspicions(self, number: int) -> None:
        """Forget false starts that are followed by starts decided in all cases."""
        if self._suspects or self._false:
            unknown = (runs for _, runs, _ in self._cases.values())
            undecided = union_of([*unknown, *self.runs(Half.WHOLE)])
            self._false = _before(self._false, undecided)
            latest = Run(number + 1, number + 1, 0, 0)
            self._suspects = _before(self._suspects, [*undecided, latest])

    @property
    def is_open(self) -> bool:
        """True if the formula may become false from a state so far."""
        return bool(self._groups or self._cases or self._lost)

    @property
    def is_suspect(self) -> bool:
        """True if a failure may be known in some case, before a start that is undecided there."""
        unknown = union_of(runs for _, runs, _ in self._cases.values())
        return bool(self._suspects or _before(self._false, unknown))

    def cross_gap(self, gap: Gap) -> Iterator[PossibleDecision]:
        """Continue after a gap that follows the latest state: no state decides these starts."""
        before, self._groups = self._groups, {}
        if self.is_suspect:
            number = len(self._times) - 1
            self._suspects = [Run(number, number, gap.before, gap.before)]
        self._cases, self._lost, self._false = {}, [], []
        for formula, runs in before.values():
            yield PossibleDecision(formula, None, runs, gap)

    def _note_doubt(self, formula: PossibleFormula, runs: Sequence[Run]) -> None:
        self.is_new_doubt = True
        self._suspects = union(self._suspects, runs)
        number = runs[-1].last
        if self.doubt is None or number >= self.doubt[0]:
            self.doubt = number, formula.copy()

    def _check_limits(self) -> None:
        formulas = [formula for formula, _ in self._groups.values()]
        cases = [formula for formula, _, _ in self._cases.values()]
        self._beginning.limit_memory([*formulas, *cases])
        if sum(each.possibilities for each in cases) > self._limit:
            for _, runs, origin in self._cases.values():
                self._lose_cases(runs, origin)
            self._cases = {}
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
        """Return the verdict from a run of some starts on; they must have one."""
        assert decided.verdict is not None  # noqa: S101
        return decided.verdict

    def at(self, number: int) -> PossibleFormula | None:
        """Return what remains of the formula from an undecided state on, unless it has failed."""
        if self._has_failed:
            return None
        found = (each for each, runs in self._groups.values() if number_in(runs, number))
        return next(found, None)

    def runs(self, half: Half) -> Iterator[list[Run]]:
        """Yield the undecided start states; there are no halves."""
        return (runs for _, runs in self._groups.values() if half is Half.WHOLE)

    def has_open(self, number: int, *, pessimistic: bool) -> bool:  # noqa: ARG002
        """Return True if the formula is undecided from a state on."""
        return any(number_in(runs, number) for _, runs in self._groups.values())

    def run_count(self) -> int:
        """Return the number of runs that are kept."""
        return sum(len(runs) for _, runs in self._groups.values())

    def oldest(self, *, own: bool) -> int:
        """Return the number of the first undecided start, or of the next state.

        Args:
            own: True if only the states count whose times the starts read: none here.
        """
        firsts = (runs[0].first for _, runs in self._groups.values() if not own)
        return min(firsts, default=len(self._times))


def _before(runs: Sequence[Run], others: Sequence[Run]) -> list[Run]:
    """Return the states of some runs whose next state is in `others`."""
    previous = [each._replace(first=each.first - 1, last=each.last - 1) for each in others]
    return difference(runs, difference(runs, previous))
