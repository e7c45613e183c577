"""Whole messages, as objects with their fields as attributes."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.messages.cdr import DecodedFields
from dyknow_recordings.reading.messages.layouts import TypeLayout
from dyknow_recordings.reading.messages.stored_messages import StoredMessages


class MessageDecoder:
    """Decoder of the messages of a type, for the few that are needed as a whole.

    Args:
        layout: of the type.

    Raises:
        RecordingError: if its definition cannot be used.
    """

    def __init__(self, layout: TypeLayout) -> None:
        self._name = layout.name
        self._store = _store(layout)

    def decode(self, messages: StoredMessages, fields: DecodedFields, name: str) -> int:
        """Add the messages to their fields, by a name; return the number of unreadable ones.

        These are not intact then.
        """
        column = np.empty(len(messages), np.object_)
        unreadable = 0
        for row, data in enumerate(messages.contents()):
            if fields.intact[row]:
                try:
                    column[row] = self._store.deserialize_cdr(data, self._name)
                except MemoryError:
                    raise
                # Damaged messages make the library raise errors of many kinds.
                except Exception:  # noqa: BLE001
                    fields.intact[row] = False
                    unreadable += 1
        fields.values[name] = column
        return unreadable


@cache
def _store(layout: TypeLayout) -> Typestore:
    types: Any = {name: ([], list(members)) for name, members in layout.reachable().items()}
    store = get_typestore(Stores.EMPTY)
    try:
        store.register(types)
    except Exception as error:
        # Damaged definitions make the library raise errors of many kinds.
        raise RecordingError(
            f"messages of the type '{layout.name}' cannot be decoded by its definition"
        ) from error
    return store
