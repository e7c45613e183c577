"""Checks of stored annotations, as the ontology and the types of streams become known or change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from dyknow_common import DyKnowError, InlineText, LanguageError, ValueType
from dyknow_semantics.annotations.annotation import Annotation
from dyknow_semantics.annotations.checking import check_annotation
from dyknow_semantics.annotations.field_checking import check_fields
from dyknow_semantics.ontology.knowledge import Knowledge

Fields = tuple[str, Mapping[str, ValueType]]
"""A message type, and the type of each of its fields."""


@dataclass(frozen=True, slots=True)
class Origin:
    """The file that an annotation was read from, and the annotation with its position there."""

    file: Path | InlineText
    annotation: Annotation


@dataclass(frozen=True, slots=True)
class AnnotationFaults:
    """The faults of all annotations.

    Args:
        messages: for people, with the file, the line and the place if they are known.
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
        annotations: by canonical text, as all other arguments.
        fields: of the streams whose fields are known.
        knowledge: the ontology.
        origins: of those annotations that were read from files.
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


def _located(error: DyKnowError, origin: Origin | None) -> str:
    return error.message if origin is None else f'{origin.file}: {error.message}'
