"""Functions that convert messages to the fields of samples and back, made at run time.

What they do is written in `conversion_text`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

from dyknow_common import Value, absence
from dyknow_common.ros import snake_case
from dyknow_stream_processing.language.required_fields import ALL
from dyknow_stream_processing.ros.messages.conversion_code import conversion_text, with_imports
from dyknow_stream_processing.ros.messages.message_types import (
    fields_to_read,
    scalar_fields,
    type_name_of,
)
from dyknow_stream_processing.sample import PartialFields


@dataclass(frozen=True, slots=True)
class Conversion:
    """The two functions of a message type.

    Args:
        to_fields: the fields of a message.
        from_fields: the message of some fields; raises StreamError for what does not fit.
    """

    to_fields: Callable[[Any], dict[str, Value]]
    from_fields: Callable[[Mapping[str, Value]], Any]


def message_conversion(class_: Any, fields: Collection[str] | None = None) -> Conversion:
    """The conversion of a message class, of the fields named or of all.

    Raises:
        StreamError: NOT_FOUND, for a field that the message type does not have.
    """
    text = with_imports(conversion_text(class_, fields))
    namespace: dict[str, Any] = {}
    exec(compile(text, f'<{type_name_of(class_)}>', 'exec'), namespace)  # noqa: S102
    name = snake_case(class_.__name__)
    return Conversion(namespace[f'{name}_to_fields'], namespace[f'{name}_from_fields'])


def extractor(class_: Any, fields: Collection[str] | None) -> Callable[[Any], dict[str, Value]]:
    """A function that takes the named fields out of a message.

    For None these are all but the elements of arrays. An element that a message does not have is
    left out; its absence is explained, see `PartialFields`.

    Raises:
        StreamError: NOT_FOUND, for a field that the message type does not have.
    """
    return message_conversion(
        class_, fields_to_read(class_, {ALL}) if fields is None else fields
    ).to_fields


def tolerant_extractor(class_: Any, fields: Collection[str]) -> Callable[[Any], dict[str, Value]]:
    """A function that takes those of the named fields out of a message that its type has.

    `ALL` among them stands for all but the elements of arrays. What the message type does not have
    is left out, too, and explained.
    """
    known, present = scalar_fields(class_), fields_to_read(class_, fields)
    extract = extractor(class_, present)
    absent = [each for each in fields if each != ALL and each not in present]
    if not absent:
        return extract
    reasons = {each: absence(type_name_of(class_), known, each) for each in absent}

    def explain(message: Any) -> PartialFields:
        found = extract(message)
        more = found.reasons if isinstance(found, PartialFields) else {}
        return PartialFields(found, {**reasons, **more})

    return explain
