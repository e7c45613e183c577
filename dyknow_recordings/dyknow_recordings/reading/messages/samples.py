"""Samples of streams: messages with typed values under names, as from other hosts."""

from __future__ import annotations

import struct
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from dyknow_common import Alternatives, Value, ValueType
from dyknow_recordings.reading.messages.cdr import CdrReader, DecodedFields, WholeMessageReader
from dyknow_recordings.reading.messages.definitions import MessageTypes, TypeDefinition
from dyknow_recordings.reading.messages.layouts import MessageLayout, TypeLayout
from dyknow_recordings.reading.messages.stored_messages import StoredMessages
from dyknow_stream_processing import VALUE_PARSERS, column_of

_FIELDS = 'fields'


class SampleLayout(TypeLayout):
    """The fields of samples: their members, and their values by name.

    Args:
        definition: the definition of the type of samples.
        types: where to find the definitions that its text lacks.
        first: the first sample as it is serialised; all samples have its names.
    """

    def __init__(self, definition: TypeDefinition, types: MessageTypes, first: bytes) -> None:
        super().__init__(definition, types)
        self.named = {
            name: ValueType.of(value.values[0] if isinstance(value, Alternatives) else value)
            for name, value in (_Values(self).read(first) or {}).items()
        }
        MessageLayout.__init__(self, self.name, {**self.fields, **self.named}, self.unread)


class NamedValueReader:
    """Reader of some fields of samples.

    Args:
        layout: the layout of the samples.
        paths: the paths of the fields, which the samples have.
    """

    def __init__(self, layout: SampleLayout, paths: Collection[str]) -> None:
        self._names = sorted(layout.named.keys() & paths)
        self._reader = CdrReader(layout, {*paths} - layout.named.keys())
        self._values = _Values(layout)

    def read(self, messages: StoredMessages) -> tuple[DecodedFields, Mapping[str, int]]:
        """Return the fields of the messages, and the number of unreadable ones by their reason."""
        fields, faults = self._reader.read(messages)
        rows = [self._values.read(each) for each in messages.contents()]
        lost = fields.intact & np.array([each is None for each in rows], np.bool_)
        fields.intact &= ~lost
        for name in self._names:
            found = [each.get(name) if each else None for each in rows]
            known = [each for each in found if each is not None]
            # Rows without a value are absent, or are not intact.
            column = [known[0] if known and each is None else each for each in found]
            fields.values[name] = column_of(column)
            reason = f"the sample has no field '{name}'"
            lacking = {
                row: reason
                for row, each in enumerate(rows)
                if each is not None and name not in each
            }
            if lacking:
                fields.absent[name] = lacking
        reason = 'a sample has a field that is no value'
        return fields, {**faults, **({reason: int(lost.sum())} if lost.any() else {})}


class _Values:
    """Reader of the values of serialised samples."""

    def __init__(self, layout: TypeLayout) -> None:
        self._reader = WholeMessageReader(layout, [_FIELDS])

    def read(self, data: bytes) -> dict[str, Value] | None:
        """Return the values of a sample by name; None if it cannot be read."""
        try:
            fields: Any = self._reader.read(data).fields
            return {each.name: VALUE_PARSERS[each.type](each.value) for each in fields}
        except (LookupError, ValueError, struct.error):
            return None
