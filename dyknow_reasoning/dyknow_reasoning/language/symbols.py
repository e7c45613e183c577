"""The names in formulas: what they stand for, and the symbols that need streams or objects.

The links of a spatial operator, and the variable that moves along them, are of its `over`.

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

from dyknow_common import PositionedError, Symbol, SymbolKind, unused_name
from dyknow_reasoning.language.formula import (
    Comparison,
    Formula,
    contains,
    is_about_one_state,
    parts,
    walk,
    with_changed_parts,
)
from dyknow_reasoning.language.spatial import ANY_DISTANCE, LinkEnd, Over, Spatial
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


def with_links(formula: Formula) -> Formula:
    """Return a formula whose spatial operators know their links.

    Raises:
        PositionedError: for an operator that no `over` encloses, that measures links without a
            length, or that has an operand about other states where it needs the present one; for
            links that do not depend on the present state alone.
    """
    found: Formula = _with_links(formula, None)
    return found


def _with_links(node: Any, over: Over | None) -> Any:
    if isinstance(node, Over):
        _check_links(node)
        over = node
    elif isinstance(node, Spatial):
        if over is None:
            message = (
                'operators of space need links between objects; write, for example, '
                "'over (Dist[a, b] <= 50 m for a, b in Robot) from r to s: somewhere...'"
            )
            raise PositionedError(message, node.position)
        if node.distances.is_any:  # Links need no length.
            node = replace(node, distances=ANY_DISTANCE)
        _check_operator(node, over.links)
        node = replace(node, place=over.variable, links=over.links)
    return with_changed_parts(node, lambda part: _with_links(part, over))


def _check_operator(node: Spatial, links: LinkEnd) -> None:
    if not node.distances.hops and links.link.weight is None:
        message = (
            f"'{node.distances}' measures lengths, and the links have none; count "
            "them, as in [0, 3 hops], or give them a length: 'over (LINK by LENGTH for ...)'"
        )
        raise PositionedError(message, node.position)
    start, end = node.distances.start, node.distances.end
    if end is not None and not node.distances.quantities and start.value > end.value:
        message = f"the interval '{node.distances}' is empty; it must end after it begins"
        raise PositionedError(message, node.position)
    along = node.right if node.operator == 'escape' else node.left
    if along is not None and not is_about_one_state(along):
        message = (
            f"'{along}' must hold along a route of one state, so it must not look at other states; "
            'only what holds at the end of a route may'
        )
        raise PositionedError(message, along.position)


def _check_links(node: Over) -> None:
    link = node.links.link
    if not is_about_one_state(link) or contains(link, Over | Spatial):
        message = 'links depend on the present state alone; leave out operators of time and space'
        raise PositionedError(message, node.position)
    second = node.links.body.variable
    for part in link.place:
        if Variable(second) in walk(part):
            of = node.links.variable
            message = f"'delaunay' takes x and y of '{of}' alone, not of '{second}'"
            raise PositionedError(message, part.position)
    names = {each.name for each in walk(link) if isinstance(each, Object | Variable)}
    if node.variable in names:
        message = f"the links do not depend on '{node.variable}', which moves along them"
        raise PositionedError(message, node.position)
