"""The timed automaton of a formula, built as the states come.

Progression does the same whenever the *location* (the remaining formula, its bounds counting from
numbered states), the truth of the atoms and the answers to its few questions about time are the
same. So each step of progression is stored, and is a look-up from then on. The *clocks* are the
times of the states that bounds count from: a *move* keeps some of them and may add the time of the
present state. A *guard* is a question about two of these times, with a decision for each answer.

Example, with clock c0 and the time of the present state, now:

    location                                 atoms        decision
    A: always (p -> eventually[0, 2 s] q)    q or not p   move to A
                                             p, not q     move to B, c0 = now
    B: A and eventually[to c0 + 2 s] q       q            guard now - c0 < 2 s: move to A; if not,
                                                            guard now - c0 > 2 s: move to false;
                                                            if not, move to A
                                             not q        guard now - c0 < 2 s: move to B, keep c0;
                                                            if not, move to false

The number of locations depends neither on the length of windows nor on the times of states.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import count
from math import inf
from operator import itemgetter
from typing import Any, Final, TypeAlias

from dyknow_reasoning.progression.gaps import Gap, apart, halves_after
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import (
    FALSE,
    TRUE,
    Bound,
    Constant,
    Node,
    Remembering,
    Sides,
    TimeQuestion,
    bounds_of,
    sides,
)
from dyknow_reasoning.progression.progression import NONE_KEPT, Progression

_MAX_NODES = 1 << 16

MAX_SLOTS: Final = 1 << 10
"""The most slots of an instance that keeps values; above, a symbol has the number of formulas."""

Times: TypeAlias = tuple[int, ...]
"""The times of the states that bounds count from, in nanoseconds, increasing."""


@dataclass(eq=False, slots=True)
class Location:
    """A remaining formula.

    Args:
        node: the formula; its bounds count from states 0, 1, ...
        clocks: the number of these states.
        verdict: True or False once the formula is decided.
        unbounded: the open windows without an end.
        is_fresh: True if the formula has seen no state.
        moves: the decision for each truth of the atoms.
        memories: the same, for the memories of the past operators of a fresh formula.
    """

    node: Node
    clocks: int
    verdict: bool | None
    unbounded: tuple[Sides, ...]
    is_fresh: bool
    moves: dict[int, Decision] = field(default_factory=dict)
    memories: dict[int, Decision] = field(default_factory=dict)


@dataclass(eq=False, slots=True)
class Move:
    """A step to a location.

    Args:
        target: the location.
        kept: the clocks that its bounds count from; the number after the last clock is the time of
            the present state.
        select: picks these clocks from a tuple of times.
        is_alike: True if the location before is not fresh, and the undecided target has the same
            atoms and the same open windows without an end.
        is_idle: True if it changes nothing: it leads to the location before, with the same clocks.
    """

    target: Location
    kept: tuple[int, ...]
    select: Callable[[tuple[Any, ...]], tuple[Any, ...]]
    is_alike: bool
    is_idle: bool


@dataclass(eq=False, slots=True)
class Guard:
    """A `TimeQuestion` and the decision for each answer."""

    later: int
    earlier: int
    more_than: int
    yes: Decision | None = None
    no: Decision | None = None


Decision: TypeAlias = Move | Guard


class Automaton:
    """Progresses the instances of one template, given by the fresh formula.

    The past operators of the formula may have seen states already; see `remember`.
    """

    def __init__(self, formula: Node) -> None:
        clocks = bounds_of(formula) if type(formula) is Remembering else ()
        self.initial = _location(formula, len({each.state for each in clocks}), is_fresh=True)
        self.max_size = formula.size
        self.slots = formula.mask.bit_length()
        # True if anything was added since this was last set to False.
        self.has_grown = True
        self._progression = Progression([formula])
        self._locations: dict[Node, Location] = {}
        # The steps that were found; over many atoms, each state may need another one.
        self._found = 0
        self._limit = _MAX_NODES
        self._keeps_values = False
        # The formulas that slots stand for at a state, by a number that is never used again; the
        # number is 0 for instances that keep no value.
        self._kept: dict[int, Mapping[int, Node]] = {0: NONE_KEPT}
        self._kept_numbers: dict[frozenset[tuple[int, Node]], int] = {}
        self._next_kept = count(1)

    @property
    def store(self) -> NodeStore:
        """The nodes, until `forget`."""
        return self._progression.store

    def symbol(self, truth: int, kept: Mapping[int, Node]) -> int:
        """Return the symbol of a state at which some slots stand for formulas of the store.

        Args:
            truth: the truth of the other atoms, as bits.
            kept: the formulas of the store, by their slots.
        """
        self._keeps_values = True
        key = frozenset(kept.items())
        number = self._kept_numbers.get(key)
        if number is None:
            number = self._kept_numbers[key] = next(self._next_kept)
            self._kept[number] = kept
        return truth | number << MAX_SLOTS

    def kept(self, symbol: int) -> Mapping[int, Node]:
        """Return the formulas that some slots stand for at a state."""
        return self._kept[symbol >> MAX_SLOTS] if self._keeps_values else NONE_KEPT

    def move(self, location: Location, symbol: int, times: Times) -> Move:
        """Return the step from a location over a state.

        Args:
            location: the location before the state.
            symbol: the truth of the atoms that the location depends on, as bits.
            times: the clocks and the time of the state.
        """
        return _followed(location.moves, symbol, times) or self._find(location, symbol, times)

    def remember(self, location: Location, symbol: int, times: Times) -> Move:
        """Return the move to the fresh formula whose past operators have seen one more state.

        Args:
            location: the initial location, or the target of such a move.
            symbol: the truth of the atoms of the formula.
            times: the clocks and the time of the state.
        """
        found = _followed(location.memories, symbol, times)
        return found or self._find(location, symbol, times, is_memory=True)

    def halves(self, location: Location, times: Times, gap: Gap, past: int) -> tuple[Move, Move]:
        """Return the moves to the optimistic and the pessimistic half of a location after a gap.

        Args:
            location: the location.
            times: its clocks.
            gap: the gap.
            past: the slots of atoms that look back, as bits; the halves have them `apart`.
        """
        self._progression.begin(0, times)
        store = self._progression.store
        halves: tuple[Node, Node] = TRUE, FALSE  # Both atoms would need slots of their own.
        if not (past and self._keeps_values):
            halves = halves_after(location.node, gap, times, store)
        optimistic, pessimistic = (self.apart(half, past) for half in halves)
        self.has_grown = True
        return self._move(location, optimistic), self._move(location, pessimistic)

    def apart(self, node: Node, past: int) -> Node:
        """Return a node with the negations of some atoms, given as bits, in slots of their own."""
        return apart(node, past, self.slots, self._progression.store)

    @property
    def is_full(self) -> bool:
        """True if there are so many nodes or steps that `forget` should be called."""
        return max(len(self._progression.store), self._found, len(self._kept)) > self._limit

    def forget(self, locations: Iterable[Location]) -> None:
        """Drop everything but the initial location and the given ones."""
        for location in (*self._locations.values(), self.initial):
            location.moves.clear()
            location.memories.clear()
        self._locations = {each.node: each for each in locations if each is not self.initial}
        self._progression = Progression([self.initial.node, *self._locations])
        self._kept = {0: NONE_KEPT}
        self._kept_numbers.clear()
        self._found = 0
        self._limit = max(_MAX_NODES, 2 * len(self._progression.store))

    def _find(
        self, location: Location, symbol: int, times: Times, *, is_memory: bool = False
    ) -> Move:
        progression = self._progression
        progression.begin(symbol, times, self.kept(symbol))
        if is_memory:
            known, node = location.memories, progression.remember(location.node)
        else:
            known = location.moves
            node = progression.advance(location.node, fresh=location.is_fresh)
        questions = progression.chronology.asked.items()
        move = self._move(location, node)
        self.has_grown = True
        self._found += 1
        known[symbol] = _grafted(known.get(symbol), questions, move)
        return move

    def _move(self, before: Location, node: Node) -> Move:
        """Return the move from a location to the location of a node, with its clocks renumbered."""
        bounds = bounds_of(node)
        kept = tuple(sorted({bound.state for bound in bounds}))
        numbers = {state: number for number, state in enumerate(kept)}
        renumbered = {bound: Bound(numbers[bound.state], bound.offset) for bound in bounds}
        node = self._progression.store.renumbered(node, renumbered)
        target = self._locations.get(node)
        if target is None:
            is_fresh = type(node) is Remembering and node.is_fresh
            target = self._locations[node] = _location(node, len(kept), is_fresh=is_fresh)
            self.max_size = max(self.max_size, node.size)
        is_alike = not before.is_fresh and _are_alike(before, target)
        is_idle = target is before and (not kept or kept[-1] < before.clocks)
        return Move(target, kept, _selection(kept), is_alike, is_idle)


def _location(node: Node, clocks: int, *, is_fresh: bool) -> Location:
    verdict = node.value if type(node) is Constant else None
    unbounded = tuple(dict.fromkeys(map(sides, node.unbounded)))
    return Location(node, clocks, verdict, unbounded, is_fresh)


def wake_time(location: Location, symbol: int, times: Times) -> float:
    """Return the time before which states with a given truth of the atoms change nothing.

    Return the present time if such a state changes something, or if its move is unknown.

    Args:
        location: the location at the present time.
        symbol: the truth of the atoms.
        times: the clocks, and the present time, in nanoseconds.
    """
    found: float = inf
    decision, now = location.moves.get(symbol), location.clocks
    while type(decision) is Guard:
        later, earlier, more_than = decision.later, decision.earlier, decision.more_than
        if times[later] - times[earlier] > more_than:
            if earlier == now:
                found = min(found, times[later] - more_than)
            decision = decision.yes
        else:
            if later == now:
                found = min(found, times[earlier] + more_than + 1)
            decision = decision.no
    return found if type(decision) is Move and decision.is_idle else times[now]


def _followed(decisions: Mapping[int, Decision], symbol: int, times: Times) -> Move | None:
    """Return the move for some answers to the guards, if it is known."""
    found = decisions.get(symbol)
    while type(found) is Guard:
        answer = times[found.later] - times[found.earlier] > found.more_than
        found = found.yes if answer else found.no
    return found if type(found) is Move else None


def _are_alike(before: Location, target: Location) -> bool:
    same_atoms = target.node.mask == before.node.mask
    return target.verdict is None and same_atoms and target.unbounded == before.unbounded


def _grafted(
    tree: Decision | None, questions: Iterable[tuple[TimeQuestion, bool]], move: Move
) -> Decision:
    """Return a decision with one more branch; replace branches that asked other questions."""
    root = parent = Guard(0, 0, 0, yes=tree)
    branch = 'yes'
    for question, answer in questions:
        guard = getattr(parent, branch)
        if type(guard) is not Guard or (guard.later, guard.earlier, guard.more_than) != question:
            guard = Guard(*question)
            setattr(parent, branch, guard)
        parent, branch = guard, 'yes' if answer else 'no'
    setattr(parent, branch, move)
    return root.yes or move


def _selection(kept: tuple[int, ...]) -> Callable[[tuple[Any, ...]], tuple[Any, ...]]:
    match kept:
        case ():
            return lambda _: ()
        case (number,):
            return lambda times: (times[number],)
        case _:
            return itemgetter(*kept)
