"""Functions that convert messages to the fields of samples and back, compiled at run time.

Their code comes from `conversion_text`, and calls `with_value` and `MessageWriter`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from dyknow_common import Value, absence
from dyknow_common.ros import snake_case
from dyknow_stream_processing.aggregates import NoValueError
from dyknow_stream_processing.language.required_fields import ALL
from dyknow_stream_processing.path_values import value_reader
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
        to_fields: returns the fields of a message.
        from_fields: returns a message; raises StreamError for a value that does not fit.
    """

    to_fields: Callable[[Any], dict[str, Value]]
    from_fields: Callable[[Mapping[str, Value]], Any]


def message_conversion(class_: Any, fields: Collection[str] | None = None) -> Conversion:
    """Return the conversion of a message class, for the named fields or for all.

    Raises:
        StreamError: NOT_FOUND, if the message type lacks a field.
    """
    text = with_imports(conversion_text(class_, fields))
    namespace: dict[str, Any] = {}
    exec(compile(text, f'<{type_name_of(class_)}>', 'exec'), namespace)  # noqa: S102
    name = snake_case(class_.__name__)
    return Conversion(namespace[f'{name}_to_fields'], namespace[f'{name}_from_fields'])


def extractor(class_: Any, fields: Collection[str]) -> Callable[[Any], dict[str, Value]]:
    """Return a function that reads the named fields of a message.

    `ALL` among them stands for all but the elements of arrays. A field that the message type lacks
    and an element that a message lacks are left out and explained, see `PartialFields`.
    """
    present = fields_to_read(class_, fields)
    extract = message_conversion(class_, present).to_fields
    absent = set(fields) - {ALL, *present}
    if not absent:
        return extract
    known, name = scalar_fields(class_), type_name_of(class_)
    reasons = {each: absence(name, known, each) for each in absent}

    def extract_and_explain(message: Any) -> PartialFields:
        return PartialFields(extract(message), reasons)

    return extract_and_explain


def with_value(fields: dict[str, Value], message: Any, path: str) -> dict[str, Value]:
    """Return the fields of a sample with one more, or with the reason why the message lacks it."""
    try:
        value = _reader(message.__class__, path)(message)
    except NoValueError as error:
        return PartialFields(fields, {path: error.reason})
    if isinstance(value, list):
        return PartialFields(fields, {}, {path: value})
    fields[path] = value
    return fields


@lru_cache(maxsize=1000)
def _reader(class_: Any, path: str) -> Callable[[Any], Any]:
    return value_reader(scalar_fields(class_), path)
