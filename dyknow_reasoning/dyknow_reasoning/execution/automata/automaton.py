"""The timed automaton of a formula, found as the states come.

Progression always does the same with the same *location* (what remains of the formula, its bounds
counting from numbered states), the same truth of the atoms, and the same answers to the few
questions about time that it asks on the way. So each of its steps is kept, as a branch of a
decision over these questions, and is a look-up from then on. The times of the states that bounds
count from are the clocks of the automaton: a step copies some of them and adds the present time,
whatever the windows are, however long they are, and however irregularly the states come.

Two things are built on this and nothing else. `configurations` numbers the locations together with
the values of their clocks, as long as these are few: then a step is one look-up in a table.
`single` progresses one instance of a formula, `batch` many of one shape; both in either form.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from operator import itemgetter
from typing import TypeAlias

from dyknow_reasoning.progression.bounds import Bound, TimeQuestion
from dyknow_reasoning.progression.gaps import Gap, rewritten
from dyknow_reasoning.progression.nodes import Constant, Node, Window, bounds_of, descendants
from dyknow_reasoning.progression.progression import Progression

_MOST_NODES = 1 << 16

Times: TypeAlias = tuple[int, ...]
"""The times of the states that bounds count from, in nanoseconds, increasing."""

Sides: TypeAlias = tuple[bool, Node, Node]
"""What makes out a window, but for its bounds."""


@dataclass(eq=False, slots=True)
class Location:
    """What remains of a formula.

    Args:
        node: what remains; its bounds count from states 0, 1, ...
        clocks: how many states these are.
        verdict: whether it is true, once decided.
        unbounded: the windows without an end that are open.
        moves: for the truth of the atoms, how to go on.
    """

    node: Node
    clocks: int
    verdict: bool | None
    unbounded: tuple[Sides, ...]
    moves: dict[int, Decision] = field(default_factory=dict)


@dataclass(eq=False, slots=True)
class Move:
    """A step to a location.

    Args:
        target: that location.
        kept: which times its bounds count from: numbers of those before, then of the present.
        select: takes these from a tuple of times.
    """

    target: Location
    kept: tuple[int, ...]
    select: Callable[[Times], Times]


@dataclass(eq=False, slots=True)
class Guard:
    """A question about time that a step depends on, and how to go on after the answer."""

    later: int
    earlier: int
    more_than: int
    yes: Decision | None = None
    no: Decision | None = None


Decision: TypeAlias = Move | Guard


class Automaton:
    """Progresses formulas of one shape.

    Args:
        formula: the formula, fresh.
    """

    def __init__(self, formula: Node) -> None:
        self.initial = _location(formula, 0)
        self.largest = formula.size
        # Whether anything was found since this was last set to False.
        self.has_news = True
        self._progression = Progression([formula])
        self._locations: dict[Node, Location] = {}
        self._limit = _MOST_NODES

    def move(self, location: Location, symbol: int, times: Times) -> Move:
        """The step from a location over a state.

        Args:
            location: what remains before the state.
            symbol: the truth of the atoms that the location depends on.
            times: those that its bounds count from, and that of the state.
        """
        found = location.moves.get(symbol)
        while type(found) is Guard:
            asked = times[found.later] - times[found.earlier] > found.more_than
            found = found.yes if asked else found.no
        return found if type(found) is Move else self._find(location, symbol, times)

    def across(self, location: Location, times: Times, gap: Gap) -> tuple[Move, Move]:
        """The steps from a location to its optimistic and its pessimistic half after a gap.

        Args:
            location: what remains before the gap.
            times: those that its bounds count from.
            gap: in which states are missing.
        """
        self._progression.begin(0, times)
        store = self._progression.store
        optimistic, pessimistic = rewritten(location.node, gap, times, store)
        self.has_news = True
        return self._move(optimistic), self._move(pessimistic)

    @property
    def is_full(self) -> bool:
        """Whether so much is remembered that it is time to `forget`."""
        return len(self._progression.store) > self._limit

    def forget(self, locations: Iterable[Location]) -> None:
        """Drops all that was found, but for some locations."""
        for location in (*self._locations.values(), self.initial):
            location.moves.clear()
        self._locations = {each.node: each for each in locations if each is not self.initial}
        self._progression = Progression([self.initial.node, *self._locations])
        self._limit = max(_MOST_NODES, 2 * len(self._progression.store))

    def progressed(self, location: Location, symbol: int, times: Times) -> Progression:
        """Progression at the state to which a step leads, for asking about parts of a formula."""
        self._progression.begin(symbol, times)
        self._progression.progress(location.node, fresh=location is self.initial)
        return self._progression

    def _find(self, location: Location, symbol: int, times: Times) -> Move:
        progression = self.progressed(location, symbol, times)
        node = progression.progress(location.node, fresh=location is self.initial)
        questions = list(progression.chronology.asked.items())
        move = self._move(node)
        self.has_news = True
        location.moves[symbol] = _grafted(location.moves.get(symbol), questions, move)
        return move

    def _move(self, node: Node) -> Move:
        """The step that leaves a node, whose bounds count from any of the states."""
        bounds = bounds_of(node)
        kept = tuple(sorted({bound.state for bound in bounds}))
        numbers = {state: number for number, state in enumerate(kept)}
        renumbered = {bound: Bound(numbers[bound.state], bound.offset) for bound in bounds}
        node = self._progression.store.renumbered(node, renumbered)
        target = self._locations.get(node)
        if target is None:
            target = self._locations[node] = _location(node, len(kept))
            self.largest = max(self.largest, node.size)
        return Move(target, kept, _selection(kept))


def nested_without_end(formula: Node) -> bool:
    """Whether there are windows without an end that may open later than the formula."""
    windows = [each for each in descendants([formula]) if type(each) is Window]
    inner = descendants(side for window in windows for side in (window.left, window.right))
    return any(type(each) is Window and each.end is None for each in inner)


def sides(window: Window) -> Sides:
    """What makes out a window, but for its bounds."""
    return window.universal, window.left, window.right


def _location(node: Node, clocks: int) -> Location:
    verdict = node.value if type(node) is Constant else None
    return Location(node, clocks, verdict, tuple(dict.fromkeys(map(sides, node.unbounded))))


def _grafted(
    tree: Decision | None, questions: list[tuple[TimeQuestion, bool]], move: Move
) -> Decision:
    """A decision with one more branch; it goes another way only where it asked other questions."""
    root: Decision | None = None
    above: tuple[Guard, bool] | None = None
    for question, answer in questions:
        if not (type(tree) is Guard and (tree.later, tree.earlier, tree.more_than) == question):
            tree = Guard(*question)
        root = root or tree
        if above:
            _attach(*above, tree)
        above = tree, answer
        tree = tree.yes if answer else tree.no
    if above:
        _attach(*above, move)
    return root or move


def _attach(guard: Guard, answer: bool, decision: Decision) -> None:  # noqa: FBT001
    if answer:
        guard.yes = decision
    else:
        guard.no = decision


def _selection(kept: tuple[int, ...]) -> Callable[[Times], Times]:
    match kept:
        case ():
            return lambda _: ()
        case (number,):
            return lambda times: (times[number],)
        case _:
            return itemgetter(*kept)
