"""From the texts of annotations and concepts to their abstract syntax."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache
from typing import Any, Final

from lark import Token, Transformer, v_args

from dyknow_common import DyKnowError, Language, StreamConstraints, TextPosition, parse_duration
from dyknow_semantics.annotations.annotation import (
    ANNOTATION,
    CONCEPT,
    Annotation,
    Concept,
    Content,
    FeatureArgument,
    FeatureTerm,
    Key,
    Range,
)

_SPELLINGS: Final = {
    'NAME': 'a name',
    'CONCEPT': 'a name',
    'FIELD': 'a field',
    'QUOTED': 'a quoted text',
    'UNIT': 'a unit such as [m]',
    'DURATION': 'a duration such as 100 ms',
    'CONSTRAINT': (
        'a constraint (start_time, end_time, max_delay, sample_period, sample_period_deviation)'
    ),
}


def parse_annotations(text: str) -> tuple[Annotation, ...]:
    """The statements of an SSL text, which `;` separates.

    Raises:
        LanguageError: with the place and what was expected there.
    """
    return tuple(replace(annotation, text=text) for annotation in _ANNOTATIONS.parse(text))


@lru_cache(maxsize=1024)
def parse_concept(text: str) -> Concept:
    """The concept that a text asks for: `Power`, or `Power[u] for every u in UAV`.

    Whoever asks asks again, so it is remembered.

    Raises:
        LanguageError: with the place and what was expected there.
    """
    return replace(_CONCEPTS.parse(text), text=text)


@v_args(inline=True)
class _AnnotationBuilder(Transformer[Any]):
    """Makes the abstract syntax; one method for each rule of the grammar."""

    def annotations(self, *annotations: Annotation) -> tuple[Annotation, ...]:
        return annotations

    def annotation(self, stream: Token, contents: tuple[Content, ...], *clauses: Any) -> Annotation:
        given: dict[str, Any] = {}
        for clause in clauses:
            given |= clause
        annotation = Annotation(_name(stream), contents, **given, is_topic=stream.type == 'QUOTED')
        _require_keys(annotation)
        return annotation

    def contents(self, *contents: Content) -> tuple[Content, ...]:
        return contents

    def content(self, feature: FeatureTerm, field: Token, unit: Token | None = None) -> Content:
        if unit is None:
            return Content(feature, _name(field))
        return Content(feature, _name(field), unit[1:-1].strip(), unit_place=TextPosition.of(unit))

    def keys(self, *keys: Key) -> dict[str, Any]:
        _require_distinct(keys)
        return {'keys': keys}

    def key(self, variable: Token, field: Token) -> Key:
        return Key(str(variable), _name(field), place=TextPosition.of(variable))

    def constraints(self, *constraints: tuple[Token, int]) -> dict[str, Any]:
        values: dict[str, int] = {}
        for name, value in constraints:
            if name in values:
                raise ValueError(f'{name} is given twice', TextPosition.of(name))
            values[str(name)] = value
        result = StreamConstraints(**values)
        try:
            result.validate()
        except DyKnowError as error:
            raise ValueError(error.message, TextPosition.of(constraints[0][0])) from None
        return {'constraints': result}

    def constraint(self, name: Token, duration: Token) -> tuple[Token, int]:
        try:
            return name, parse_duration(duration)
        except ValueError as error:
            raise ValueError(str(error), TextPosition.of(duration)) from None

    def concept(self, feature: FeatureTerm, clause: dict[str, Any] | None = None) -> Concept:
        return Concept(feature, **(clause or {}))

    def feature(self, name: Token, *arguments: FeatureArgument) -> FeatureTerm:
        return FeatureTerm(str(name), arguments, place=TextPosition.of(name))

    def argument(self, name: Token) -> FeatureArgument:
        return FeatureArgument(_name(name), place=TextPosition.of(name))

    def ranges(self, *ranges: Range) -> dict[str, Any]:
        _require_distinct(ranges)
        return {'ranges': ranges}

    def range(self, variable: Token, sort: Token) -> Range:
        return Range(
            str(variable),
            str(sort),
            place=TextPosition.of(variable),
            sort_place=TextPosition.of(sort),
        )


def _name(token: Token) -> str:
    return str(json.loads(token)) if token.type == 'QUOTED' else str(token)


def _require_distinct(parts: tuple[Range, ...] | tuple[Key, ...]) -> None:
    seen: set[str] = set()
    for part in parts:
        if part.variable in seen:
            raise ValueError(f"the variable '{part.variable}' is given twice", part.place)
        seen.add(part.variable)


def _require_keys(annotation: Annotation) -> None:
    """Each variable has a field that names its object, and nothing else has."""
    variables = {each.variable for each in annotation.ranges}
    keyed = {key.variable for key in annotation.keys}
    for each in annotation.ranges:
        if each.variable not in keyed:
            raise ValueError(
                f"no field names the object of the variable '{each.variable}'; "
                f'add: where {each.variable} = <field>',
                each.place,
            )
    for key in annotation.keys:
        if key.variable not in variables:
            raise ValueError(
                f"the variable '{key.variable}' has no sort; "
                f'add: for every {key.variable} in <sort>',
                key.place,
            )


_ANNOTATIONS: Final[Language[tuple[Annotation, ...]]] = Language(
    ANNOTATION, __package__, 'ssl.lark', _AnnotationBuilder(), _SPELLINGS, ['annotations']
)
_CONCEPTS: Final[Language[Concept]] = Language(
    CONCEPT, __package__, 'ssl.lark', _AnnotationBuilder(), _SPELLINGS, ['concept']
)
