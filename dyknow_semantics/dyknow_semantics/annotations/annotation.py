"""Annotations and concepts as abstract syntax; `str` gives the canonical text."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Final

from dyknow_common import (
    NO_CONSTRAINTS,
    NOWHERE,
    ArrayElements,
    ElementCondition,
    Language,
    StreamConstraints,
    SyntaxNode,
    TextPosition,
    field_text,
    quoted,
)

_PARTS: Final = 2
_SPELLINGS: Final = {
    'CONCEPT': 'a name',
    '_IN': "'in'",
    'UNIT': 'a unit such as [m]',
    'PATH': 'a field',
    'COMPARISON': 'a comparison (= != < <= > >= contains)',
    'DURATION': 'a duration such as 100 ms',
}

ANNOTATION: Final = Language('annotation', __package__, 'ssl.lark', _SPELLINGS, 'annotations')
"""The language of annotations of streams."""

CONCEPT: Final = Language('concept', __package__, 'ssl.lark', _SPELLINGS, 'concept')
"""The language of questions for concepts."""


def feature_text(feature: str, arguments: Iterable[str]) -> str:
    """Return a feature with its arguments as in all languages and states, `XYDist[uav1, uav2]`."""
    listed = ', '.join(arguments)
    return f'{feature}[{listed}]' if listed else feature


@dataclasses.dataclass(frozen=True, slots=True)
class FeatureArgument(SyntaxNode):
    """An argument of a feature: a variable, if a range introduces its name, or else an object."""

    name: str

    def __str__(self) -> str:
        return ANNOTATION.name_text(self.name, 'CONCEPT')


@dataclasses.dataclass(frozen=True, slots=True)
class FeatureTerm(SyntaxNode):
    """A feature with its arguments, `XYDist[x, uav1]`."""

    name: str
    arguments: tuple[FeatureArgument, ...] = ()

    def __str__(self) -> str:
        return feature_text(self.name, map(str, self.arguments))


@dataclasses.dataclass(frozen=True, slots=True)
class Range(SyntaxNode):
    """A variable and the sort of the objects that it stands for, `u in UAV`."""

    variable: str
    sort: str
    sort_position: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)

    def __str__(self) -> str:
        return f'{self.variable} in {self.sort}'


@dataclasses.dataclass(frozen=True, slots=True)
class Content(SyntaxNode):
    """A field of a stream and the feature whose value it holds, `Altitude[u] = position.z [m]`.

    Args:
        feature: the feature.
        field: a path to the field, or a function of one.
        unit: the unit of the value; `None` leaves it to the ontology.
        unless: a field and a condition; the value is unknown in samples that satisfy it.
    """

    feature: FeatureTerm
    field: str
    unit: str | None = None
    unless: tuple[str, ElementCondition] | None = None
    unit_position: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)

    def __str__(self) -> str:
        unit = '' if self.unit is None else f' [{self.unit}]'
        unless = ''
        if self.unless is not None:
            field, condition = self.unless
            unless = f' unless {field_text(ANNOTATION, field)}{condition}'
        return f'{self.feature} = {field_text(ANNOTATION, self.field)}{unit}{unless}'


@dataclasses.dataclass(frozen=True, slots=True)
class Key(SyntaxNode):
    """The field of a sample that names the object that a variable stands for, `u = id`.

    Args:
        variable: the variable.
        field: the field, which holds the name of the object, or `drone_%id%`: the name is made of
            the value of a field.
    """

    variable: str
    field: str

    @property
    def parts(self) -> tuple[str, str, str]:
        """The field, and what is before and after its value in the name of the object."""
        before, *embedded = self.field.split('%')
        is_made = len(embedded) == _PARTS and embedded[0]
        return (embedded[0], before, embedded[1]) if is_made else (self.field, '', '')

    def __str__(self) -> str:
        return f'{self.variable} = {field_text(ANNOTATION, self.field)}'


@dataclasses.dataclass(frozen=True, slots=True)
class Annotation:
    """The contents of a stream (SSL; paper, section V).

    Args:
        stream: the name of the stream or topic.
        contents: the features of its fields.
        ranges: the variables of the features, for a stream that carries many objects.
        keys: for each variable, the field that names its object.
        constraints: the constraints that the samples of each ground feature keep.
        elements: the array of a message whose elements become samples.
        is_topic: True for the name of a topic, quoted in the text.
        text: the parsed text, for error messages.
    """

    stream: str
    contents: tuple[Content, ...]
    ranges: tuple[Range, ...] = ()
    keys: tuple[Key, ...] = ()
    constraints: StreamConstraints = NO_CONSTRAINTS
    elements: ArrayElements | None = None
    is_topic: bool = dataclasses.field(default=False, kw_only=True)
    text: str = dataclasses.field(default='', compare=False, kw_only=True)

    def __str__(self) -> str:
        stream = quoted(self.stream) if self.is_topic else self.stream
        stream = stream if self.elements is None else f'{self.elements} {stream}'
        contents = ', '.join(map(str, self.contents))
        keys = f' where {", ".join(map(str, self.keys))}' if self.keys else ''
        constraints = '' if self.constraints.is_empty else f' with {self.constraints}'
        return f'stream {stream} contains {contents}{_ranges(self.ranges)}{keys}{constraints};'


@dataclasses.dataclass(frozen=True, slots=True)
class Concept:
    """A question for streams, `XYDist[x, uav1] for every x in UAV`.

    Args:
        feature: the feature; without arguments it stands for the features of all objects.
        ranges: the variables of the feature.
        text: the parsed text, for error messages.
    """

    feature: FeatureTerm
    ranges: tuple[Range, ...] = ()
    text: str = dataclasses.field(default='', compare=False, kw_only=True)

    def __str__(self) -> str:
        return f'{self.feature}{_ranges(self.ranges)}'


def _ranges(ranges: tuple[Range, ...]) -> str:
    return f' for every {", ".join(map(str, ranges))}' if ranges else ''
