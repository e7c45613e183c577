"""Search for the streams that carry the features among the symbols of a formula.

It is step 5 of section VII of the paper.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from dyknow_common import DyKnowError, ExitCode, Symbol, SymbolKind, unused_name
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.feature_sources import (
    Candidates,
    FeatureSource,
    Grounding,
    referenced_source,
    single_field_source,
)

OPEN_RELATION: Final = 'open_relation'
"""The text that distinguishes cases of unknown relations of regions; no stream contains it."""


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
    taken = {symbol.name, *symbol.arguments, *sorts}
    names = [
        unused_name(f'object{number}', taken) if argument in sorts else argument
        for number, argument in enumerate(symbol.arguments, start=1)
    ]
    ranges = [
        f'{name} in {argument}'
        for name, argument in zip(names, symbol.arguments, strict=True)
        if argument in sorts
    ]
    concept = f'{symbol.name}[{", ".join(names)}]' if names else symbol.name
    return f'{concept} for every {", ".join(ranges)}' if ranges else concept


@dataclass(frozen=True, slots=True)
class CandidateSearch:
    """Search for streams.

    Args:
        matching_sources: returns the sources that match a concept, best first; raises DyKnowError
            (NOT_FOUND) if there is none.
        stream_fields: returns the fields of the stream with a name; raises DyKnowError (NOT_FOUND)
            if there is none.
    """

    matching_sources: Callable[[str], Awaitable[tuple[FeatureSource, ...]]]
    stream_fields: Callable[[str], Awaitable[tuple[str, ...]]]

    async def find(self, symbols: Sequence[Symbol], grounding: Grounding) -> Candidates:
        """Return the sources of all features among symbols.

        Raises:
            DyKnowError: if a feature is invalid, or a node that is needed is unavailable.
        """
        found: list[FeatureSource] = []
        nearest: dict[str, str] = {}
        sorts = sort_names(symbols)
        for symbol in feature_symbols(symbols):
            try:
                if symbol.is_reference:
                    found.append(referenced_source(symbol))
                elif grounding is Grounding.SYNTACTIC:
                    found.append(await self._named_source(symbol))
                else:
                    found += await self.matching_sources(concept_query(symbol, sorts))
            except DyKnowError as error:
                if error.code is not ExitCode.NOT_FOUND:
                    raise
                source = await self._fallback(symbol) if grounding is Grounding.AUTO else None
                if source is not None:
                    found.append(source)
                else:
                    nearest[str(symbol)] = error.message
        return Candidates(tuple(found), nearest)

    async def _fallback(self, symbol: Symbol) -> FeatureSource | None:
        """Return the stream that a symbol names, if there is one."""
        if not symbol.may_be_stream:
            return None
        try:
            return await self._named_source(symbol)
        except DyKnowError as error:
            if error.code is not ExitCode.NOT_FOUND:
                raise
            return None

    async def _named_source(self, symbol: Symbol) -> FeatureSource:
        """Return the source of a symbol that is the name of a stream with one field."""
        return single_field_source(symbol, await self.stream_fields(symbol.name))
