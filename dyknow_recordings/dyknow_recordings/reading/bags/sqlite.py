"""Files of the storage format sqlite3."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from shlex import quote
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.bags.storage import (
    MAX_BLOCK_BYTES,
    StoredChannel,
    offered_quality,
)
from dyknow_recordings.reading.messages.definitions import LATEST, TypeDefinition
from dyknow_recordings.reading.messages.stored_messages import StoredBlock, StoredMessages
from dyknow_recordings.reading.recording import (
    BEGINNING,
    END,
    MAX_TIME,
    FaultCounter,
    count_steps_back,
)

SQLITE_MAGIC: Final = b'SQLite format 3\0'

_BLOCK_SIZE: Final = 4096
_BLOCK_BYTES: Final = 1 << 18
_PAGE_SIZE_AT: Final = 16
_TABLES: Final = ('messages', 'topics', 'message_definitions')
_SMALLEST_PAGE: Final = 512
_ERRORS: Final = (sqlite3.Error, LookupError, UnicodeDecodeError)
"""Raised where a damaged database has other tables than a bag."""


def partial_page(path: Path) -> int:
    """Return the number of bytes after the last whole page, which SQLite would fill with zeros."""
    with path.open('rb') as file:
        header = file.read(_PAGE_SIZE_AT + 2)
    if not header.startswith(SQLITE_MAGIC):
        return 0
    size = int.from_bytes(header[_PAGE_SIZE_AT:], 'big')
    # The size 65536 is written as 1.
    page = max(_SMALLEST_PAGE, 1 << 16 if size == 1 else size)
    length = path.stat().st_size
    return length % page if length > page else 0


def _open(path: Path) -> sqlite3.Connection:
    # Immutable: also readable in a folder that is not writable, where SQLite makes no lock.
    # What a crashed recorder has left in a log beside the file is only read without it.
    has_log = path.with_name(f'{path.name}-wal').exists()
    options = '?mode=ro' if has_log else '?mode=ro&immutable=1'
    database = sqlite3.connect(f'{path.absolute().as_uri()}{options}', uri=True)
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_BLOCK_BYTES)
    # Without it, SQLite reads no page of a file that ends early.
    database.execute('PRAGMA writable_schema = ON')
    database.text_factory = lambda text: str(text, 'utf-8', 'replace')
    return database


class SqliteFile:
    """A file of the storage format sqlite3, which has no times of sending.

    Args:
        path: the path of the file.
        name: the name of the file in errors and faults.
        faults: where faults are counted.

    Raises:
        RecordingError: if the file is empty, no database, or no part of a bag.
    """

    def __init__(self, path: Path, name: str, faults: FaultCounter) -> None:
        self._name = name
        self.faults = faults
        self.has_sent_times = False
        with path.open('rb') as file:
            start = file.read(len(SQLITE_MAGIC))
        if start != SQLITE_MAGIC:
            reason = 'is no database of SQLite' if start else 'is empty'
            raise RecordingError(f'{name}: the file {reason}; was it copied completely?')
        with ExitStack() as stack:
            try:
                self._database = stack.enter_context(closing(_open(path)))
                self._channels = self._read_channels()
            except _ERRORS as error:
                mend = (
                    f'; to rescue a part of it: sqlite3 {quote(name)} .recover | sqlite3 part.db3'
                )
                is_damaged = type(error) is sqlite3.DatabaseError
                reason = f'not a readable bag: {error}{mend * is_damaged}'
                raise RecordingError(f'{name}: {reason}') from None
            self._is_damaged = False
            self._count()
            stack.pop_all()

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def blocks(
        self,
        wanted: Collection[StoredChannel],
        numbers: Mapping[StoredChannel, int],
        former: object,  # noqa: ARG002 - it has no sequence numbers
    ) -> Iterator[StoredBlock]:
        """Yield the messages of some channels; arguments as in `StorageFile`."""
        ids = {
            key: numbers[channel] for key, channel in self._channels.items() if channel in wanted
        }
        if self._is_damaged:
            return self._salvaged_blocks(ids)
        return self._ordered_blocks(ids)

    def _read_channels(self) -> dict[int, StoredChannel]:
        self._check_tables()
        definitions: dict[str, TypeDefinition] = {}
        # Bags of ROS 2 Humble and before have no definitions.
        self.default_distro = 'humble'
        if self._rows("SELECT name FROM sqlite_master WHERE name = 'message_definitions'"):
            self.default_distro = LATEST
            definitions = {
                row['topic_type']: TypeDefinition(
                    str(row['topic_type']),
                    str(row['encoding']),
                    str(row['encoded_message_definition']),
                )
                for row in self._rows('SELECT * FROM message_definitions')
            }
        return {
            row['id']: StoredChannel(
                str(row['name']),
                definitions.get(row['type'], TypeDefinition(str(row['type']))),
                str(row['serialization_format']),
                offered_quality(row.get('offered_qos_profiles', '')),
            )
            for row in self._rows('SELECT * FROM topics')
        }

    def _check_tables(self) -> None:
        """Check that the tables are tables: a view may have any number of rows."""
        names = ', '.join(map(repr, _TABLES))
        query = f'SELECT name, sql FROM sqlite_master WHERE LOWER(name) IN ({names})'
        for name, text in self._database.execute(query):
            if not str(text).startswith('CREATE TABLE'):
                raise RecordingError(
                    f"{self._name}: '{name}' is no table; no bag has such a database"
                )

    def _rows(self, query: str) -> list[dict[str, Any]]:
        cursor = self._database.execute(query)
        names = [column[0] for column in cursor.description]
        return [dict(zip(names, row, strict=True)) for row in cursor]

    def _count(self) -> None:
        try:
            query = 'SELECT topic_id, timestamp FROM messages NOT INDEXED'
            kind = np.dtype([('topic', np.int64), ('time', np.int64)])
            found = np.fromiter(self._database.execute(query), kind)
            # Reading in order uses the index of times.
            query = 'SELECT COUNT(timestamp) FROM messages'
            (indexed,) = self._database.execute(query).fetchone()
            if indexed != len(found):
                self._is_damaged = True
                self.faults.miscounted(self._name, None, len(found), indexed, 'index of the times')
        except (*_ERRORS, TypeError, ValueError) as error:
            self._is_damaged = True
            why = (
                error
                if isinstance(error, _ERRORS)
                else 'a message has no number for its topic or time'
            )
            reason = f'the database is damaged: {why}'
            found, first = self._readable_messages()
            if first is None:
                self.faults.add(self._name, reason)
            else:
                self.faults.lose(self._name, reason, first=first)
        counts = Counter(found['topic'].tolist())
        if unknown := counts.keys() - self._channels.keys():
            reason = 'a message is of no topic'
            self.faults.lose(self._name, reason, sum(counts[each] for each in unknown))
        self.counts: dict[StoredChannel, int] = {}
        for key, channel in self._channels.items():
            self.counts[channel] = self.counts.get(channel, 0) + counts[key]
        times = found['time']
        self.span = (int(times.min()), int(times.max())) if len(times) else None
        count_steps_back(times, self._name, self.faults)

    def _ordered_blocks(self, ids: Mapping[int, int]) -> Iterator[StoredBlock]:
        marks = ', '.join('?' * len(ids))
        query = f'SELECT timestamp, topic_id, data FROM messages WHERE topic_id IN ({marks})'
        latest = BEGINNING
        try:
            cursor = self._database.execute(f'{query} ORDER BY timestamp', list(ids))
            count = 1
            while rows := cursor.fetchmany(count):
                yield from self._block(rows, ids)
                latest = max(latest, *(row[0] + 1 for row in rows if type(row[0]) is int))
                size = sum(len(row[-1] or b'') for row in rows)
                count = min(max(1, _BLOCK_BYTES * len(rows) // (size + 1)), 4 * count, _BLOCK_SIZE)
        except sqlite3.Error as error:
            reason = f'the database is damaged, the rest of it is lost: {error}'
            self.faults.lose(self._name, reason, first=latest)

    def _salvaged_blocks(self, ids: Mapping[int, int]) -> Iterator[StoredBlock]:
        """Read each message by its number, in the order of their times."""
        found, _ = self._readable_messages()
        found = found[np.isin(found['topic'], list(ids))]
        found = found[np.argsort(found['time'], kind='stable')]
        for start in range(0, len(found), _BLOCK_SIZE):
            rows = []
            for row, time, topic in found[start : start + _BLOCK_SIZE].tolist():
                try:
                    query = 'SELECT data FROM messages WHERE id = ?'
                    rows += [
                        (time, topic, data) for (data,) in self._database.execute(query, [row])
                    ]
                except sqlite3.Error:
                    rows.append((time, topic, None))
            yield from self._block(rows, ids)

    def _readable_messages(self) -> tuple[NDArray[np.void], int | None]:
        """Return the number, time and topic of the messages up to the first damage.

        Return also the log time from which on messages may be lost; None if none are.
        """
        found: list[tuple[int, int, int]] = []
        first, longest_step_back, reached = None, 0, BEGINNING
        try:
            query = 'SELECT id, timestamp, topic_id FROM messages NOT INDEXED'
            for row in self._database.execute(query):
                if all(type(value) is int for value in row):
                    found.append(row)
                    longest_step_back = max(longest_step_back, reached - row[1])
                    reached = max(reached, row[1] + 1)
                else:
                    first = BEGINNING
        except sqlite3.Error:
            first = reached - longest_step_back if first is None else first
        kind = [('id', np.int64), ('time', np.int64), ('topic', np.int64)]
        return np.array(found, np.dtype(kind)), first

    def _block(self, rows: list[Any], ids: Mapping[int, int]) -> Iterator[StoredBlock]:
        found = rows
        times, keys, data = zip(*rows, strict=True) if rows else ((), (), ())
        if {*map(type, times)} != {int} or {*map(type, data)} != {bytes} or min(times) < 0:
            found = [row for row in rows if _is_whole(row)]
            times, keys, data = zip(*found, strict=True) if found else ((), (), ())
        if len(found) < len(rows):
            self._lose([row for row in rows if not _is_whole(row)])
        if found:
            yield times[0], partial(StoredMessages.of, times, [ids[key] for key in keys], data)

    def _lose(self, rows: list[Any]) -> None:
        times = [time for time, _, _ in rows if type(time) is int and 0 <= time < MAX_TIME]
        is_known = len(times) == len(rows)
        self.faults.lose(
            self._name,
            'a message has no time or no data',
            len(rows),
            topics={self._channels[key].topic for _, key, _ in rows},
            first=min(times) if is_known else BEGINNING,
            last=max(times) if is_known else END,
        )


def _is_whole(row: tuple[Any, Any, Any]) -> bool:
    time, _, data = row
    return type(time) is int and type(data) is bytes and 0 <= time < MAX_TIME
