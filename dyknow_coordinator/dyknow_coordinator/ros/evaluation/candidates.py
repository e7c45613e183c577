"""Search for the streams that carry the features of a formula, in the running system."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Final

from dyknow_common import Symbol
from dyknow_coordinator.grounding.candidate_search import CandidateSearch
from dyknow_coordinator.grounding.feature_sources import (
    Candidates,
    FeatureSource,
    Grounding,
    parse_sources,
)
from dyknow_coordinator.grounding.known_streams import KnownStreams
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

    async def matching_sources(concept: str) -> tuple[FeatureSource, ...]:
        texts = await context.clients.matching_streams(concept)
        return await context.background.run(partial(_parsed, texts), is_long=len(texts) > _MANY)

    async def stream_fields(name: str) -> tuple[str, ...]:
        # For an unknown name, the error of the stream manager lists the known ones.
        await context.clients.topic(name)
        await context.streams.wait_for(name)
        return context.streams.fields(name)

    return await CandidateSearch(matching_sources, stream_fields).find(symbols, grounding)


def _parsed(texts: Sequence[str]) -> tuple[FeatureSource, ...]:
    sources = parse_sources(texts)
    for source in sources:
        KnownStreams.parse(source)
    return sources
