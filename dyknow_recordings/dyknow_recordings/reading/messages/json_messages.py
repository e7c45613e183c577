"""Messages of mcap files in JSON, whose types are JSON schemas."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from dyknow_common import ValueType, all_elements, shortened
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.messages.cdr import DecodedFields
from dyknow_recordings.reading.messages.computed_columns import ComputedColumns
from dyknow_recordings.reading.messages.definitions import TypeDefinition
from dyknow_recordings.reading.messages.layouts import MAX_TEXT, MAX_VALUES, MessageLayout
from dyknow_recordings.reading.messages.stored_messages import StoredMessages
from dyknow_stream_processing import WHOLE, NoValueError

JSON: Final = 'json'
"""The serialisation of such messages."""

_MAX_NESTING: Final = 32
_VALUE_TYPES: Final = {
    'boolean': ValueType.BOOLEAN,
    'integer': ValueType.INT,
    'number': ValueType.FLOAT,
    'string': ValueType.STRING,
}


@dataclass(slots=True)
class _JsonType:
    """A part of a schema: of a single value, of the elements of an array, or of an object."""

    name: str
    kind: ValueType | None = None
    element: _JsonType | None = None
    members: dict[str, _JsonType] = field(default_factory=dict)

    def fields(self, path: str) -> Iterator[tuple[str, ValueType]]:
        """Yield the paths of all values below a path."""
        if self.kind is not None:
            yield path, self.kind
        # No path leads into arrays of arrays.
        elif self.element is not None and self.element.element is None:
            yield from self.element.fields(all_elements(path, None))
        for name, member in self.members.items():
            yield from member.fields(f'{path}.{name}' if path else name)

    def value(self, found: Any) -> Any:
        """Return a value of a message as readers of paths take it.

        Raises:
            NoValueError: if it does not fit the schema.
        """
        value: Any = None
        if self.element is not None and isinstance(found, list):
            value = [self.element.value(each) for each in found]
            is_plain = self.element.kind not in {None, ValueType.STRING}
            return np.array(value) if is_plain else value
        if self.kind is None:
            value = _JsonObject(found, self) if isinstance(found, dict) else None
        elif self.kind is ValueType.FLOAT and type(found) in {int, float}:
            value = _float(found)
        elif self.kind is ValueType.INT and isinstance(found, float) and found.is_integer():
            value = int(found)
        elif type(found) in {bool, int, str} and ValueType.of(found) is self.kind:
            value = found
        if value is None:
            raise NoValueError(f"'{self.name}' does not fit its schema")
        return value


class _JsonObject:
    """An object of a message, with its members as attributes."""

    def __init__(self, found: Mapping[str, Any], kind: _JsonType) -> None:
        # Other names would hide members of the message.
        self.__found = found
        self.__kind = kind

    def __getattr__(self, name: str) -> Any:
        found = self.__found.get(name)
        if found is None:
            raise NoValueError(f"the message has no '{name}'")
        return self.__kind.members[name].value(found)


def _float(value: float) -> float | None:
    try:
        return float(value)
    except OverflowError:
        return None


class JsonLayout(MessageLayout):
    """The fields of messages that a JSON schema describes.

    Args:
        definition: the schema.

    Raises:
        RecordingError: if there is none, or it cannot be read.
    """

    def __init__(self, definition: TypeDefinition) -> None:
        name = shortened(definition.name)
        if definition.encoding != 'jsonschema':
            raise RecordingError('its messages are JSON without a schema; record them with one')
        try:
            schema = json.loads(definition.text)
            self.type = _SchemaReader(name, schema).read(schema, name, 0)
        except (ValueError, RecursionError, AttributeError, TypeError):
            self.type = None
        if self.type is None or not self.type.members:
            raise RecordingError(f"the schema of the message type '{name}' cannot be read")
        super().__init__(definition.name, self._listed(name, self.type))

    @staticmethod
    def _listed(name: str, kind: _JsonType) -> Mapping[str, ValueType]:
        fields, length = {}, 0
        for path, value_type in kind.fields(''):
            fields[path] = value_type
            length += len(path)
            if length > MAX_TEXT:
                raise RecordingError(f"the names in the message type '{name}' are too long")
        return fields


class _SchemaReader:
    """Reads a schema; parts without a single type are left out."""

    def __init__(self, name: str, schema: Any) -> None:
        self._name = name
        self._schema = schema
        self._count = 0

    def read(self, part: Any, name: str, depth: int) -> _JsonType | None:
        self._count += 1
        if depth > _MAX_NESTING or self._count > MAX_VALUES:
            raise RecordingError(
                f"the message type '{self._name}' contains itself, or is too large"
            )
        if not isinstance(part, dict):
            return None
        if '$ref' in part:
            return self.read(self._definition(part['$ref']), name, depth + 1)
        kinds = part.get('type', 'object' if 'properties' in part else None)
        kinds = [kinds] if isinstance(kinds, str) else list(kinds or ())
        (kind, *others) = [each for each in kinds if each != 'null'] or (None,)
        found = None
        if kind in _VALUE_TYPES:
            found = _JsonType(name, _VALUE_TYPES[kind])
        elif kind == 'array' and (element := self.read(part.get('items'), name, depth + 1)):
            found = _JsonType(name, element=element)
        elif kind == 'object':
            read = {
                member: self.read(each, member, depth + 1)
                for member, each in part.get('properties', {}).items()
                if member.isidentifier() and member.isascii()
            }
            found = _JsonType(name, members={key: each for key, each in read.items() if each})
        return None if others else found

    def _definition(self, reference: str) -> Any:
        """Return the part of the schema that a reference names."""
        found = self._schema if reference.startswith('#') else None
        for step in reference.split('/')[1:]:
            found = found.get(step) if isinstance(found, dict) else None
        return found


class JsonReader:
    """Reader of some fields of the messages of one type.

    Args:
        layout: the layout of the type.
        paths: the paths of the fields, which the type has.

    Raises:
        RecordingError: if whole messages are wanted.
    """

    def __init__(self, layout: JsonLayout, paths: Collection[str]) -> None:
        if WHOLE in paths:
            raise RecordingError('frames and actions are not read from messages in JSON')
        self._stamp = layout.stamp_fields
        self._columns = ComputedColumns(layout.fields, {*paths, *self._stamp})
        self._read: Callable[[Any], Any] = (layout.type or _JsonType('')).value

    def read(self, messages: StoredMessages) -> tuple[DecodedFields, Mapping[str, int]]:
        """Return the fields of the messages, and the number of unreadable ones by their reason."""
        decoded = [self._decoded(each) for each in messages.contents()]
        fields = DecodedFields(np.array([each is not None for each in decoded], np.bool_))
        for path, values, absent in self._columns.read(decoded):
            fields.values[path] = values
            if absent:
                fields.absent[path] = dict(absent)
        # Without a whole stamp, a message is valid when it was recorded.
        lacking = [row for path in self._stamp for row in fields.absent.get(path, ())]
        for path in self._stamp:
            column = np.clip(fields.values[path], -(1 << 31), 1 << 32).astype(np.int64)
            column[lacking] = 0
            fields.values[path] = column
        lost = decoded.count(None)
        return fields, {'a message is no object in JSON': lost} if lost else {}

    def _decoded(self, message: bytes) -> Any:
        try:
            return self._read(json.loads(message))
        except (ValueError, RecursionError, NoValueError):
            return None
