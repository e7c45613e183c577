"""Groups of start states with one future, and the guards that split them."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import Final, NamedTuple, TypeAlias

from dyknow_reasoning.execution.automata.automaton import Decision, Guard, Location, Move, Times
from dyknow_reasoning.execution.automata.instance_states import halves_to_follow
from dyknow_reasoning.execution.standing.runs import Run
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
        group: their group before the deciding state.
        holds: the verdict, on the half that the group stands for.
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


Answers: TypeAlias = tuple[Decision | None, float, float, float]
"""The result of `answers`."""


def answers(decision: Decision | None, clocks: Clocks, begin: int, now: int) -> Answers:
    """Follow the answers of a start state from guard to guard.

    Args:
        decision: the first guard, or a move.
        clocks: the clocks of its group.
        begin: the valid time of the start state, in nanoseconds.
        now: the time of a state.

    Returns:
        The decision at the end: a move, or None if the automaton has none yet. The time before
        which the answers stay the same, except for answers that depend on the age of the start;
        `now` if starts of one age may differ. The age below which the excepted answers stay the
        same. The valid time from which on starts give other answers. In nanoseconds.
    """
    until = age = younger = inf
    present, clocks = len(clocks), (*clocks, now)
    while type(decision) is Guard:
        side, opposite = decision.later, decision.earlier
        later, earlier = clocks[side], clocks[opposite]
        excess = (begin if later is OWN else later) - (begin if earlier is OWN else earlier)
        excess -= decision.more_than
        # The answer is another if one side is this much later.
        if excess > 0:
            needed, side, opposite, decision = excess, opposite, side, decision.yes
        else:
            needed, decision = 1 - excess, decision.no
        if side != present:
            if clocks[side] is OWN:
                younger = min(younger, begin + needed)
            if opposite != present and (later is OWN or earlier is OWN):
                until = now
        elif clocks[opposite] is not OWN:
            until = min(until, now + needed)
        elif now - begin + needed < age:
            age = now - begin + needed
    return decision, until, age, younger
