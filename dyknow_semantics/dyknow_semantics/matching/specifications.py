"""Matches of annotated fields, and their stream specifications.

This is the only module of the core that knows the stream language.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from operator import attrgetter
from typing import Final, NamedTuple

from dyknow_common import (
    ComputedField,
    NumberedNames,
    StreamConstraints,
    ValueType,
    number_of,
    parse_field,
    unit_conversion,
)
from dyknow_semantics.annotations.annotation import Annotation, Content, Key, feature_text
from dyknow_semantics.matching.patterns import Pattern
from dyknow_stream_processing import (
    Call,
    Condition,
    Select,
    Selection,
    Specification,
    StreamDeclaration,
    StreamReference,
    TypedField,
    UnitArgument,
    UnitDeclaration,
)

_VALUE: Final = TypedField('value', ValueType.FLOAT)
_CONVERT: Final = UnitDeclaration('convert', (_VALUE,), ((_VALUE,),))


class MatchQuery(NamedTuple):
    """A request for the ground features of an annotated field.

    Args:
        name: the name of the feature in the request.
        feature: its shortest name.
        unit: the unit of the values in the answer; empty leaves them unchanged.
        exact: True if the field carries the feature itself or an equivalent one.
    """

    name: str
    feature: str
    unit: str
    exact: bool


@dataclass(frozen=True)
class Match:
    """A stream of one ground feature.

    Args:
        ground_feature: the feature, which is also the name of the only field: `Power[uav1]`.
        exact: True if the annotated stream carries the requested feature or an equivalent one,
            False if it carries a feature below it.
    """

    ground_feature: str
    declaration: StreamDeclaration
    constraints: StreamConstraints
    exact: bool
    reason: str

    @property
    def stream_name(self) -> str:
        """The name of the stream, unique among the matches of a concept."""
        return self.declaration.name

    @cached_property
    def specification(self) -> str:
        """The text in the stream language, after a comment with the reason."""
        converts = isinstance(self.declaration.stream.inputs[0], Call)
        declarations = (_CONVERT, self.declaration) if converts else (self.declaration,)
        return f'# {self.reason}\n{Specification(declarations)};'

    @cached_property
    def preference(self) -> tuple[bool, float, float, str]:
        """The sort key of matches."""
        period, delay = self.constraints.sample_period, self.constraints.max_delay
        return (
            not self.exact,
            inf if period is None else period,
            inf if delay is None else delay,
            str(self.declaration),
        )


@dataclass(eq=False, slots=True)
class AnnotatedField:
    """A field of a stream with its annotation.

    Args:
        content: the part of the annotation that describes the field.
        pattern: the ground features that the field carries.
        unit: the unit of the values; empty for none.
        is_number: True if the feature has numbers for values.
        matches: a cache of matches, by query and names of objects.
    """

    annotation: Annotation
    content: Content
    pattern: Pattern
    unit: str
    is_number: bool
    matches: dict[MatchQuery, dict[tuple[str, ...], Match | None]] = dataclasses.field(
        default_factory=dict
    )

    def __str__(self) -> str:
        arguments = {argument.name for argument in self.content.feature.arguments}
        ranges = [each for each in self.annotation.ranges if each.variable in arguments]
        every = f' for every {", ".join(map(str, ranges))}' if ranges else ''
        return f'{self.source} carries {self.content.feature}{every}'

    @property
    def field(self) -> str:
        """The field that holds the values, as numbers if these are."""
        return number_of(self.content.field) if self.is_number else self.content.field

    @property
    def unless(self) -> Condition | None:
        """The condition of samples in which the value is unknown."""
        if self.content.unless is None:
            return None
        field, condition = self.content.unless
        return Condition(field, condition.operator, condition.value)

    @property
    def source(self) -> StreamReference:
        """The stream in the stream language."""
        return StreamReference(self.annotation.stream, self.annotation.is_topic)


def make_match(
    query: MatchQuery, objects: Iterable[str], carrier: AnnotatedField, keys: Mapping[str, str]
) -> Match | None:
    """Return the stream of one ground feature that a field carries.

    There is none if no value of a key makes the name of the object: `drone_%id%` and `rover_1`.

    Args:
        query: the request.
        objects: the objects of the ground feature, by their names in the request.
        carrier: the field.
        keys: for each variable of the field, the name of its object in the samples.

    Raises:
        DyKnowError: if the unit of the field does not convert to the requested one.
    """
    ground = feature_text(query.name, objects)
    name = '_'.join(map(_word, (ground, 'from', carrier.annotation.stream)))
    given = [key for key in carrier.annotation.keys if key.variable in keys]
    conditions = tuple(filter(None, (_condition(key, keys[key.variable]) for key in given)))
    if len(conditions) < len(given):
        return None
    converted = bool(query.unit and carrier.unit and unit_conversion(carrier.unit, query.unit))
    stream = Select(
        (Selection(carrier.field, _VALUE.name if converted else ground, carrier.unless),),
        carrier.source,
        conditions,
        carrier.annotation.elements,
        constraints=carrier.annotation.constraints,
    )
    reason = _reason(query, ground, carrier)
    if converted:
        units = (UnitArgument('given', carrier.unit), UnitArgument('wanted', query.unit))
        stream = Select((Selection(_VALUE.name, ground),), Call(_CONVERT.name, (stream,), units))
        reason += f'; {carrier.unit} is converted to {query.unit}'
    declaration = StreamDeclaration(name, stream)
    return Match(ground, declaration, carrier.annotation.constraints, query.exact, reason)


def _condition(key: Key, name: str) -> Condition | None:
    """Return the condition that a sample is about an object; None if none can be."""
    field, before, after = key.parts
    if field == key.field:
        return Condition(field, '=', name)
    value = name.removeprefix(before).removesuffix(after)
    if name != f'{before}{value}{after}':
        return None
    parsed = parse_field(field)
    if not isinstance(parsed, ComputedField):
        return Condition(f'text({field})', '=', value)
    is_number = parsed.gives_number and re.fullmatch('0|[1-9][0-9]{,17}', value)
    return Condition(field, '=', int(value)) if is_number else None


def in_order(matches: Iterable[Match]) -> tuple[Match, ...]:
    """Sort matches by preference, and number streams with equal names."""
    result = sorted(matches, key=attrgetter('preference'))
    if len({each.stream_name for each in result}) == len(result):
        return tuple(result)
    used: set[str] = set()
    untried = NumberedNames()
    for index, each in enumerate(result):
        name = next(name for name in untried[each.stream_name] if name not in used)
        used.add(name)
        if name != each.stream_name:
            result[index] = replace(each, declaration=replace(each.declaration, name=name))
    return tuple(result)


def _reason(query: MatchQuery, ground: str, carrier: AnnotatedField) -> str:
    carried = carrier.pattern.feature
    if not query.exact:
        return f'subsumed: {carried} is below {query.feature}'
    if carried != query.feature:
        return f'exact match: {carried} is equivalent to {query.feature}'
    return f'exact match: {carrier.source} carries {ground}'


def _word(text: str) -> str:
    return re.sub('[^A-Za-z0-9]+', '_', text).strip('_')
