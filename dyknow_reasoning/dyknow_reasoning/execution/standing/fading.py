"""Starts that fade: they leave a group when they reach an age, while the atoms stay the same.

Such starts need no step if all of them move to one other group, and stay there. Example,
`always[0, 1 s] eventually[0, 0.5 s] p`, while p is false since a state at 7 s:

    age of a start    what remains
    less than 1 s     always[to start + 1 s] eventually[0, 0.5 s] p and eventually[to 7.5 s] p
    1 s or more       eventually[to 7.5 s] p

Starts reach the age of 1 s at each state, but a step is necessary after 7.5 s only.
"""

from __future__ import annotations

from math import inf
from typing import TypeAlias

from dyknow_reasoning.execution.automata.automaton import Automaton, Guard, Move
from dyknow_reasoning.execution.standing.groups import OWN, Group, Validity

_Ages: TypeAlias = list[tuple[int, Move | None]]
"""The moves from some ages on, in nanoseconds; None if the automaton does not have one yet."""


class Future:
    """The moves of starts at later states with the same truth of the atoms.

    Args:
        automaton: of the starts.
        symbol: the truth of the atoms, as bits.
        oldest: the valid time of the oldest start, in nanoseconds.
        now: the earliest time of the next state.
    """

    def __init__(self, automaton: Automaton, symbol: int, oldest: int, now: int) -> None:
        self._automaton = automaton
        self._symbol = symbol
        self._oldest = oldest
        self._now = now

    def fading(self, group: Group, age: int, until: float) -> Validity | None:
        """Return where the starts of a group move that reach an age; None if they need a step.

        Args:
            group: the group.
            age: in nanoseconds.
            until: the time before which younger starts stay in the group.
        """
        found, end = self._explored(group, age)
        until = min(until, end)
        _, move = found[0]
        if move is None or move.target.verdict is False or len(group.clocks) in move.kept:
            return None
        successor = group.moved(move, self._now)
        ages = [
            since
            for since, other in found
            if other is None or group.moved(other, self._now) != successor
        ]
        if successor.location.verdict is None:
            found, end = self._explored(successor, age + 1)
            until = min(until, end)
            ages += [
                since
                for since, other in found
                if other is None or not successor.stays(other, self._now)
            ]
        most = min(ages, default=inf)
        return Validity(min(until, self._oldest + most), age, successor) if most > age else None

    def _explored(self, group: Group, age: int) -> tuple[_Ages, float]:
        """Return the same as `_ages`, after moves are added that some starts may make."""
        oldest = self._oldest
        explored: set[int] = set()
        while True:
            found, until = self._ages(group, age)
            unknown = {since for since, move in found if not move and oldest + since < until}
            if unknown <= explored:
                return found, until
            for since in unknown - explored:
                times = (*group.times_of(oldest), oldest + since)
                self._automaton.move(group.location, self._symbol, times)
            explored |= unknown

    def _ages(self, group: Group, age: int) -> tuple[_Ages, float]:
        """Return the moves of starts of a group that reach an age, or are older.

        Returns:
            All moves that they may make, first that at the age itself, and the time before which
            these are the same.
        """
        found: _Ages = []
        until = inf
        present, clocks = len(group.clocks), (*group.clocks, self._now)
        pending = [(group.location.moves.get(self._symbol), age)]
        while pending:
            each, since = pending.pop()
            if not isinstance(each, Guard):
                found.append((since, each))
                continue
            later, earlier, more_than = clocks[each.later], clocks[each.earlier], each.more_than
            if later is OWN or earlier is OWN:
                if present not in (each.later, each.earlier):
                    pending += (each.yes, since), (each.no, since)
                    continue
                limit, older, younger = more_than + 1, each.yes, each.no
                if later is OWN:
                    limit, older, younger = -more_than, each.no, each.yes
                pending.append((older, max(since, limit)))
                if since < limit:
                    pending.append((younger, since))
            elif later - earlier > more_than:
                if each.earlier == present:
                    until = min(until, later - more_than)
                pending.append((each.yes, since))
            else:
                if each.later == present:
                    until = min(until, earlier + more_than + 1)
                pending.append((each.no, since))
        return found, until
