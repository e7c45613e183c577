"""Explanation of a verdict, for those who operate the robot.

The explanation follows from the remaining formula before the deciding state and from this state.
The only data that is kept for it is the time since which each window without an end is open.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

from dyknow_common import Value, round_time
from dyknow_reasoning.execution import DecidingMoment, InstanceVerdict
from dyknow_reasoning.explanation.residual import (
    interval_of,
    parts_in_order,
    remaining_text,
    residual_text,
)
from dyknow_reasoning.language.formula import Comparison, Interval, Number, Term, TextLiteral, Truth
from dyknow_reasoning.progression.atoms import NEGATED_COMPARISONS, Values, evaluate
from dyknow_reasoning.progression.nodes import (
    TRUE,
    Constant,
    Junction,
    Literal,
    Node,
    Sides,
    Window,
    constant,
    descendants,
    sides,
)
from dyknow_reasoning.progression.progression import Progression

_MAX_REASONS = 4
_MAX_FORMULA_LENGTH = 160
_MIRRORED = {'<': '>', '<=': '>=', '>': '<', '>=': '<=', '=': '=', '!=': '!='}


def explain(verdict: InstanceVerdict, values: Values) -> str:
    """Return the reasons of a verdict: objects, values, and the times of pending obligations.

    Args:
        verdict: the verdict on the instance that decides the formula.
        values: the values of the deciding state.
    """
    instance, moment = verdict.instance, verdict.moment
    if moment is None:
        why = f'what remained can only be {verdict.holds}'.lower()
    else:
        why = _Explainer(moment, values).text()
    objects = ', '.join(f'{variable} = {name}' for variable, name in instance.binding.items())
    why = f'for {objects}: {why}' if objects else why
    if instance.gap is None:
        return why
    return f'{why}; so it is whatever the states were that are missing {instance.gap}'


class _Explainer:
    """Explains why a state decides a node, by progressing the parts of the node."""

    def __init__(self, moment: DecidingMoment, values: Values) -> None:
        before = moment.before
        self._before = before
        self._symbol = moment.symbol
        self._values = values
        self._now = moment.valid_time
        self._times = (*before.times, moment.valid_time)
        self._progression = Progression([before.node])
        self._progression.begin(moment.symbol, self._times)
        self._atoms = before.instance.atoms
        self._intervals = _intervals(before.instance.node)

    def text(self) -> str:
        """Return the reasons, shortened."""
        found = self._reasons(self._before.node, fresh=self._before.is_fresh)
        reasons = list(dict.fromkeys(found))
        shown = '; '.join(reasons[:_MAX_REASONS])
        more = len(reasons) - _MAX_REASONS
        return f'{shown}; and {more} more' if more > 0 else shown

    def _progressed(self, node: Node, *, fresh: bool) -> Node:
        return self._progression.progress(node, fresh=fresh)

    def _reasons(self, node: Node, *, fresh: bool) -> list[str]:
        """Return the reasons why the state decides a node."""
        match node:
            case Literal():
                return [self._fact(node)]
            case Junction():
                return self._reasons_of_junction(node, fresh=fresh)
            case Window():
                return self._reasons_of_window(node, fresh=fresh)
            case Constant():
                return [f'there is a state at {round_time(self._now)}']

    def _reasons_of_junction(self, node: Junction, *, fresh: bool) -> list[str]:
        verdict = self._progressed(node, fresh=fresh)
        parts = parts_in_order(node, self._atoms)
        deciding = [part for part in parts if self._progressed(part, fresh=fresh) is verdict]
        if not deciding:
            wanted = 'always be true' if verdict is TRUE else 'never be true'
            return [f"'{self._remaining(node, fresh=fresh)}' can from now on {wanted}"]
        if verdict is constant(value=not node.universal):
            deciding = deciding[:1]
        return [reason for part in deciding for reason in self._reasons(part, fresh=fresh)]

    def _reasons_of_window(self, node: Window, *, fresh: bool) -> list[str]:
        if self._progressed(node, fresh=fresh) is not constant(value=node.universal):
            return self._during(node, self._reasons(node.right, fresh=True), fresh=fresh)
        origin = self._origin(node, fresh=fresh)
        if node.end is None or origin is None or origin + node.end.offset > self._now:
            return self._during(node, self._reasons(node.left, fresh=True), fresh=fresh)
        end = origin + node.end.offset
        intervals = self._intervals[sides(node)]
        start = origin + next(iter(intervals)).start
        from_start = f'from {round_time(start)} ' if len(intervals) == 1 else ''
        span = f'{from_start}to {round_time(end)}'
        right = _shortened(residual_text(node.right, self._atoms))
        if node.universal:
            return [f"'{right}' held at every state {span}"]
        last = self._reasons(node.right, fresh=True) if end == self._now else []
        return [f"'{right}' held at no state {span}", *last]

    def _during(self, node: Window, reasons: list[str], *, fresh: bool) -> list[str]:
        """Return the reasons, with the pending obligation if it began at an earlier state."""
        origin = self._origin(node, fresh=fresh)
        if origin is None or fresh:
            return reasons
        due = 'awaited' if self._progressed(node, fresh=fresh) is TRUE else 'must hold'
        return [f'{" and ".join(reasons)} ({_operator(node)} {due} since {round_time(origin)})']

    def _origin(self, node: Window, *, fresh: bool) -> int | None:
        """Return the valid time of the state that a window counts from; None if it is unknown."""
        if fresh:
            return self._now
        if node.end is None:
            return self._before.window_origins.get(sides(node))
        return self._times[node.end.state]

    def _remaining(self, node: Junction, *, fresh: bool) -> str:
        """Return the text of what remains of a junction after this state."""
        progressed = (
            self._progressed(part, fresh=fresh) for part in parts_in_order(node, self._atoms)
        )
        texts = (
            f'({remaining_text(part, self._times, self._now, self._atoms)})'
            for part in progressed
            if type(part) is not Constant
        )
        return _shortened((' and ' if node.universal else ' or ').join(texts))

    def _fact(self, literal: Literal) -> str:
        """Return the value of an atom at this state, compared with its bound."""
        atom = self._atoms[literal.slot]
        time = round_time(self._now)
        if not isinstance(atom, Comparison):
            return f'{atom} is {_literal_text(self._values[str(atom)])} at {time}'
        holds = (self._symbol >> literal.slot & 1) == literal.positive
        operator, left, right = atom.operator, atom.left, atom.right
        if not literal.positive:
            operator = NEGATED_COMPARISONS[operator]
        if isinstance(left, Number | TextLiteral | Truth):
            operator, left, right = _MIRRORED[operator], right, left
        first, second = self._with_value(left), self._with_value(right)
        return f'{first} at {time} is {"" if holds else "not "}{operator} {second}'

    def _with_value(self, term: Term) -> str:
        if isinstance(term, Number | TextLiteral | Truth):
            return str(term)
        value = evaluate(term, self._values)
        return f'{term} = {_literal_text(value)}'


def _shortened(text: str) -> str:
    return text if len(text) <= _MAX_FORMULA_LENGTH else f'{text[:_MAX_FORMULA_LENGTH]}...'


def _operator(node: Window) -> str:
    if node.left is constant(value=not node.universal):
        return 'always' if node.universal else 'eventually'
    return 'not until' if node.universal else 'until'


def _literal_text(value: Value) -> str:
    match value:
        case bool():
            return str(Truth(value))
        case str():
            return str(TextLiteral(value))
        case float():
            return f'{float(f"{value:.9g}")}'
        case _:
            return str(value)


def _intervals(node: Node) -> Mapping[Sides, set[Interval]]:
    intervals: defaultdict[Sides, set[Interval]] = defaultdict(set)
    for window in descendants([node]):
        if type(window) is Window:
            intervals[sides(window)].add(interval_of(window))
    return intervals
