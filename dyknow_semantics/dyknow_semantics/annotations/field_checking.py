"""Checks of annotations against the fields of their streams."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

from dyknow_common import (
    ExitCode,
    TextPosition,
    ValueType,
    absence,
    element_fields,
    field_type,
    listed_as,
    number_of,
    value_text,
)
from dyknow_semantics.annotations.annotation import ANNOTATION, Annotation, Content, Key
from dyknow_semantics.ontology.knowledge import Knowledge


def check_fields(
    annotation: Annotation, knowledge: Knowledge, owner: str, fields: Mapping[str, ValueType]
) -> None:
    """Check an annotation, which fits its ontology, against the fields of its stream.

    Args:
        annotation: of the stream.
        knowledge: the ontology.
        owner: of the fields in messages, such as the type of the stream's messages.
        fields: the type of each field.

    Raises:
        LanguageError: with the position, for a missing field, a field whose type is not that of its
            feature (a float feature may have an int field), and a field that names objects but is
            not a string.
    """
    type_of = partial(_type_of, annotation, owner, _available(annotation, owner, fields))
    for content in annotation.contents:
        feature = knowledge.feature(content.feature.name)
        is_number = feature.value_type in {ValueType.INT, ValueType.FLOAT}
        field = number_of(content.field) if is_number else content.field
        found = type_of(field, content.feature.position)
        if not feature.value_type.accepts(found):
            raise ANNOTATION.error(
                f"feature '{feature.name}' has values of the type {feature.value_type}, "
                f"but field '{field}' of {owner} is of the type {found}",
                annotation.text,
                content.feature.position,
            )
        _check_unless(annotation, owner, content, type_of)
    for key in annotation.keys:
        _check_key(annotation, owner, key, type_of)


def _check_unless(
    annotation: Annotation,
    owner: str,
    content: Content,
    type_of: Callable[[str, TextPosition], ValueType],
) -> None:
    """Check that the field of the condition can be compared."""
    if content.unless is None:
        return
    field, condition = content.unless
    found, wanted = type_of(field, content.feature.position), ValueType.of(condition.value)
    if not (found.accepts(wanted) or wanted.accepts(found)):
        message = (
            f"field '{field}' of {owner} is of the type {found}, which cannot be compared with "
        )
        raise ANNOTATION.error(
            message + value_text(condition.value), annotation.text, content.feature.position
        )


def _check_key(
    annotation: Annotation, owner: str, key: Key, type_of: Callable[[str, TextPosition], ValueType]
) -> None:
    """Check that a field holds the names of objects, or numbers that are parts of these."""
    field, *_ = key.parts
    found = type_of(field, key.position)
    if found is ValueType.STRING or (found is ValueType.INT and field != key.field):
        return
    hint = f'; write {key.variable} = "name_%{field}%"' if found is ValueType.INT else ''
    raise ANNOTATION.error(
        f"the field that names the object '{key.variable}' must be of the type string, "
        f"but '{field}' of {owner} is of the type {found}{hint}",
        annotation.text,
        key.position,
    )


def _available(
    annotation: Annotation, owner: str, fields: Mapping[str, ValueType]
) -> Mapping[str, ValueType | None]:
    """Return the fields of the samples of an annotated stream."""
    if annotation.elements is None:
        return fields
    found = element_fields(fields, annotation.elements)
    if isinstance(found, str):
        position = annotation.contents[0].feature.position
        raise ANNOTATION.error(f'{owner}: {found}', annotation.text, position, ExitCode.NOT_FOUND)
    return found


def _type_of(
    annotation: Annotation,
    owner: str,
    fields: Mapping[str, ValueType | None],
    field: str,
    position: TextPosition,
) -> ValueType:
    found = field_type(fields, field) if listed_as(fields, field) else None
    if found is None:
        message = absence(owner, fields, field)
        raise ANNOTATION.error(message, annotation.text, position, ExitCode.NOT_FOUND)
    return found
