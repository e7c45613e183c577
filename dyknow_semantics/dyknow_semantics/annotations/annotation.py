"""Annotations and concepts as abstract syntax; `str` gives the canonical text."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Iterable
from typing import Final

from dyknow_common import FIELD_PATH, NO_CONSTRAINTS, NOWHERE, StreamConstraints, TextPosition

ANNOTATION: Final = 'annotation'
"""What a text of SSL is called in messages."""

CONCEPT: Final = 'concept'
"""What a text that asks for a concept is called in messages."""

_NAME = re.compile(r'(?!(?:for|where|with|contains)\b)[A-Za-z_]\w*(:[A-Za-z_]\w*)?', re.ASCII)
_FIELD = re.compile(rf'(?!(?:for|where|with|contains)\b){FIELD_PATH}', re.ASCII)


def feature_text(feature: str, arguments: Iterable[str]) -> str:
    """A feature with its arguments as all languages and states write it: `XYDist[uav1, uav2]`."""
    listed = ', '.join(arguments)
    return f'{feature}[{listed}]' if listed else feature


@dataclasses.dataclass(frozen=True, slots=True)
class FeatureArgument:
    """An argument of a feature: a variable, if a range introduces its name, or else an object."""

    name: str
    place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)

    def __str__(self) -> str:
        """The canonical text."""
        return self.name if _NAME.fullmatch(self.name) else _quoted(self.name)


@dataclasses.dataclass(frozen=True, slots=True)
class FeatureTerm:
    """A feature with its arguments, `XYDist[x, uav1]`."""

    name: str
    arguments: tuple[FeatureArgument, ...] = ()
    place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)

    def __str__(self) -> str:
        """The canonical text."""
        return feature_text(self.name, map(str, self.arguments))


@dataclasses.dataclass(frozen=True, slots=True)
class Range:
    """A variable and the sort of the objects that it stands for, `u in UAV`."""

    variable: str
    sort: str
    place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)
    sort_place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)

    def __str__(self) -> str:
        """The canonical text."""
        return f'{self.variable} in {self.sort}'


@dataclasses.dataclass(frozen=True, slots=True)
class Content:
    """A field of a stream and the feature whose value it holds, `Altitude[u] = position.z [m]`.

    Args:
        feature: the feature.
        field: a dotted path to the field.
        unit: what the value is measured in; `None` leaves it to the ontology.
    """

    feature: FeatureTerm
    field: str
    unit: str | None = None
    unit_place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)

    def __str__(self) -> str:
        """The canonical text."""
        unit = '' if self.unit is None else f' [{self.unit}]'
        return f'{self.feature} = {_field_text(self.field)}{unit}'


@dataclasses.dataclass(frozen=True, slots=True)
class Key:
    """The field of a sample that names the object that a variable stands for, `u = id`."""

    variable: str
    field: str
    place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)

    def __str__(self) -> str:
        """The canonical text."""
        return f'{self.variable} = {_field_text(self.field)}'


@dataclasses.dataclass(frozen=True, slots=True)
class Annotation:
    """What a stream contains (SSL; paper, section V).

    Args:
        stream: the name of the stream or topic.
        contents: what its fields hold.
        ranges: the variables of the features, for a stream that carries many objects.
        keys: for each variable, the field that names its object.
        constraints: those that the samples of each ground feature keep.
        is_topic: whether the name is that of a topic, quoted in the text.
        text: what was parsed, for error messages.
    """

    stream: str
    contents: tuple[Content, ...]
    ranges: tuple[Range, ...] = ()
    keys: tuple[Key, ...] = ()
    constraints: StreamConstraints = NO_CONSTRAINTS
    is_topic: bool = dataclasses.field(default=False, kw_only=True)
    text: str = dataclasses.field(default='', compare=False, kw_only=True)

    def __str__(self) -> str:
        """The canonical text."""
        stream = _quoted(self.stream) if self.is_topic else self.stream
        contents = ', '.join(map(str, self.contents))
        keys = f' where {", ".join(map(str, self.keys))}' if self.keys else ''
        constraints = '' if self.constraints.is_empty else f' with {self.constraints}'
        return f'stream {stream} contains {contents}{_ranges(self.ranges)}{keys}{constraints};'


@dataclasses.dataclass(frozen=True, slots=True)
class Concept:
    """What streams are asked for, `XYDist[x, uav1] for every x in UAV`.

    Args:
        feature: the feature; without arguments it is asked for of all objects.
        ranges: the variables of the feature.
        text: what was parsed, for error messages.
    """

    feature: FeatureTerm
    ranges: tuple[Range, ...] = ()
    text: str = dataclasses.field(default='', compare=False, kw_only=True)

    def __str__(self) -> str:
        """The canonical text."""
        return f'{self.feature}{_ranges(self.ranges)}'


def _ranges(ranges: tuple[Range, ...]) -> str:
    return f' for every {", ".join(map(str, ranges))}' if ranges else ''


def _field_text(name: str) -> str:
    return name if _FIELD.fullmatch(name) else _quoted(name)


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
