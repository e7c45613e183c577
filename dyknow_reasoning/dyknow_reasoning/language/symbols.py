"""Extraction of the symbols of formulas."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from dyknow_common import Symbol, SymbolKind
from dyknow_reasoning.language.formula import (
    Formula,
    parts,
)
from dyknow_reasoning.language.terms import (
    Feature,
    FieldReference,
    Object,
    Quantifier,
    Term,
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
