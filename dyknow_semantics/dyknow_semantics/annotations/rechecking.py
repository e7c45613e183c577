"""Checks of stored annotations, as the ontology and the types of streams become known or change."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from dyknow_common import InlineText, LanguageError, ValueType
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


_PLACE: Final = re.compile(r'# (?P<place>.+:[0-9]+:[0-9]+)')
"""A comment with the place in another file that the annotations below it were made from."""


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


def _located(error: LanguageError, origin: Origin | None) -> str:
    if origin is None:
        return error.message
    # Users know the place of a part of another file, not the text that is made of it.
    is_made = isinstance(origin.file, InlineText)
    return f'{origin.file}: {error.reason if is_made else error.message}'
