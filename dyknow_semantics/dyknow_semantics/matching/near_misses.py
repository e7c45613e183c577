"""What comes near to a concept without matching it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from dyknow_semantics.annotations.annotation import Concept
from dyknow_semantics.matching.index import Offer, OfferIndex
from dyknow_semantics.matching.patterns import Pattern
from dyknow_semantics.ontology.features import converts
from dyknow_semantics.ontology.knowledge import Knowledge

_LISTED: Final = 10
"""So many features that streams carry are listed where none is near."""


@dataclass(frozen=True, slots=True)
class Explanation:
    """Why a stream matches a concept, or nearly does.

    Args:
        stream: the stream, and what it carries.
        matches: whether it matches.
        reason: why, or why not.
    """

    stream: str
    matches: bool
    reason: str


def nearest(concept: Concept, asked: Pattern, index: OfferIndex, knowledge: Knowledge) -> str:
    """A sentence on what comes nearest to a concept that nothing matches.

    Args:
        concept: what was asked for.
        asked: the ground features that it stands for.
        index: all that there is.
        knowledge: the ontologies.
    """
    lack = f'no stream carries {concept}'
    if not all(asked.domains):
        return f'{lack}, since there are no objects of its sort'
    if not index.features:
        return f'{lack}, since no stream is annotated'
    related = [
        (_distance(asked, offer, knowledge), str(offer))
        for offer in _related(asked.feature, index, knowledge)
    ]
    if related:
        return f'{lack}; nearest: {min(related)[1]}'
    carried = sorted(index.features)
    more = ', ...' if len(carried) > _LISTED else ''
    return f'{lack}; the annotated streams carry {", ".join(carried[:_LISTED])}{more}'


def near_misses(asked: Pattern, index: OfferIndex, knowledge: Knowledge) -> tuple[Explanation, ...]:
    """The offers of related features that do not match, the nearest first, and why not."""
    missed = [
        (_distance(asked, offer, knowledge), str(offer), lack)
        for offer in _related(asked.feature, index, knowledge)
        if (lack := _lack(asked, offer, knowledge))
    ]
    return tuple(
        Explanation(stream, matches=False, reason=lack) for _, stream, lack in sorted(missed)
    )


def _related(asked: str, index: OfferIndex, knowledge: Knowledge) -> Iterator[Offer]:
    """The offers of features that lie below a common one, besides the top of all features."""
    above = filter(knowledge.is_feature, knowledge.superconcepts(asked))
    related = dict.fromkeys(below for each in above for below in knowledge.subconcepts(each))
    for feature in related:
        yield from index.of_feature(feature)


def _lack(asked: Pattern, offer: Offer, knowledge: Knowledge) -> str:
    """Why an offer does not match; empty if it does."""
    carried, unit = offer.pattern.feature, knowledge.feature(asked.feature).unit
    if carried not in knowledge.subconcepts(asked.feature):
        place = 'above' if carried in knowledge.superconcepts(asked.feature) else 'beside'
        return f'{carried} is {place} {asked.feature}, not below it'
    if unit and offer.unit and not converts(offer.unit, unit):
        return f'its unit {offer.unit} does not convert to {unit}'
    if not any(True for _ in offer.pattern.common_objects(asked)):
        return 'it carries none of the objects that are asked for'
    return ''


def _distance(asked: Pattern, offer: Offer, knowledge: Knowledge) -> tuple[bool, bool, int]:
    """The lack of a match: of another feature, of one that is not even above, of objects."""
    carried = offer.pattern
    other = carried.feature not in knowledge.subconcepts(asked.feature)
    beside = carried.feature not in knowledge.superconcepts(asked.feature)
    missed = sum(
        one.isdisjoint(other) for one, other in zip(asked.domains, carried.domains, strict=False)
    )
    return other, other and beside, missed
