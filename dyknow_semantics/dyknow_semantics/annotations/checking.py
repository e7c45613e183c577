"""Checks of annotations and concepts against an ontology, and against the fields of streams.

Stored annotations are checked anew as the ontology and the types of streams become known or change.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final

from dyknow_common import (
    ExitCode,
    InlineText,
    Language,
    LanguageError,
    StreamConstraints,
    TextPosition,
    ValueType,
    absence,
    check_unit,
    element_fields,
    field_type,
    listed_as,
    number_of,
    value_text,
)
from dyknow_semantics.annotations.annotation import (
    ANNOTATION,
    CONCEPT,
    Annotation,
    Concept,
    Content,
    FeatureTerm,
    Key,
    Range,
)
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.features import FeatureSignature, converts
from dyknow_semantics.ontology.knowledge import Knowledge

Fields = tuple[str, Mapping[str, ValueType]]
"""A message type, and the type of each of its fields."""

_PLACE: Final = re.compile(r'# (?P<place>.+:[0-9]+:[0-9]+)')
"""A comment with the place in another file that the annotations below it were made from."""


def check_annotation(annotation: Annotation, knowledge: Knowledge) -> None:
    """Check an annotation against an ontology.

    Raises:
        LanguageError: with the position, for an unknown feature, sort or object, a wrong number of
            arguments, an argument outside of its sort, or a unit that is unknown or does not
            convert to the feature's.
    """
    checker = _AnnotationChecker(ANNOTATION, annotation.text, knowledge)
    sorts = checker.sorts(annotation.ranges)
    for content in annotation.contents:
        feature = checker.feature(content.feature)
        checker.check_arguments(content.feature, feature, sorts)
        checker.check_unit(content, feature)
        checker.check_unknown(content, feature, annotation.constraints)


def check_concept(concept: Concept, knowledge: Knowledge) -> None:
    """Check a concept against an ontology.

    Raises:
        LanguageError: with the position, for an unknown feature, sort or object, a wrong number of
            arguments, or an argument outside of its sort.
    """
    checker = _AnnotationChecker(CONCEPT, concept.text, knowledge)
    sorts = checker.sorts(concept.ranges)
    feature = checker.feature(concept.feature)
    if concept.feature.arguments:
        checker.check_arguments(concept.feature, feature, sorts)


class _AnnotationChecker:
    """A check of the parts of one text against an ontology."""

    def __init__(self, language: Language, text: str, knowledge: Knowledge) -> None:
        self._at = partial(language.errors_at, text)
        self._knowledge = knowledge

    def sorts(self, ranges: Iterable[Range]) -> dict[str, str]:
        """Return the sort of each variable."""
        for each in ranges:
            with self._at(each.sort_position):
                self._knowledge.superconcepts(each.sort)
        return {each.variable: each.sort for each in ranges}

    def feature(self, term: FeatureTerm) -> FeatureSignature:
        """Return the feature that a term names."""
        with self._at(term.position):
            return self._knowledge.feature(term.name)

    def check_arguments(
        self, term: FeatureTerm, feature: FeatureSignature, sorts: Mapping[str, str]
    ) -> None:
        """Check that the arguments of a term are of the sorts of its feature."""
        expected = feature.argument_sorts
        with self._at(term.position):
            if len(term.arguments) != len(expected):
                raise SemanticsError(
                    f"feature '{feature.name}' takes {_count(expected)}, "
                    f'but has {len(term.arguments)} here'
                )
        for argument, sort in zip(term.arguments, expected, strict=True):
            with self._at(argument.position):
                if argument.name in sorts:
                    self._check_variable(argument.name, sorts[argument.name], sort)
                else:
                    self._check_object(argument.name, sort)

    def check_unknown(
        self, content: Content, feature: FeatureSignature, constraints: StreamConstraints
    ) -> None:
        """Check that the value of a field may be unknown in some samples, or after a gap."""
        cause = "have 'unless'" if content.unless is not None else 'expire'
        may_be_unknown = content.unless is not None or constraints.expires
        if may_be_unknown and feature.value_type not in {ValueType.INT, ValueType.FLOAT}:
            with self._at(content.feature.position):
                raise SemanticsError(
                    f"feature '{feature.name}' has values of the type {feature.value_type}; "
                    f'only numbers may {cause}'
                )

    def check_unit(self, content: Content, feature: FeatureSignature) -> None:
        """Check that the unit of a field converts to the unit of its feature."""
        if content.unit is None or content.unit == feature.unit:
            return
        with self._at(content.unit_position):
            if not content.unit:
                raise SemanticsError('the unit is empty; write one, such as [m], or leave it out')
            check_unit(content.unit)
            if not feature.unit:
                raise SemanticsError(
                    f"feature '{feature.name}' is measured in no unit; leave it out"
                )
            if not converts(content.unit, feature.unit):
                raise SemanticsError(
                    f"feature '{feature.name}' is measured in {feature.unit}, "
                    f'which {content.unit} does not convert to'
                )

    def _check_variable(self, name: str, sort: str, expected: str) -> None:
        if expected not in self._knowledge.superconcepts(sort):
            raise SemanticsError(
                f"the variable '{name}' must range over '{expected}' or a sort below it, "
                f"but '{sort}' is none"
            )

    def _check_object(self, name: str, expected: str) -> None:
        try:
            concepts = self._knowledge.concepts(name)
        except SemanticsError as error:
            raise SemanticsError(
                f"'{name}' is no variable (add: for every {name} in {expected}) and no object: "
                f'{error}',
                error.code,
            ) from None
        if expected not in concepts:
            raise SemanticsError(f"'{name}' must be an instance of '{expected}', but is none")


def _count(sorts: tuple[str, ...]) -> str:
    if not sorts:
        return 'no arguments'
    plural = '' if len(sorts) == 1 else 's'
    return f'{len(sorts)} argument{plural} ({", ".join(sorts)})'


def check_fields(
    annotation: Annotation, knowledge: Knowledge, owner: str, fields: Mapping[str, ValueType]
) -> None:
    """Check an annotation, which fits its ontology, against the fields of its stream.

    Args:
        annotation: the annotation of the stream.
        knowledge: the ontology.
        owner: the owner of the fields in messages, such as the type of the stream's messages.
        fields: the type of each field.

    Raises:
        LanguageError: with the position, for a missing field, for a field whose type differs from
            the type of its feature (except an int field of a float feature), and for a field that
            names objects but is not a string.
    """
    checker = _FieldChecker(annotation, owner, fields)
    for content in annotation.contents:
        checker.check_content(content, knowledge.feature(content.feature.name))
    for key in annotation.keys:
        checker.check_key(key)


class _FieldChecker:
    """A check of one annotation against the fields of its stream."""

    def __init__(
        self, annotation: Annotation, owner: str, fields: Mapping[str, ValueType | None]
    ) -> None:
        self._text = annotation.text
        self._owner = owner
        self._fields = fields
        if annotation.elements is not None:
            found = element_fields(fields, annotation.elements)
            if isinstance(found, str):
                position = annotation.contents[0].feature.position
                raise self._error(f'{owner}: {found}', position, ExitCode.NOT_FOUND)
            self._fields = found

    def check_content(self, content: Content, feature: FeatureSignature) -> None:
        """Check that a field has values of its feature, and that a condition can be compared."""
        is_number = feature.value_type in {ValueType.INT, ValueType.FLOAT}
        field = number_of(content.field) if is_number else content.field
        position = content.feature.position
        found = self._type_of(field, position)
        if not feature.value_type.accepts(found):
            message = f"feature '{feature.name}' has values of the type {feature.value_type}, but "
            raise self._error(f'{message}{self._typed(field, found)}', position)
        if content.unless is not None:
            field, condition = content.unless
            found, wanted = self._type_of(field, position), ValueType.of(condition.value)
            if not (found.accepts(wanted) or wanted.accepts(found)):
                message = f'{self._typed(field, found)}, which cannot be compared with '
                raise self._error(message + value_text(condition.value), position)

    def check_key(self, key: Key) -> None:
        """Check that a field holds the names of objects, or numbers that are parts of the names."""
        field, *_ = key.parts
        found = self._type_of(field, key.position)
        if found is ValueType.STRING or (found is ValueType.INT and field != key.field):
            return
        hint = f'; write {key.variable} = "name_%{field}%"' if found is ValueType.INT else ''
        raise self._error(
            f"the field that names the object '{key.variable}' must be of the type string, "
            f"but '{field}' of {self._owner} is of the type {found}{hint}",
            key.position,
        )

    def _type_of(self, field: str, position: TextPosition) -> ValueType:
        found = field_type(self._fields, field) if listed_as(self._fields, field) else None
        if found is None:
            message = absence(self._owner, self._fields, field)
            raise self._error(message, position, ExitCode.NOT_FOUND)
        return found

    def _typed(self, field: str, found: ValueType) -> str:
        return f"field '{field}' of {self._owner} is of the type {found}"

    def _error(
        self, message: str, position: TextPosition, code: ExitCode = ExitCode.INVALID_ARGUMENT
    ) -> LanguageError:
        return ANNOTATION.error(message, self._text, position, code)


@dataclass(frozen=True, slots=True)
class Origin:
    """The file that an annotation was read from, and the annotation with its position there."""

    file: Path | InlineText
    annotation: Annotation


def origins_of(file: Path | InlineText, annotations: Sequence[Annotation]) -> dict[str, Origin]:
    """Return the origins of the annotations of a file, by canonical text."""
    files: list[Path | InlineText] = [file]
    for line in annotations[0].text.split('\n') if annotations else ():
        found = _PLACE.fullmatch(line)
        files.append(InlineText(found['place'], line) if found else files[-1])
    return {
        str(each): Origin(files[each.contents[0].feature.position.line], each)
        for each in annotations
    }


@dataclass(frozen=True, slots=True)
class AnnotationFaults:
    """The faults of all annotations.

    Args:
        messages: the messages for people, with the file, line and place if known.
        field_faults: why streams do not fit their annotations, by canonical text.
    """

    messages: tuple[str, ...] = ()
    field_faults: Mapping[str, str] = field(default_factory=dict)


def check_annotations(
    annotations: Mapping[str, Annotation],
    fields: Mapping[str, Fields],
    knowledge: Knowledge,
    origins: Mapping[str, Origin],
) -> AnnotationFaults:
    """Check all annotations.

    Args:
        annotations: the annotations by canonical text, as all other arguments.
        fields: the fields of the streams whose fields are known.
        knowledge: the ontology.
        origins: the origins of annotations that were read from files.
    """
    messages: list[str] = []
    field_faults: dict[str, str] = {}
    for text, stored in annotations.items():
        origin = origins.get(text)
        annotation = stored if origin is None else origin.annotation
        try:
            check_annotation(annotation, knowledge)
        except LanguageError as error:
            # Matching checks annotations against its own ontology.
            messages.append(_located(error, origin))
            continue
        try:
            if text in fields:
                check_fields(annotation, knowledge, *fields[text])
        except LanguageError as error:
            messages.append(_located(error, origin))
            field_faults[text] = error.reason
    return AnnotationFaults(tuple(messages), field_faults)


def _located(error: LanguageError, origin: Origin | None) -> str:
    if origin is None:
        return error.message
    # Users know the place of a part of another file, not the text that is made of it.
    is_made = isinstance(origin.file, InlineText)
    return f'{origin.file}: {error.reason if is_made else error.message}'
