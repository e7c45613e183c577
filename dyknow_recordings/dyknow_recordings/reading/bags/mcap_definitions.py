"""The schemas and channels of an MCAP file."""

from __future__ import annotations

from dyknow_recordings.reading.bags.mcap_records import U16, McapCode, read_string, read_strings
from dyknow_recordings.reading.bags.storage import StoredChannel, offered_quality
from dyknow_recordings.reading.messages.definitions import TypeDefinition


class McapDefinitions:
    """The schemas and channels that have been read; of equal numbers, the first holds."""

    def __init__(self) -> None:
        self._schemas: dict[int, TypeDefinition] = {}
        self.channels: dict[int, StoredChannel] = {}

    def read(self, code: int, record: bytes) -> None:
        """Read the record of a schema or channel.

        Raises:
            ValueError, struct.error, IndexError: for a record that is shorter than its content.
        """
        (key,) = U16.unpack_from(record, 0)
        if code == McapCode.SCHEMA:
            name, position = read_string(record, 2)
            encoding, position = read_string(record, position)
            text, _ = read_string(record, position)
            self._schemas.setdefault(key, TypeDefinition(name, encoding, text))
            return
        (schema,) = U16.unpack_from(record, 2)
        topic, position = read_string(record, 4)
        serialisation, position = read_string(record, position)
        metadata = read_strings(record, position)
        self.channels.setdefault(
            key,
            StoredChannel(
                topic,
                self._schemas.get(schema, TypeDefinition('unknown')),
                serialisation,
                offered_quality(metadata.get('offered_qos_profiles', '')),
            ),
        )
