"""Parts that the functions of `conversion_text` call to read values."""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable
from functools import lru_cache
from typing import Any

from dyknow_common import (
    UnnestedArray,
    Value,
    parse_field,
)
from dyknow_stream_processing.aggregates import NoValueError
from dyknow_stream_processing.path_values import rows_reader, value_reader
from dyknow_stream_processing.ros.messages.message_types import scalar_fields
from dyknow_stream_processing.sample import PartialFields


def without_element(fields: dict[str, Value], message: Any, path: str) -> PartialFields:
    """Return the fields of a sample without one whose array element the message lacks."""
    return PartialFields(fields, {path: _missing_element(message, path)})


def with_value(fields: dict[str, Value], message: Any, path: str) -> dict[str, Value]:
    """Return the fields of a sample with one that is found by a key or computed, if possible."""
    try:
        value = _reader(message.__class__, path)(message)
    except NoValueError as error:
        return PartialFields(fields, {path: error.reason})
    if isinstance(value, list):
        return PartialFields(fields, {}, {path: value})
    fields[path] = value
    return fields


@lru_cache(maxsize=1000)
def _reader(class_: Hashable, path: str) -> Callable[[Any], Any]:
    field, known = parse_field(path), scalar_fields(class_)
    if isinstance(field, UnnestedArray):
        return rows_reader(known, field)
    return value_reader(known, path)


def _missing_element(message: Any, path: str) -> str:
    value = message
    for part in re.findall(r'\w+', path):
        if not part.isdigit():
            value = getattr(value, part)
        elif int(part) < len(value):
            value = value[int(part)]
        else:
            break
    array = path[: path.index(f'[{part}]')]
    count = f'{len(value)} element{"s" * (len(value) != 1)}'
    return f"'{array}' has {count}, not one at [{part}]"
