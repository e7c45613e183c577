"""Matches, and the stream specifications that they are answered with."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, count
from math import inf
from operator import attrgetter
from typing import Final, NamedTuple

from dyknow_common import StreamConstraints, ValueType, unit_conversion
from dyknow_semantics.annotations.annotation import feature_text
from dyknow_semantics.matching.index import Offer
from dyknow_stream_processing import (
    Call,
    Condition,
    Select,
    Selection,
    Specification,
    StreamDeclaration,
    TypedField,
    UnitArgument,
    UnitDeclaration,
)

_VALUE: Final = TypedField('value', ValueType.FLOAT)
_CONVERT: Final = UnitDeclaration('convert', _VALUE, ((_VALUE,),))


class MatchQuery(NamedTuple):
    """What an offer is asked for.

    Args:
        name: what whoever asks calls the feature.
        feature: the shortest name of it.
        unit: what its values are to be measured in; empty leaves them as they are.
        exact: whether what is offered is the feature itself or an equivalent one.
    """

    name: str
    feature: str
    unit: str
    exact: bool


@dataclass(frozen=True)
class Match:
    """A stream of one ground feature.

    Args:
        ground_feature: what it carries, which is also the name of its only field: `Power[uav1]`.
        declaration: how it is made of the annotated stream.
        constraints: those that its samples keep.
        exact: whether the annotation is of the feature that was asked for or an equivalent one,
            not of one below it.
        reason: why the annotated stream matches.
    """

    ground_feature: str
    declaration: StreamDeclaration
    constraints: StreamConstraints
    exact: bool
    reason: str

    @property
    def stream_name(self) -> str:
        """The name of the stream, which no other match of the same answer has."""
        return self.declaration.name

    @cached_property
    def specification(self) -> str:
        """The text in the stream language, the reason as a comment before it."""
        converts = isinstance(self.declaration.stream.inputs[0], Call)
        declarations = (_CONVERT, self.declaration) if converts else (self.declaration,)
        return f'# {self.reason}\n{Specification(declarations)};'

    @cached_property
    def preference(self) -> tuple[bool, float, float, str]:
        """What matches are ordered by."""
        period, delay = self.constraints.sample_period, self.constraints.max_delay
        return (
            not self.exact,
            inf if period is None else period,
            inf if delay is None else delay,
            str(self.declaration),
        )


def make_match(
    question: MatchQuery, objects: Iterable[str], offer: Offer, data: Mapping[str, str]
) -> Match:
    """The stream of one ground feature that an offer holds.

    Args:
        question: what was asked for.
        objects: of the ground feature, as whoever asked calls them.
        offer: a field that holds it.
        data: for each variable of the offer, what samples call the object that it stands for.

    Raises:
        DyKnowError: if the unit of the offer does not convert to the one asked for.
    """
    ground = feature_text(question.name, objects)
    name = '_'.join(map(_word, (ground, 'from', offer.annotation.stream)))
    conditions = tuple(
        Condition(key.field, '=', data[key.variable])
        for key in offer.annotation.keys
        if key.variable in data
    )
    converted = bool(question.unit and offer.unit and unit_conversion(offer.unit, question.unit))
    stream = Select(
        (Selection(offer.content.field, _VALUE.name if converted else ground),),
        offer.source,
        conditions,
        constraints=offer.annotation.constraints,
    )
    reason = _reason(question, ground, offer)
    if converted:
        units = (UnitArgument('given', offer.unit), UnitArgument('wanted', question.unit))
        stream = Select((Selection(_VALUE.name, ground),), Call(_CONVERT.name, (stream,), units))
        reason += f'; {offer.unit} is converted to {question.unit}'
    declaration = StreamDeclaration(name, stream)
    return Match(ground, declaration, offer.annotation.constraints, question.exact, reason)


def in_order(matches: Iterable[Match]) -> tuple[Match, ...]:
    """Matches, the best first; a stream whose name is taken already gets a number."""
    result = sorted(matches, key=attrgetter('preference'))
    if len({each.stream_name for each in result}) == len(result):
        return tuple(result)
    taken: set[str] = set()
    for place, each in enumerate(result):
        names = chain([each.stream_name], (f'{each.stream_name}_{n}' for n in count(2)))
        name = next(name for name in names if name not in taken)
        taken.add(name)
        if name != each.stream_name:
            result[place] = replace(each, declaration=replace(each.declaration, name=name))
    return tuple(result)


def _reason(question: MatchQuery, ground: str, offer: Offer) -> str:
    carried = offer.pattern.feature
    if not question.exact:
        return f'subsumed: {carried} is below {question.feature}'
    if carried != question.feature:
        return f'exact match: {carried} is equivalent to {question.feature}'
    return f'exact match: {offer.source} carries {ground}'


def _word(text: str) -> str:
    return re.sub('[^A-Za-z0-9]+', '_', text).strip('_')
