"""Annotated fields that nearly match a concept."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from typing import Final

from dyknow_semantics.annotations.annotation import Concept
from dyknow_semantics.matching.index import FieldIndex
from dyknow_semantics.matching.patterns import Pattern
from dyknow_semantics.matching.specifications import AnnotatedField
from dyknow_semantics.ontology.features import converts
from dyknow_semantics.ontology.knowledge import Knowledge

_MAX_LISTED: Final = 10
"""The number of carried features that a message lists if none is related."""


@dataclass(frozen=True, slots=True)
class Explanation:
    """The reason why a stream matches a concept, or why it does not.

    Args:
        stream: the specification of a match, or the annotated field.
    """

    stream: str
    matches: bool
    reason: str


def nearest(concept: Concept, requested: Pattern, index: FieldIndex, knowledge: Knowledge) -> str:
    """Return a sentence about the field nearest to a concept without matches."""
    result = f'no stream carries {concept}'
    if not all(requested.domains):
        return f'{result}, since there are no objects of its sort'
    if not index.features:
        return f'{result}, since no stream is annotated'
    if related := _related(requested, index, knowledge):
        return f'{result}; nearest: {related[0]}'
    carried = sorted(index.features)
    more = ', ...' if len(carried) > _MAX_LISTED else ''
    return f'{result}; the annotated streams carry {", ".join(carried[:_MAX_LISTED])}{more}'


def near_misses(
    requested: Pattern, index: FieldIndex, knowledge: Knowledge
) -> tuple[Explanation, ...]:
    """Return the fields of related features that do not match, the nearest first."""
    return tuple(
        Explanation(str(carrier), False, reason)
        for carrier in _related(requested, index, knowledge)
        if (reason := _mismatch(requested, carrier, knowledge))
    )


def _related(requested: Pattern, index: FieldIndex, knowledge: Knowledge) -> list[AnnotatedField]:
    """Return the fields of all features below the superfeatures, the nearest first."""
    above = filter(knowledge.is_feature, knowledge.superconcepts(requested.feature))
    features = dict.fromkeys(below for each in above for below in knowledge.subconcepts(each))
    return sorted(
        chain.from_iterable(map(index.of_feature, features)),
        key=lambda carrier: (_distance(requested, carrier, knowledge), str(carrier)),
    )


def _mismatch(requested: Pattern, carrier: AnnotatedField, knowledge: Knowledge) -> str:
    """Return the reason why a field does not match; empty if it does."""
    carried, unit = carrier.pattern.feature, knowledge.feature(requested.feature).unit
    if carried not in knowledge.subconcepts(requested.feature):
        relation = 'above' if carried in knowledge.superconcepts(requested.feature) else 'beside'
        return f'{carried} is {relation} {requested.feature}, not below it'
    if unit and carrier.unit and not converts(carrier.unit, unit):
        return f'its unit {carrier.unit} does not convert to {unit}'
    if not any(True for _ in carrier.pattern.common_objects(requested)):
        return 'it carries none of the objects that are asked for'
    return ''


def _distance(
    requested: Pattern, carrier: AnnotatedField, knowledge: Knowledge
) -> tuple[bool, bool, int]:
    """Return a sort key: not below the feature, not above it, arguments without common objects."""
    carried = carrier.pattern
    other = carried.feature not in knowledge.subconcepts(requested.feature)
    beside = carried.feature not in knowledge.superconcepts(requested.feature)
    missed = sum(
        one.isdisjoint(another)
        for one, another in zip(requested.domains, carried.domains, strict=False)
    )
    return other, other and beside, missed
