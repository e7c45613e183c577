"""The names in formulas: what they stand for, and the symbols that need streams or objects."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any

from dyknow_common import Symbol, SymbolKind
from dyknow_reasoning.language.formula import (
    Comparison,
    Formula,
    parts,
    walk,
    with_changed_parts,
)
from dyknow_reasoning.language.terms import (
    Feature,
    FieldReference,
    Object,
    Quantifier,
    Term,
    Variable,
    holds_terms,
)


def symbols_of(formula: Formula) -> list[Symbol]:
    """Return the symbols of a formula in the order of its text, each once."""
    return list(dict.fromkeys(_symbols(formula, {})))


def _symbols(node: Formula | Term, sorts: Mapping[str, str]) -> Iterator[Symbol]:
    match node:
        case Feature() | FieldReference():
            yield feature_symbol(node, sorts)
        case Object(name):
            yield Symbol(SymbolKind.OBJECT, name)
        case Quantifier(variable, sort):
            yield Symbol(SymbolKind.SORT, sort)
            sorts = {**sorts, variable: sort}
    for part in parts(node):
        yield from _symbols(part, sorts)


def feature_symbol(node: Feature | FieldReference, sorts: Mapping[str, str]) -> Symbol:
    """Return the symbol of a feature whose variables range over some sorts."""
    if isinstance(node, FieldReference):
        return Symbol(SymbolKind.FEATURE, str(node))
    arguments = tuple(sorts.get(argument.name, argument.name) for argument in node.arguments)
    return Symbol(SymbolKind.FEATURE, node.name, arguments)


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
