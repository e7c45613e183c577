"""Finding the streams that carry the features of a formula (step 5)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dyknow_coordinator.grounding import (
    Candidates,
    Grounding,
    concept_of,
    features,
    only_field,
    referenced,
    sorts,
    sources,
)
from dyknow_stream_processing import DyKnowError, ExitCode

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dyknow_coordinator.grounding import Source, Symbol
    from dyknow_coordinator.ros.facilities import Facilities


async def find_candidates(
    facilities: Facilities, symbols: Sequence[Symbol], grounding: Grounding
) -> Candidates:
    """The sources of all features among symbols, by meaning or by name.

    Raises:
        DyKnowError: when a feature makes no sense, or a node that is needed is not there.
    """
    found: list[Source] = []
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
            if grounding is Grounding.AUTO and _is_stream(facilities, symbol):
                found.append(await _named(facilities, symbol))
            else:
                nearest[str(symbol)] = error.message
    return Candidates(tuple(found), nearest)


def _is_stream(facilities: Facilities, symbol: Symbol) -> bool:
    return symbol.may_be_stream and facilities.streams.known.get(symbol.name) is not None


async def _named(facilities: Facilities, symbol: Symbol) -> Source:
    """The source of a symbol that is the name of a stream with one field."""
    await facilities.clients.topic(
        symbol.name
    )  # Who mistypes a name hears of those that there are.
    return only_field(symbol, facilities.streams.fields(symbol.name))
