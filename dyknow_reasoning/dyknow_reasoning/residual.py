"""The text of a node: a formula as it stands after some states."""

from __future__ import annotations

from functools import reduce
from operator import attrgetter
from typing import TYPE_CHECKING

from dyknow_reasoning.atoms import NEGATED_COMPARISONS
from dyknow_reasoning.formula import Atom, Comparison, Formula, Interval, Not
from dyknow_reasoning.nodes import (
    FALSE,
    TRUE,
    Constant,
    Junction,
    Literal,
    Node,
    Window,
    descendants,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


def residual_text(node: Node, atoms: Sequence[Atom]) -> str:
    """The canonical text of a node.

    Its intervals count from the latest state, and it speaks of the states after that one.

    Args:
        node: what remains of a formula.
        atoms: the atom of each slot.
    """
    texts: dict[Node, str] = {}
    # From the leaves up and not by recursion: what remains of a formula may nest very deeply.
    for part in sorted(descendants([node]), key=attrgetter('depth')):
        texts[part] = _text(part, texts, atoms)
    return texts[node]


def literal_formula(literal: Literal, atoms: Sequence[Atom]) -> Formula:
    """The atom of a literal, or its opposite."""
    atom = atoms[literal.slot]
    if literal.positive:
        return atom
    if isinstance(atom, Comparison):
        return Comparison(NEGATED_COMPARISONS[atom.operator], atom.left, atom.right)
    return Not(atom)


def _text(node: Node, texts: Mapping[Node, str], atoms: Sequence[Atom]) -> str:
    match node:
        case Constant():
            return 'true' if node.value else 'false'
        case Literal():
            return str(literal_formula(node, atoms))
        case Junction():
            word = 'and' if node.universal else 'or'
            members = [_operand(part, texts, atoms) for part in node.parts]
            first, *others = members
            return reduce(lambda left, right: f'({left} {word} {right})', others, first)[1:-1]
        case Window():
            return _window_text(node, texts, atoms)


def _window_text(node: Window, texts: Mapping[Node, str], atoms: Sequence[Atom]) -> str:
    interval = Interval(node.start, node.end).suffix
    left, right = (_operand(side, texts, atoms) for side in (node.left, node.right))
    if node.left is FALSE and node.universal:
        return f'always{interval} {right}'
    if node.left is TRUE and not node.universal:
        return f'eventually{interval} {right}'
    if node.universal:
        return f'not ((not {left}) until{interval} (not {right}))'
    return f'{left} until{interval} {right}'


def _operand(node: Node, texts: Mapping[Node, str], atoms: Sequence[Atom]) -> str:
    text = texts[node]
    leaf = type(node) is Constant or (
        type(node) is Literal and node.positive and not isinstance(atoms[node.slot], Comparison)
    )
    return text if leaf else f'({text})'
