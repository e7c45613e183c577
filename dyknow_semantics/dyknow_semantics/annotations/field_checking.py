"""Whether the fields that annotations speak of are there, and hold what they should."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NoReturn

from dyknow_common import ExitCode, LanguageError, TextPosition, ValueType, absence, listed_as
from dyknow_semantics.annotations.annotation import ANNOTATION, Annotation
from dyknow_semantics.ontology.knowledge import Knowledge


def check_fields(
    annotation: Annotation, knowledge: Knowledge, owner: str, fields: Mapping[str, ValueType]
) -> None:
    """Checks an annotation, which fits its ontology, against the fields of its stream.

    Args:
        annotation: what the stream contains.
        knowledge: the ontology.
        owner: what has the fields, such as the type of the stream's messages.
        fields: what each of them holds.

    Raises:
        LanguageError: with the place, for a field that is not there, one that does not hold the
            type of value of its feature (a float feature may have an int field), and one that is
            to name objects but is no string.
    """
    checker = _FieldChecker(annotation.text, owner, fields)
    for content in annotation.contents:
        feature = knowledge.feature(content.feature.name)
        held = checker.held(content.field, content.feature.place)
        if not _may_stand_for(held, feature.value_type):
            checker.refuse(
                f"feature '{feature.name}' has values of the type {feature.value_type}, "
                f"but field '{content.field}' of {owner} is of the type {held}",
                content.feature.place,
            )
    for key in annotation.keys:
        held = checker.held(key.field, key.place)
        if held is not ValueType.STRING:
            checker.refuse(
                f"the field that names the object '{key.variable}' must be of the type string, "
                f"but '{key.field}' of {owner} is of the type {held}",
                key.place,
            )


class _FieldChecker:
    """Looks fields up for one text.

    Args:
        text: the whole text.
        owner: what has the fields.
        fields: what each of them holds.
    """

    def __init__(self, text: str, owner: str, fields: Mapping[str, ValueType]) -> None:
        self._text = text
        self._owner = owner
        self._fields = fields

    def held(self, field: str, place: TextPosition) -> ValueType:
        """What a field holds."""
        listed = listed_as(self._fields, field)
        if listed is None:
            self.refuse(absence(self._owner, self._fields, field), place, ExitCode.NOT_FOUND)
        return self._fields[listed]

    def refuse(
        self, message: str, place: TextPosition, code: ExitCode = ExitCode.INVALID_ARGUMENT
    ) -> NoReturn:
        """Complains with the place."""
        raise LanguageError(message, ANNOTATION, self._text, place, code)


def _may_stand_for(held: ValueType, wanted: ValueType) -> bool:
    return held is wanted or (held is ValueType.INT and wanted is ValueType.FLOAT)
