"""Parsing of annotations and concepts to their abstract syntax."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

from lark import Token

from dyknow_common import (
    ArrayElements,
    DyKnowError,
    ElementCondition,
    FieldBuilder,
    PositionedError,
    StreamConstraints,
    TextPosition,
    builder,
    cached_by_text,
    distinct_settings,
    field_name,
    text_value,
)
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


@cached_by_text
def parse_annotations(text: str) -> tuple[Annotation, ...]:
    """Return the statements of an SSL text, which `;` separates.

    Raises:
        LanguageError: with the position and what was expected there.
    """
    return tuple(replace(each, text=text) for each in ANNOTATION.parse(text, _AnnotationBuilder()))


@lru_cache(maxsize=1024)
def parse_concept(text: str) -> Concept:
    """Return the concept in a text: `Power`, or `Power[u] for every u in UAV`.

    Raises:
        LanguageError: with the position and what was expected there.
    """
    concept: Concept = replace(CONCEPT.parse(text, _AnnotationBuilder()), text=text)
    return concept


@builder
class _AnnotationBuilder(FieldBuilder[Any]):
    """The builder of the abstract syntax; it has a method for each rule of the grammar."""

    def annotations(self, *parts: Any) -> tuple[Any, ...]:
        return parts

    contents = annotations

    def annotation(self, *parts: Any) -> Annotation:
        elements = parts[0] if isinstance(parts[0], ArrayElements) else None
        stream, contents, *clauses = parts[1:] if elements else parts
        given = {name: value for clause in clauses for name, value in clause.items()}
        is_topic = stream.type == 'QUOTED'
        annotation = Annotation(
            text_value(stream), contents, **given, elements=elements, is_topic=is_topic
        )
        _require_keys(annotation)
        return annotation

    def content(self, feature: FeatureTerm, field: Token, *rest: Any) -> Content:
        found = Content(feature, field_name(field))
        for each in rest:
            if isinstance(each, Token):
                unit, position = each[1:-1].strip(), TextPosition.of(each)
                found = replace(found, unit=unit, unit_position=position)
            else:
                found = replace(found, unless=each)
        return found

    def unless(self, field: Token, comparison: Token, value: Token) -> tuple[str, ElementCondition]:
        return self.compared(field, comparison, value)

    def keys(self, *keys: Key) -> dict[str, Any]:
        _require_distinct(keys)
        return {'keys': keys}

    def key(self, variable: Token, field: Token) -> Key:
        return Key(str(variable), field_name(field))

    def constraints(self, *settings: tuple[Token, int]) -> dict[str, Any]:
        constraints = StreamConstraints(**distinct_settings(settings))
        try:
            constraints.validate()
        except DyKnowError as error:
            raise PositionedError(error.message, TextPosition.of(settings[0][0])) from None
        return {'constraints': constraints}

    def concept(self, feature: FeatureTerm, clause: dict[str, Any] | None = None) -> Concept:
        return Concept(feature, **(clause or {}))

    def feature(self, name: Token, *arguments: FeatureArgument) -> FeatureTerm:
        return FeatureTerm(str(name), arguments)

    def argument(self, name: Token) -> FeatureArgument:
        return FeatureArgument(text_value(name))

    def ranges(self, *ranges: Range) -> dict[str, Any]:
        _require_distinct(ranges)
        return {'ranges': ranges}

    def range(self, variable: Token, sort: Token) -> Range:
        return Range(str(variable), str(sort), sort_position=TextPosition.of(sort))


def _require_distinct(parts: tuple[Range, ...] | tuple[Key, ...]) -> None:
    seen: set[str] = set()
    for part in parts:
        if part.variable in seen:
            raise PositionedError(f"the variable '{part.variable}' is given twice", part.position)
        seen.add(part.variable)


def _require_keys(annotation: Annotation) -> None:
    """Check that each variable has a field that names its object, and nothing else has."""
    variables = {each.variable for each in annotation.ranges}
    keyed = {key.variable for key in annotation.keys}
    for each in annotation.ranges:
        if each.variable not in keyed:
            raise PositionedError(
                f"no field names the object of the variable '{each.variable}'; "
                f'add: where {each.variable} = <field>',
                each.position,
            )
    for key in annotation.keys:
        if key.variable not in variables:
            raise PositionedError(
                f"the variable '{key.variable}' has no sort; "
                f'add: for every {key.variable} in <sort>',
                key.position,
            )
