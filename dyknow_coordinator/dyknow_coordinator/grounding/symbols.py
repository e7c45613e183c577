"""Symbols of a formula: which of them need streams, and the concepts to search streams for."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Final

from dyknow_common import Symbol, SymbolKind
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.feature_sources import Grounding

OPEN_RELATION: Final = 'open_relation'
"""The text that tells cases of unknown relations of regions apart; no stream has it."""


def feature_symbols(symbols: Iterable[Symbol]) -> tuple[Symbol, ...]:
    """Return the features among symbols that streams have."""
    return tuple(
        symbol
        for symbol in symbols
        if symbol.kind is SymbolKind.FEATURE and symbol.name != OPEN_RELATION
    )


def sort_names(symbols: Iterable[Symbol]) -> tuple[str, ...]:
    """Return the names of the sorts among symbols."""
    return tuple(symbol.name for symbol in symbols if symbol.kind is SymbolKind.SORT)


def check_symbols(symbols: Iterable[Symbol], grounding: Grounding) -> None:
    """Check that every feature can be grounded in the requested way.

    Raises:
        CoordinationError: names the first feature that cannot.
    """
    for symbol in feature_symbols(symbols):
        if grounding is Grounding.SYNTACTIC and not symbol.may_be_stream:
            raise CoordinationError(
                f"'{symbol}' names no stream, which syntactic grounding requires; write "
                f'stream.field or "/topic".field, or request semantic grounding'
            )
        if grounding is Grounding.SEMANTIC and symbol.is_reference:
            raise CoordinationError(
                f"'{symbol}' names a stream; with semantic grounding write a feature of the "
                f'ontology, or request grounding AUTO'
            )


def concept_query(symbol: Symbol, sorts: Collection[str]) -> str:
    """Return the query for the matching engine: `Power[object1] for every object1 in UAV`."""
    names = [
        f'object{number}' if argument in sorts else argument
        for number, argument in enumerate(symbol.arguments, start=1)
    ]
    ranges = [
        f'{name} in {argument}'
        for name, argument in zip(names, symbol.arguments, strict=True)
        if argument in sorts
    ]
    concept = f'{symbol.name}[{", ".join(names)}]' if names else symbol.name
    return f'{concept} for every {", ".join(ranges)}' if ranges else concept
