"""Groups of start states with one future, and the guards that split them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf
from typing import Final, NamedTuple, TypeAlias

from dyknow_reasoning.execution.automata.automaton import Decision, Guard, Location, Move, Times
from dyknow_reasoning.execution.standing.runs import Run, StateTimes, split
from dyknow_reasoning.progression.gaps import Gap, Half

OWN: Final = None
"""The clock of a start state that counts from itself."""

Clocks: TypeAlias = tuple[int | None, ...]


class AfterGap(NamedTuple):
    """A half of a formula, and the gap that its verdict depends on."""

    half: Half
    gap: Gap


class Group(NamedTuple):
    """Start states with one future, apart from their own clocks.

    Args:
        location: the location of the automaton.
        clocks: the times that bounds count from, in nanoseconds, or OWN.
        after_gap: the half of the formula that it stands for; None for the whole.
    """

    location: Location
    clocks: Clocks
    after_gap: AfterGap | None = None

    @property
    def half(self) -> Half:
        """The half of the formula that it stands for."""
        return self.after_gap.half if self.after_gap else Half.WHOLE

    def moved(self, move: Move, now: int | None) -> Group:
        """Return the group after a move; `now` is the time that a new clock has."""
        return Group(move.target, move.select((*self.clocks, now)), self.after_gap)

    def stays(self, move: Move, now: int) -> bool:
        """Return True if a move leads to the group itself."""
        return move.target is self.location and move.select((*self.clocks, now)) == self.clocks

    def times_of(self, begin: int) -> Times:
        """Return the clocks of the start state that is valid at a time, in nanoseconds."""
        return tuple(begin if clock is OWN else clock for clock in self.clocks)

    def halves(self, gap: Gap, halves: tuple[Move, Move]) -> list[Group]:
        """Return the group itself if a gap has no effect, else one half or both.

        Args:
            gap: the gap.
            halves: the moves to the optimistic and the pessimistic half.
        """
        optimistic, pessimistic = halves
        if optimistic.target is pessimistic.target is self.location:
            return [self]
        moves = {Half.OPTIMISTIC: optimistic, Half.PESSIMISTIC: pessimistic}
        if self.half in moves:
            moves = {self.half: moves[self.half]}
        elif optimistic.target is pessimistic.target:
            moves = {self.half: optimistic}
        joined = self.after_gap.gap.join(gap) if self.after_gap else gap
        return [
            self.moved(move, OWN)._replace(after_gap=AfterGap(half, joined))
            for half, move in moves.items()
        ]


class DecidedStarts(NamedTuple):
    """Start states that are decided together.

    Args:
        group: before the deciding state.
        holds: the verdict, of the half of the group.
        runs: the start states.
        symbol: the truth of the atoms at the deciding state; None if a gap decides.
    """

    group: Group
    holds: bool
    runs: Sequence[Run]
    symbol: int | None


class Validity(NamedTuple):
    """The times for which a group makes the same move, while the truth of the atoms is the same.

    Args:
        until: the time before which it does, in nanoseconds.
        fades: the age from which on the formula is true from a start instead; inf for never.
    """

    until: float = inf
    fades: float = inf


class Part(NamedTuple):
    """Starts of a group that make the same move.

    Args:
        runs: the starts.
        move: the move.
        until: as of the validity of the move.
        fades: as of the validity of the move.
    """

    runs: list[Run]
    move: Move
    until: float = inf
    fades: float = inf


ALWAYS: Final = Validity()
"""At all times."""


class Answers:
    """Answers the guards of a group at a time, and splits it where the answers differ.

    Args:
        group: the group.
        now: the time of a state, in nanoseconds.
        times: of all states.
        explore: adds the move of the oldest start at a later time to the automaton; None if the
            times for which a move is the same do not matter.
    """

    def __init__(
        self,
        group: Group,
        now: int,
        times: StateTimes,
        explore: Callable[[Sequence[Run], int], None] | None = None,
    ) -> None:
        self.found: list[Part] = []
        self.unknown: list[list[Run]] = []
        """The starts for which the automaton has no move yet."""
        self._clocks = (*group.clocks, now)
        self._now = len(group.clocks)
        self._times = times
        self._explore = explore

    def follow(
        self,
        decision: Decision | None,
        runs: list[Run],
        until: float = inf,
        fades: float = inf,
    ) -> None:
        """Follow the answers of some starts, at least one, to their moves.

        Args:
            decision: the decision of the starts.
            runs: the starts.
            until: as of the validity of the answers so far.
            fades: as of the validity of the answers so far.
        """
        clocks, now = self._clocks, self._now
        while type(decision) is Guard:
            later, earlier = clocks[decision.later], clocks[decision.earlier]
            if later is OWN or earlier is OWN:
                self._follow_own(decision, runs, until, fades)
                return
            more_than = decision.more_than
            if later - earlier > more_than:
                if decision.earlier == now:
                    until = min(until, later - more_than)
                decision = decision.yes
            else:
                if decision.later == now:
                    until = min(until, earlier + more_than + 1)
                decision = decision.no
        if type(decision) is Move:
            self.found.append(Part(runs, decision, until, fades))
        else:
            self.unknown.append(runs)

    def _follow_own(self, guard: Guard, runs: list[Run], until: float, fades: float) -> None:
        """Follow the answers to a guard about the starts themselves and another time.

        The answer of starts of some age differs from that of younger ones.
        """
        older_say_yes = self._clocks[guard.later] is not OWN
        if older_say_yes:
            other, age = guard.later, guard.more_than + 1
        else:
            other, age = guard.earlier, -guard.more_than
        time = self._clocks[other]
        assert time is not OWN  # noqa: S101 - the clocks of a guard are of different states
        older, younger = split(runs, time - age + 1, self._times)
        if older:
            self.follow(guard.yes if older_say_yes else guard.no, older, until, fades)
        if younger:
            if other == self._now:
                if self._is_true_from(guard, younger, age, answer=older_say_yes):
                    fades = min(fades, age)
                else:
                    until = min(until, younger[0].begin + age)
            self.follow(guard.no if older_say_yes else guard.yes, younger, until, fades)

    def _is_true_from(self, guard: Guard, runs: Sequence[Run], age: int, *, answer: bool) -> bool:
        """Return True if an answer, which starts of some age give, certainly leads to true."""
        if self._explore is None:
            return False
        truth = _truth(guard.yes if answer else guard.no)
        if truth is None:
            # The age itself, which a start may skip, and later ones may have different moves.
            self._explore(runs, runs[0].begin + age)
            self._explore(runs, runs[0].begin + age + 1)
            truth = _truth(guard.yes if answer else guard.no)
        return truth is True


def _truth(decision: Decision | None) -> bool | None:
    """Return True if all moves of a decision are to true, None if all that are known are."""
    if isinstance(decision, Guard):
        yes = _truth(decision.yes)
        if yes is False:
            return False
        no = _truth(decision.no)
        return None if no and yes is None else no
    return None if decision is None else decision.target.verdict is True
