"""Resolution of the names in a formula: variables, objects or features without arguments."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

from dyknow_reasoning.language.formula import (
    Comparison,
    Formula,
    walk,
    with_changed_parts,
)
from dyknow_reasoning.language.terms import (
    Feature,
    Object,
    Quantifier,
    Term,
    Variable,
    holds_terms,
)

_Names = frozenset[str]


def resolve(formula: Formula) -> Formula:
    """Return a formula in which every name is a variable, an object or a feature.

    Rules as in `parse_formula`.
    """
    resolved: Formula = _resolved(formula, _object_names(formula), frozenset(), is_operand=False)
    return resolved


def _object_names(formula: Formula) -> _Names:
    """Return the names of objects and variables, from their uses in the whole formula."""
    nodes = list(walk(formula))
    names = {node.name for node in nodes if isinstance(node, Object | Variable)}
    names |= {node.variable for node in nodes if isinstance(node, Quantifier)}
    compared: dict[str, set[str]] = defaultdict(set)
    for pair in map(_compared_names, nodes):
        for name in pair:
            compared[name] |= pair
    pending = list(names)
    while pending:
        found = compared[pending.pop()] - names
        names |= found
        pending += found
    return frozenset(names)


def _compared_names(node: Formula | Term) -> set[str]:
    if not isinstance(node, Comparison) or node.operator not in {'=', '!='}:
        return set()
    sides = (node.left, node.right)
    return {side.name for side in sides if isinstance(side, Feature) and not side.arguments}


def _resolved(node: Any, objects: _Names, bound: _Names, *, is_operand: bool) -> Any:
    match node:
        case Feature(name, ()) if is_operand and name in objects | bound:
            kind = Variable if name in bound else Object
            return kind(name, position=node.position)
        case Object(name) if name in bound:
            return Variable(name, position=node.position)
        case Quantifier():
            bound |= {node.variable}
    are_operands = holds_terms(node)
    return with_changed_parts(
        node, lambda part: _resolved(part, objects, bound, is_operand=are_operands)
    )
