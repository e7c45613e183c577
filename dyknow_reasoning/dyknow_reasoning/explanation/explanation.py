"""Why a formula was decided, in words for those who operate the robot.

Nothing is kept for this while a formula is undecided but the time from which its windows without an
end are open: what remained of the formula before the deciding state, and that state, tell the rest.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

from dyknow_common import Value, round_time
from dyknow_reasoning.execution.automata.automaton import Sides, sides
from dyknow_reasoning.execution.automata.templates import DecidingMoment, InstanceVerdict
from dyknow_reasoning.explanation.residual import (
    interval_of,
    parts_in_order,
    remaining_text,
    residual_text,
)
from dyknow_reasoning.language.formula import Comparison, Interval, Number, Term, TextLiteral, Truth
from dyknow_reasoning.progression.atoms import NEGATED_COMPARISONS, Values, evaluate
from dyknow_reasoning.progression.instances import Binding, Instance
from dyknow_reasoning.progression.nodes import (
    TRUE,
    Constant,
    Junction,
    Literal,
    Node,
    Window,
    constant,
    descendants,
)

_MOST_REASONS = 4
_LONGEST_FORMULA = 160
_MIRRORED = {'<': '>', '<=': '>=', '>': '<', '>=': '<=', '=': '=', '!=': '!='}


def explain(finish: InstanceVerdict, values: Values) -> str:
    """What decided the formula: the objects, their values, and what was due since when.

    Args:
        finish: the instance that made the difference.
        values: of the state that decided it.
    """
    member, moment = finish.member, finish.moment
    if moment is None:
        why = _bound(f'what remained can only be {finish.verdict}'.lower(), member.instance.binding)
    else:
        why = _Explainer(member.instance, moment, values).text()
    if member.gap is None:
        return why
    return f'{why}; so it is whatever the states were that are missing {member.gap}'


class _Explainer:
    def __init__(self, instance: Instance, moment: DecidingMoment, values: Values) -> None:
        self._moment = moment
        self._values = values
        self._now = moment.times[-1]
        self._automaton = moment.shape.automaton
        self._progression = self._automaton.progressed(moment.location, moment.symbol, moment.times)
        self._binding = instance.binding
        self._atoms = instance.atoms
        self._intervals = _fresh_intervals(instance.node)

    def text(self) -> str:
        location = self._moment.location
        fresh = location is self._automaton.initial
        reasons = list(dict.fromkeys(self._reasons(location.node, fresh=fresh)))
        shown = '; '.join(reasons[:_MOST_REASONS])
        more = len(reasons) - _MOST_REASONS
        shown += f'; and {more} more' if more > 0 else ''
        return _bound(shown, self._binding)

    def _progressed(self, node: Node, *, fresh: bool) -> Node:
        return self._progression.progress(node, fresh=fresh)

    def _reasons(self, node: Node, *, fresh: bool) -> list[str]:
        """Why the state decides a node."""
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
        end = self._end(node, fresh=fresh)
        if end is not None and end <= self._now:
            return self._reasons_of_closed_window(node, end, fresh=fresh)
        return self._during(node, self._reasons(node.left, fresh=True), fresh=fresh)

    def _reasons_of_closed_window(self, node: Window, end: int, *, fresh: bool) -> list[str]:
        right = _shortened(residual_text(node.right, self._atoms))
        opened = self._opened(node, fresh=fresh)
        start = '' if opened is None else f'from {round_time(opened)} '
        span = f'{start}to {round_time(end)}'
        if node.universal:
            return [f"'{right}' held at every state {span}"]
        last = self._reasons(node.right, fresh=True) if end == self._now else []
        return [f"'{right}' held at no state {span}", *last]

    def _during(self, node: Window, reasons: list[str], *, fresh: bool) -> list[str]:
        """The reasons, with the obligation that was pending, if it began at an earlier state."""
        origin = self._origin(node, fresh=fresh)
        if origin is None or fresh:
            return reasons
        due = 'awaited' if self._progressed(node, fresh=fresh) is TRUE else 'must hold'
        return [f'{" and ".join(reasons)} ({_operator(node)} {due} since {round_time(origin)})']

    def _opened(self, node: Window, *, fresh: bool) -> int | None:
        """The valid time at which a window began to look at its right side."""
        origin, intervals = self._origin(node, fresh=fresh), self._intervals[sides(node)]
        if origin is None or len(intervals) > 1:
            return None
        return origin + next(iter(intervals)).start

    def _origin(self, node: Window, *, fresh: bool) -> int | None:
        """The valid time of the state from which a window counts, where that can be told."""
        if fresh:
            return self._now
        if node.end is None:
            return self._moment.opened.get(sides(node))
        return self._moment.times[node.end.state]

    def _end(self, node: Window, *, fresh: bool) -> int | None:
        if node.end is None:
            return None
        begin = self._now if fresh else self._moment.times[node.end.state]
        return begin + node.end.offset

    def _remaining(self, node: Junction, *, fresh: bool) -> str:
        """What remains of the parts of a junction after this state."""
        word = 'and' if node.universal else 'or'
        parts = parts_in_order(node, self._atoms)
        progressed = (self._progressed(part, fresh=fresh) for part in parts)
        times = self._moment.times
        texts = (
            remaining_text(part, times, self._now, self._atoms)
            for part in progressed
            if type(part) is not Constant
        )
        return _shortened(f' {word} '.join(f'({text})' for text in texts))

    def _fact(self, literal: Literal) -> str:
        """The value of an atom, beside what the formula says of it."""
        atom = self._atoms[literal.slot]
        time = round_time(self._now)
        if not isinstance(atom, Comparison):
            return f'{atom} is {_spelled(self._values[str(atom)])} at {time}'
        holds = (self._moment.symbol >> literal.slot & 1) == literal.positive
        operator, left, right = atom.operator, atom.left, atom.right
        if not literal.positive:
            operator = NEGATED_COMPARISONS[operator]
        if isinstance(left, Number | TextLiteral | Truth):
            operator, left, right = _MIRRORED[operator], right, left
        sides = self._with_value(left), self._with_value(right)
        return f'{sides[0]} at {time} is {"" if holds else "not "}{operator} {sides[1]}'

    def _with_value(self, term: Term) -> str:
        if isinstance(term, Number | TextLiteral | Truth):
            return str(term)
        value = evaluate(term, self._values)
        return f'{term} = {_spelled(value)}'


def _bound(reasons: str, binding: Binding) -> str:
    objects = ', '.join(f'{variable} = {name}' for variable, name in binding.items())
    return f'for {objects}: {reasons}' if objects else reasons


def _shortened(text: str) -> str:
    return text if len(text) <= _LONGEST_FORMULA else f'{text[:_LONGEST_FORMULA]}...'


def _operator(node: Window) -> str:
    if node.left is constant(value=not node.universal):
        return 'always' if node.universal else 'eventually'
    return 'not until' if node.universal else 'until'


def _spelled(value: Value) -> str:
    match value:
        case bool():
            return str(Truth(value))
        case str():
            return str(TextLiteral(value))
        case float():
            return f'{float(f"{value:.9g}")}'
        case _:
            return str(value)


def _fresh_intervals(node: Node) -> Mapping[Sides, set[Interval]]:
    intervals: defaultdict[Sides, set[Interval]] = defaultdict(set)
    for window in descendants([node]):
        if type(window) is Window:
            intervals[sides(window)].add(interval_of(window))
    return intervals
