"""Why a formula was decided, in words for those who operate the robot.

Nothing is kept for this while a formula is undecided but the time from which its windows without an
end are open: what remained of the formula before the deciding state, and that state, tell the rest.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from dyknow_reasoning.atoms import NEGATED_COMPARISONS, Values, evaluate
from dyknow_reasoning.formula import (
    Comparison,
    Interval,
    Number,
    Term,
    Text,
    Truth,
)
from dyknow_reasoning.nodes import (
    TRUE,
    Constant,
    Junction,
    Literal,
    Node,
    Window,
    constant,
    descendants,
)
from dyknow_reasoning.residual import residual_text
from dyknow_stream_processing import Value, round_time

if TYPE_CHECKING:
    from collections.abc import Mapping

    from dyknow_reasoning.grounding import Instance
    from dyknow_reasoning.progression import Progression

_MOST_REASONS = 4
_LONGEST_FORMULA = 160
_MIRRORED = {'<': '>', '<=': '>=', '>': '<', '>=': '<=', '=': '=', '!=': '!='}


@dataclass(frozen=True, slots=True)
class Moment:
    """The state that decides an instance of a formula.

    Args:
        instance: which instance.
        node: what remained of it before this state.
        symbol: the truth of its atoms at this state.
        elapsed: the nanoseconds from the state before; 0 at the first.
        valid_time: of this state, in nanoseconds.
        values: of this state.
        opened: the valid time from which each window without an end has been open.
    """

    instance: Instance
    node: Node
    symbol: int
    elapsed: int
    valid_time: int
    values: Values
    opened: Mapping[Window, int]


def explain(moment: Moment, progression: Progression) -> str:
    """What decided the formula: the objects, their values, and what was due since when."""
    return _Explainer(moment, progression).text()


_Sides: TypeAlias = tuple[bool, Node, Node]


class _Explainer:
    def __init__(self, moment: Moment, progression: Progression) -> None:
        self._moment = moment
        self._progression = progression
        self._atoms = moment.instance.atoms
        self._intervals = _fresh_intervals(moment.instance.node)

    def text(self) -> str:
        moment = self._moment
        reasons = list(dict.fromkeys(self._reasons(moment.node, moment.elapsed)))
        shown = '; '.join(reasons[:_MOST_REASONS])
        more = len(reasons) - _MOST_REASONS
        shown += f'; and {more} more' if more > 0 else ''
        pairs = moment.instance.binding.items()
        binding = ', '.join(f'{variable} = {name}' for variable, name in pairs)
        return f'for {binding}: {shown}' if binding else shown

    def _progressed(self, node: Node, elapsed: int) -> Node:
        return self._progression.progress(node, self._moment.symbol, elapsed)

    def _reasons(self, node: Node, elapsed: int) -> list[str]:
        """Why the state decides a node."""
        match node:
            case Literal():
                return [self._fact(node)]
            case Junction():
                return self._reasons_of_junction(node, elapsed)
            case Window():
                return self._reasons_of_window(node, elapsed)
            case Constant():
                return [f'there is a state at {round_time(self._moment.valid_time)}']

    def _reasons_of_junction(self, node: Junction, elapsed: int) -> list[str]:
        verdict = self._progressed(node, elapsed)
        deciding = [part for part in node.parts if self._progressed(part, elapsed) is verdict]
        if not deciding:
            wanted = 'always be true' if verdict is TRUE else 'never be true'
            return [f"'{self._formula(node)}' can from now on {wanted}"]
        if verdict is constant(value=not node.universal):
            deciding = deciding[:1]
        return [reason for part in deciding for reason in self._reasons(part, elapsed)]

    def _reasons_of_window(self, node: Window, elapsed: int) -> list[str]:
        if self._progressed(node, elapsed) is not constant(value=node.universal):
            return self._during(node, elapsed, self._reasons(node.right, 0))
        if node.end is not None and node.end <= elapsed:
            return self._reasons_of_closed_window(node, node.end, elapsed)
        return self._during(node, elapsed, self._reasons(node.left, 0))

    def _reasons_of_closed_window(self, node: Window, end: int, elapsed: int) -> list[str]:
        right = self._formula(node.right)
        closed = self._moment.valid_time - elapsed + end
        opened = self._opened(node, elapsed)
        start = '' if opened is None else f'from {round_time(opened)} '
        span = f'{start}to {round_time(closed)}'
        if node.universal:
            return [f"'{right}' held at every state {span}"]
        last = self._reasons(node.right, 0) if end == elapsed else []
        return [f"'{right}' held at no state {span}", *last]

    def _during(self, node: Window, elapsed: int, reasons: list[str]) -> list[str]:
        """The reasons, with the obligation that was pending, if it began at an earlier state."""
        origin = self._origin(node, elapsed)
        if origin is None or elapsed == 0:
            return reasons
        due = 'awaited' if self._progressed(node, elapsed) is TRUE else 'must hold'
        return [f'{" and ".join(reasons)} ({_operator(node)} {due} since {round_time(origin)})']

    def _opened(self, node: Window, elapsed: int) -> int | None:
        """The valid time at which a window began to look at its right side."""
        origin, interval = self._origin(node, elapsed), self._interval(node)
        return None if origin is None or interval is None else origin + interval.start

    def _origin(self, node: Window, elapsed: int) -> int | None:
        """The valid time of the state from which a window counts, where that can be told."""
        before = self._moment.valid_time - elapsed
        if node.end is None:
            return self._moment.opened.get(node, before)
        interval = self._interval(node)
        if interval is None or interval.end is None:
            return None
        return before + node.end - interval.end

    def _interval(self, node: Window) -> Interval | None:
        """The interval that a window had when it was fresh, where that can be told."""
        intervals = self._intervals[node.universal, node.left, node.right]
        return next(iter(intervals)) if len(intervals) == 1 else None

    def _formula(self, node: Node) -> str:
        text = residual_text(node, self._atoms)
        return text if len(text) <= _LONGEST_FORMULA else f'{text[:_LONGEST_FORMULA]}...'

    def _fact(self, literal: Literal) -> str:
        """The value of an atom, beside what the formula says of it."""
        atom = self._atoms[literal.slot]
        time = round_time(self._moment.valid_time)
        if not isinstance(atom, Comparison):
            return f'{atom} is {_spelled(self._moment.values[str(atom)])} at {time}'
        holds = (self._moment.symbol >> literal.slot & 1) == literal.positive
        operator, left, right = atom.operator, atom.left, atom.right
        if not literal.positive:
            operator = NEGATED_COMPARISONS[operator]
        if isinstance(left, Number | Text | Truth):
            operator, left, right = _MIRRORED[operator], right, left
        sides = self._with_value(left), self._with_value(right)
        return f'{sides[0]} at {time} is {"" if holds else "not "}{operator} {sides[1]}'

    def _with_value(self, term: Term) -> str:
        if isinstance(term, Number | Text | Truth):
            return str(term)
        value = evaluate(term, self._moment.values)
        return f'{term} = {_spelled(value)}'


def _operator(node: Window) -> str:
    if node.left is constant(value=not node.universal):
        return 'always' if node.universal else 'eventually'
    return 'not until' if node.universal else 'until'


def _spelled(value: Value) -> str:
    match value:
        case bool():
            return str(Truth(value))
        case str():
            return str(Text(value))
        case float():
            return f'{float(f"{value:.9g}")}'
        case _:
            return str(value)


def _fresh_intervals(node: Node) -> Mapping[_Sides, set[Interval]]:
    intervals: defaultdict[_Sides, set[Interval]] = defaultdict(set)
    for window in descendants([node]):
        if type(window) is Window:
            sides = (window.universal, window.left, window.right)
            intervals[sides].add(Interval(window.start, window.end))
    return intervals
