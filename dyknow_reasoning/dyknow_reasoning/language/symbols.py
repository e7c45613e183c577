"""The names in formulas: what they stand for, and the symbols that need streams or objects.

`with_objects` puts objects in place of variables where the text of a formula or term is used.
Comparisons with equal texts share their values, so the text of a ground term must tell its objects
from the variables that it binds. For `k = a`, the text of `max(X[a] - X[k] for a in S)` is
`max(X[a_2] - X[a] for a_2 in S)`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, TypeAlias

from dyknow_common import Symbol, SymbolKind, unused_name
from dyknow_reasoning.language.formula import (
    Comparison,
    Formula,
    parts,
    walk,
    with_changed_parts,
)
from dyknow_reasoning.language.spatial import Spatial
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


Binding: TypeAlias = Mapping[str, str]
"""The object of each variable."""


def with_objects(node: Any, binding: Binding) -> Any:
    """Return a formula or a term with objects in place of its bound variables, for its text.

    An inner variable with the name of such an object has another name in the text.
    """
    if isinstance(node, Variable) and node.name in binding:
        return Object(binding[node.name])
    if isinstance(node, Quantifier) and node.variable in binding.values():
        node = _apart_from_objects(node, binding)
    return with_changed_parts(node, lambda part: with_objects(part, binding))


def _apart_from_objects(node: Quantifier, binding: Binding) -> Quantifier:
    """Rename the variable of a quantifier if an object in its body will have the same name."""
    shown: Any = node
    nodes = list(walk(shown))
    variables = {each.name for each in nodes if isinstance(each, Variable)}
    objects = {binding[each] for each in variables & binding.keys()}
    if node.variable not in objects:
        return node
    taken = variables | objects | {each.name for each in nodes if isinstance(each, Object)}
    taken |= {each.variable for each in nodes if isinstance(each, Quantifier)}
    found: Quantifier = _renamed(node, node.variable, unused_name(node.variable, taken))
    return found


def _renamed(node: Any, variable: str, new: str) -> Any:
    node = with_changed_parts(node, lambda part: _renamed(part, variable, new))
    if isinstance(node, Variable) and node.name == variable:
        return replace(node, name=new)
    if isinstance(node, Quantifier) and node.variable == variable:
        return replace(node, variable=new)
    if isinstance(node, Spatial) and node.place == variable:
        return replace(node, place=new)
    return node
