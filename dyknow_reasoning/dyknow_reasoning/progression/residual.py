"""The text of a node: the formula that remains after some states."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from operator import attrgetter
from typing import Final

from dyknow_common import ExitCode, printable, shortened
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.language.formula import (
    Atom,
    Comparison,
    Formula,
    Not,
    PastAtom,
    looks_forward,
)
from dyknow_reasoning.language.interval import Interval
from dyknow_reasoning.language.terms import operand_text
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import (
    FALSE,
    TRUE,
    AtLeast,
    Bound,
    Chronology,
    Constant,
    Junction,
    Literal,
    Node,
    PastWindow,
    Remembering,
    Sides,
    Window,
    bounds_of,
    children,
    pending_parts,
    reachable,
    sides,
)


@dataclass(frozen=True, slots=True)
class Wording:
    """The parts of a formula as its text states them.

    Args:
        formulas: the parts, by the nodes that they stand for.
        operators: the words of operators that are written out, by their windows.
    """

    formulas: Mapping[Node, Formula] = field(default_factory=dict)
    operators: Mapping[Sides, str] = field(default_factory=dict)

    def of(self, node: Node) -> Formula | None:
        """Return the formula that a node stands for; None for a part of one that has no words."""
        is_part = isinstance(node, Window) and sides(node) in self.operators
        return None if is_part else self.formulas.get(node)


_NO_WORDING: Final = Wording()


def residual_text(node: Node, atoms: Sequence[Atom], wording: Wording = _NO_WORDING) -> str:
    """Return the text of a node, about the states after the latest one.

    Args:
        node: a formula whose bounds count from the latest state.
        atoms: the atom of each slot.
        wording: the wording of the formula; without it, the text is canonical.
    """
    texts: dict[Node, str] = {}
    # From the leaves up instead of by recursion: a remaining formula may nest very deeply.
    found = reachable([node], lambda each: () if wording.of(each) else children(each))
    for part in sorted(found, key=attrgetter('depth')):
        said = wording.of(part)
        texts[part] = str(said) if said else _text(part, texts, atoms, wording)
    return texts[node]


def remaining_text(
    node: Node,
    times: Sequence[int],
    now: int,
    atoms: Sequence[Atom],
    wording: Wording = _NO_WORDING,
) -> str:
    """Return the text of a node, with intervals that count from the present state.

    Args:
        node: a remaining formula.
        times: the times of the states that its bounds count from, in nanoseconds.
        now: the time of the present state.
        atoms: the atom of each slot.
        wording: the wording of the formula; without it, the text is canonical.
    """
    bounds = {each: Bound(0, times[each.state] + each.offset - now) for each in bounds_of(node)}
    counted = NodeStore(Chronology(), [node]).renumbered(node, bounds)
    return printable(residual_text(counted, atoms, wording))


def growth_error(size: int, limit: int, node: Node, atoms: Sequence[Atom]) -> ReasoningError:
    """Return the error of a formula that has grown too large, which names its largest part.

    Args:
        size: the number of nodes that remain of it.
        limit: the most that may remain.
        node: what remains of it, or of one of its instances.
        atoms: the atom of each slot.
    """
    open_windows: defaultdict[Sides, list[Window]] = defaultdict(list)
    for each in pending_parts(node):
        if type(each) is Window:
            open_windows[sides(each)].append(each)
    most = max(open_windows.values(), key=lambda found: len(found) * found[0].size, default=[])
    part = f': {len(most)} windows of {shortened(residual_text(most[0], atoms))}' if most else ''
    return ReasoningError(
        f"the formula has grown to {size} nodes, more than {limit} (the limit 'node_limit'){part}; "
        'bound its intervals, lengthen the sample period, or raise the limit',
        ExitCode.UNAVAILABLE,
    )


def awaited_comparison(node: Window, atoms: Sequence[Atom]) -> Comparison | None:
    """Return the comparison of a probability that depends on later states, from its window.

    Either side of the window is the comparison that may become known, or its opposite.
    """
    for side in (node.left, node.right):
        if type(side) is Literal and side.positive:
            atom = atoms[side.slot]
            found = atom.formula if isinstance(atom, PastAtom) else atom
            if isinstance(found, Comparison) and looks_forward(found):
                return found
    return None


def holds_at_the_end(node: Node) -> bool:
    """Return True if a remaining formula holds if no further state comes.

    Universal windows hold then, existential ones do not. Literals and operators of the past of a
    formula that has seen no state count as true.
    """
    found: dict[Node, bool] = {}
    for each in pending_parts(node):
        match each:
            case Junction():
                combine = all if each.universal else any
                found[each] = combine(found[part] for part in each.parts)
            case AtLeast():
                found[each] = sum(found[part] for part in each.parts) >= each.count
            case Window():
                found[each] = each.universal
            case Remembering():
                found[each] = found[each.formula]
            case _:
                found[each] = each is not FALSE
    return found[node]


def parts_in_order(node: Junction | AtLeast, atoms: Sequence[Atom]) -> Sequence[Node]:
    """Return the parts of a node in the order of their first atoms."""
    return sorted(node.parts, key=lambda part: _order(part, residual_text(part, atoms)))


def _order(part: Node, text: str) -> tuple[int, str, list[Bound]]:
    return part.mask & -part.mask, text, sorted(bounds_of(part))


def interval_of(node: Window) -> Interval:
    """Return the interval of a window whose bounds count from one state."""
    start = node.start.offset if node.start else 0
    return Interval(start, node.end.offset if node.end else None)


def _text(  # noqa: C901, PLR0911 - one for each kind
    node: Node, texts: Mapping[Node, str], atoms: Sequence[Atom], wording: Wording
) -> str:
    match node:
        case Constant():
            return 'true' if node.value else 'false'
        case Literal():
            return str(literal_formula(atoms[node.slot], positive=node.positive))
        case Junction() if weak := _weak_until(node, wording):
            sides_of = (_operand(each, texts, atoms) for each in (weak.left, weak.right))
            return f' unless{interval_of(weak).suffix} '.join(sides_of)
        case Junction():
            word = 'and' if node.universal else 'or'
            parts = sorted(node.parts, key=lambda part: _order(part, texts[part]))
            first, *others = (_operand(part, texts, atoms) for part in parts)
            *inner, last = others
            left = reduce(lambda left, right: f'({left} {word} {right})', inner, first)
            return f'{left} {word} {last}'
        case AtLeast():
            parts = sorted(node.parts, key=lambda part: _order(part, texts[part]))
            return f'at least {node.count} of ({", ".join(texts[part] for part in parts)})'
        case Window():
            words = ('always', 'eventually', 'until')
            return _window_text(node, interval_of(node), words, texts, atoms, wording)
        case PastWindow(universal, None):
            if universal:
                return f'not (previous {_negated(node.right, texts, atoms, wording)})'
            return f'previous {_operand(node.right, texts, atoms)}'
        case PastWindow(_, start, end):
            words = ('historically', 'once', 'since')
            return _window_text(node, Interval(start or 0, end), words, texts, atoms, wording)
        case Remembering():
            return texts[node.formula]


def _weak_until(node: Junction, wording: Wording) -> Window | None:
    """Return the `until` in the remainder of an `unless`."""
    if node.universal or len(node.parts) != 2:  # noqa: PLR2004 - until, or to the end
        return None
    for strong, weak in (node.parts, node.parts[::-1]):
        if (
            type(strong) is type(weak) is Window
            and wording.operators.get(sides(strong)) == 'unless'
            and (sides(weak), weak.start, weak.end)
            == ((True, FALSE, strong.left), None, strong.end)
        ):
            return strong
    return None


def _window_text(
    node: Window | PastWindow,
    interval: Interval,
    words: tuple[str, str, str],
    texts: Mapping[Node, str],
    atoms: Sequence[Atom],
    wording: Wording,
) -> str:
    if isinstance(node, Window) and (awaited := awaited_comparison(node, atoms)):
        return str(awaited)
    every, some, joined = (f'{word}{interval.suffix}' for word in words)
    right = _operand(node.right, texts, atoms)
    if node.left is FALSE and node.universal:
        return f'{every} {right}'
    if node.left is TRUE and not node.universal:
        return f'{some} {right}'
    word = wording.operators.get(sides(node)) if isinstance(node, Window) else None
    if word in {'release', 'holds until'}:
        joined = f'{word}{interval.suffix}'
    elif node.universal:
        left, right = (_negated(side, texts, atoms, wording) for side in (node.left, node.right))
        return f'not ({left} {joined} {right})'
    return f'{_operand(node.left, texts, atoms)} {joined} {right}'


def _operand(node: Node, texts: Mapping[Node, str], atoms: Sequence[Atom]) -> str:
    match node:
        case Constant():
            return texts[node]
        case Literal():
            return operand_text(literal_formula(atoms[node.slot], positive=node.positive))
        case _:
            return f'({texts[node]})'


def _negated(node: Node, texts: Mapping[Node, str], atoms: Sequence[Atom], wording: Wording) -> str:
    if type(node) is Literal:
        return operand_text(literal_formula(atoms[node.slot], positive=not node.positive))
    said = wording.of(node)
    if isinstance(said, Not):
        return operand_text(said.body)
    return f'(not {_operand(node, texts, atoms)})'


def literal_formula(atom: Atom, *, positive: bool) -> Formula:
    """Return an atom or its negation."""
    if positive:
        return atom
    return atom.opposite if isinstance(atom, Comparison) else Not(atom)
