"""Resolution of the names in a formula: variables, objects or features without arguments."""

from __future__ import annotations

from dataclasses import replace

from dyknow_reasoning.language.formula import (
    Always,
    And,
    Arithmetic,
    Comparison,
    Equivalent,
    Eventually,
    Exists,
    Feature,
    Forall,
    Formula,
    Implies,
    Not,
    Object,
    Or,
    Term,
    Until,
    Variable,
    walk,
)

_Names = frozenset[str]


def resolve(formula: Formula) -> Formula:
    """Return a formula in which every name is a variable, an object or a feature.

    The rules are those of `parse_formula`.
    """
    return _formula(formula, _names_of_objects(formula), frozenset())


def _names_of_objects(formula: Formula) -> _Names:
    """Return the names of objects and variables, from their uses in the whole formula."""
    nodes = list(walk(formula))
    names = {node.name for node in nodes if isinstance(node, Object | Variable)}
    names |= {node.variable for node in nodes if isinstance(node, Forall | Exists)}
    pairs = [pair for node in nodes if (pair := _compared_names(node))]
    known = -1
    while known != len(names):
        known = len(names)
        names.update(*(pair for pair in pairs if names & pair))
    return frozenset(names)


def _compared_names(node: Formula | Term) -> set[str]:
    if not isinstance(node, Comparison) or node.operator not in {'=', '!='}:
        return set()
    sides = (node.left, node.right)
    return {side.name for side in sides if isinstance(side, Feature) and not side.arguments}


def _formula(node: Formula, objects: _Names, bound: _Names) -> Formula:
    match node:
        case Comparison():
            return replace(
                node,
                left=_term(node.left, objects, bound),
                right=_term(node.right, objects, bound),
            )
        case Feature():
            return _feature(node, bound)
        case And() | Or() | Implies() | Equivalent() | Until():
            return replace(
                node,
                left=_formula(node.left, objects, bound),
                right=_formula(node.right, objects, bound),
            )
        case Not() | Always() | Eventually():
            return replace(node, body=_formula(node.body, objects, bound))
        case Forall() | Exists():
            return replace(node, body=_formula(node.body, objects, bound | {node.variable}))
        case _:
            return node


def _term(node: Term, objects: _Names, bound: _Names) -> Term:
    match node:
        case Arithmetic():
            return replace(
                node,
                left=_term(node.left, objects, bound),
                right=_term(node.right, objects, bound),
            )
        case Feature(name, ()) if name in bound:
            return Variable(name, position=node.position)
        case Feature(name, ()) if name in objects:
            return Object(name, position=node.position)
        case Feature():
            return _feature(node, bound)
        case _:
            return node


def _feature(node: Feature, bound: _Names) -> Feature:
    arguments = tuple(
        Variable(argument.name, position=argument.position) if argument.name in bound else argument
        for argument in node.arguments
    )
    return replace(node, arguments=arguments)
