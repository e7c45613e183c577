"""Search for the streams that carry the features of a formula (step 5 of section VII)."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass

from dyknow_common import DyKnowError, ExitCode, Symbol
from dyknow_coordinator.grounding.feature_sources import (
    Candidates,
    FeatureSource,
    Grounding,
    referenced_source,
    single_field_source,
)
from dyknow_coordinator.grounding.symbols import concept_query, feature_symbols, sort_names


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
