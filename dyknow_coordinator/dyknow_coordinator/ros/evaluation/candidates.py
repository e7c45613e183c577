"""Finding the streams that carry the features of a formula (step 5)."""

from __future__ import annotations

from collections.abc import Sequence

from dyknow_common import DyKnowError, ExitCode, Symbol
from dyknow_coordinator.grounding.grounding import (
    Candidates,
    FeatureSource,
    Grounding,
    concept_of,
    features,
    only_field,
    referenced,
    sorts,
    sources,
)
from dyknow_coordinator.ros.context import CoordinatorContext


async def find_candidates(
    facilities: CoordinatorContext, symbols: Sequence[Symbol], grounding: Grounding
) -> Candidates:
    """The sources of all features among symbols, by meaning or by name.

    Raises:
        DyKnowError: when a feature makes no sense, or a node that is needed is not there.
    """
    found: list[FeatureSource] = []
    nearest: dict[str, str] = {}
    sort_names = sorts(symbols)
    for symbol in features(symbols):
        try:
            if symbol.is_reference:
                found.append(referenced(symbol))
            elif grounding is Grounding.SYNTACTIC:
                found.append(await _named(facilities, symbol))
            else:
                concept = concept_of(symbol, sort_names)
                found += sources(await facilities.clients.matching_streams(concept))
        except DyKnowError as error:
            if error.code is not ExitCode.NOT_FOUND:
                raise
            named = await _if_stream(facilities, symbol) if grounding is Grounding.AUTO else None
            if named is not None:
                found.append(named)
            else:
                nearest[str(symbol)] = error.message
    return Candidates(tuple(found), nearest)


async def _if_stream(facilities: CoordinatorContext, symbol: Symbol) -> FeatureSource | None:
    if not symbol.may_be_stream:
        return None
    try:
        return await _named(facilities, symbol)
    except DyKnowError as error:
        if error.code is not ExitCode.NOT_FOUND:
            raise
        return None


async def _named(facilities: CoordinatorContext, symbol: Symbol) -> FeatureSource:
    """The source of a symbol that is the name of a stream with one field."""
    # Who mistypes a name hears of those that there are.
    await facilities.clients.topic(symbol.name)
    await facilities.streams.hear_of(symbol.name)
    return only_field(symbol, facilities.streams.fields(symbol.name))
