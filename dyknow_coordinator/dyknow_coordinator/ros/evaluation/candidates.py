"""Search for the streams that carry the features of a formula (step 5)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Final

from dyknow_common import DyKnowError, ExitCode, Symbol
from dyknow_coordinator.grounding.feature_sources import (
    Candidates,
    FeatureSource,
    Grounding,
    parse_sources,
    referenced_source,
    single_field_source,
)
from dyknow_coordinator.grounding.known_streams import KnownStreams
from dyknow_coordinator.grounding.symbols import concept_query, feature_symbols, sort_names
from dyknow_coordinator.ros.context import CoordinatorContext

_MANY: Final = 50
"""Specifications that take tens of milliseconds to parse."""


async def find_candidates(
    context: CoordinatorContext, symbols: Sequence[Symbol], grounding: Grounding
) -> Candidates:
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
                found.append(await _named_source(context, symbol))
            else:
                query = concept_query(symbol, sorts)
                texts = await context.clients.matching_streams(query)
                is_long = len(texts) > _MANY
                found += await context.background.run(partial(_parsed, texts), is_long=is_long)
        except DyKnowError as error:
            if error.code is not ExitCode.NOT_FOUND:
                raise
            source = await _fallback(context, symbol) if grounding is Grounding.AUTO else None
            if source is not None:
                found.append(source)
            else:
                nearest[str(symbol)] = error.message
    return Candidates(tuple(found), nearest)


def _parsed(texts: Sequence[str]) -> tuple[FeatureSource, ...]:
    sources = parse_sources(texts)
    for source in sources:
        KnownStreams.parse(source)
    return sources


async def _fallback(context: CoordinatorContext, symbol: Symbol) -> FeatureSource | None:
    """Return the stream that a symbol names, if there is one."""
    if not symbol.may_be_stream:
        return None
    try:
        return await _named_source(context, symbol)
    except DyKnowError as error:
        if error.code is not ExitCode.NOT_FOUND:
            raise
        return None


async def _named_source(context: CoordinatorContext, symbol: Symbol) -> FeatureSource:
    """Return the source of a symbol that is the name of a stream with one field."""
    # For an unknown name, the error of the stream manager lists the known ones.
    await context.clients.topic(symbol.name)
    await context.streams.wait_for(symbol.name)
    return single_field_source(symbol, context.streams.fields(symbol.name))
