"""Groups of start states with one future, and the guards that split them."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import Final, NamedTuple, TypeAlias

from dyknow_reasoning.execution.automata.automaton import Decision, Guard, Location, Move, Times
from dyknow_reasoning.execution.automata.instance_states import halves_to_follow
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
        moves = halves_to_follow(self.half, self.location, halves)
        joined = self.after_gap.gap.join(gap) if self.after_gap else gap
        return [
            self.moved(move, OWN)._replace(after_gap=AfterGap(half, joined))
            for half, move in moves.items()
        ] or [self]


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

    @property
    def loss(self) -> Gap | None:
        """The gap that keeps the formula from becoming true; None if there is none."""
        after_gap = self.group.after_gap
        is_lost = after_gap and after_gap.half is Half.PESSIMISTIC and not self.holds
        return after_gap.gap if after_gap and is_lost else None


class Validity(NamedTuple):
    """The times for which a group makes the same move, while the truth of the atoms is the same.

    Args:
        until: the time before which it does, in nanoseconds.
        fades: the age from which on starts are in another group instead; inf for never.
        successor: that group, which is true or keeps them.
    """

    until: float = inf
    fades: float = inf
    successor: Group | None = None


class Part(NamedTuple):
    """Starts of a group with the same answers to guards.

    Args:
        runs: the starts.
        decision: after these answers; a move at the end, None if the automaton has none yet.
        until: the time before which starts that are younger than `age` give the same answers.
        age: in nanoseconds.
    """

    runs: list[Run]
    decision: Decision | None
    until: float = inf
    age: float = inf


ALWAYS: Final = Validity()
"""At all times."""


def follow(part: Part, clocks: Clocks, now: int, times: StateTimes) -> list[Part]:
    """Follow the answers of some starts to their moves; split them where the answers differ.

    Args:
        part: the starts, at least one, with their answers so far.
        clocks: the clocks of their group.
        now: the time of a state, in nanoseconds.
        times: of all states.
    """
    runs, decision, until, age = part
    found: list[Part] = []
    present, clocks = len(clocks), (*clocks, now)
    while isinstance(decision, Guard):
        later, earlier = clocks[decision.later], clocks[decision.earlier]
        # A clock before some time gives another answer than a later one.
        if later is OWN or decision.earlier == present:
            assert earlier is not OWN  # noqa: S101 - only one clock is OWN
            clock, time = later, earlier + decision.more_than + 1
            before, after = decision.no, decision.yes
        else:
            clock, time = earlier, later - decision.more_than
            before, after = decision.yes, decision.no
        first, last = (runs[0].begin, runs[-1].end) if clock is OWN else (clock, clock)
        if last < time:
            decision = before
            continue
        if first < time:
            older, runs = split(runs, time, times)
            found += follow(Part(older, before, until, age), clocks[:-1], now, times)
        if present in (decision.later, decision.earlier):
            limit = now - time + 1
            if clock is OWN:
                age = min(age, limit)
            else:
                until = min(until, clock + limit)
        decision = after
    found.append(Part(runs, decision, until, age))
    return found
