"""SQLite files of the stores: private, checked before they are used, with errors that say more."""

from __future__ import annotations

import os
import sqlite3
import stat
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Final

from dyknow_common import ExitCode, listed
from dyknow_common.text_files import NO_WAIT
from dyknow_semantics.errors import SemanticsError

LOCK_TIMEOUT_S: Final = 1.0
"""The longest wait for another process to release the lock of a file."""

_RESTORE: Final = 'restore it from a backup, or move it away to begin with an empty one'
_MENDS: Final = {
    'SQLITE_BUSY': (
        'another process uses it: stop that, or give another file (to the live page with --history '
        "FILE, to a node as its parameter 'store')"
    ),
    'SQLITE_CANTOPEN': 'create its folder, and let this user read and write there',
    'SQLITE_CORRUPT': f'it is damaged: {_RESTORE}',
    'SQLITE_FULL': 'nothing was changed; free space on its disk',
    'SQLITE_IOERR': 'nothing was changed; check its disk and the space there',
    'SQLITE_NOTADB': f'it is damaged or of another kind: {_RESTORE}',
    'SQLITE_PERM': 'let this user read and write it',
    'SQLITE_READONLY': 'let this user write it and its folder',
}
"""The mend, by the name of an error of SQLite, or by its beginning."""


@contextmanager
def store_errors(kind: str, file: Path | None) -> Iterator[None]:
    """Raise each error of SQLite in the body with the name of the file and what to do.

    Args:
        kind: the kind of the store in messages: `ontology store`.
        file: its file; `None` if it is in memory.

    Raises:
        SemanticsError: UNAVAILABLE.
    """
    try:
        yield
    except sqlite3.Error as error:
        name = getattr(error, 'sqlite_errorname', None) or ''
        mends = [mend for prefix, mend in _MENDS.items() if name.startswith(prefix)]
        raise _unusable(kind, file, str(error), *mends) from None


def prepare_file(file: Path, kind: str, tables: frozenset[str]) -> None:
    """Create the file of a store if there is none, or else check it; nothing in it is changed.

    Only its owner may read and write a new file.

    Args:
        file: the file.
        kind: the kind of the store in messages.
        tables: a store has these.

    Raises:
        SemanticsError: UNAVAILABLE, if it cannot be used, is damaged, or is something else.
    """
    try:
        with open(file, 'ab', opener=_private) as opened:
            status = os.fstat(opened.fileno())
    except OSError as error:
        mend = 'create its folder, and let this user read and write there'
        raise _unusable(kind, file, str(error.strerror or error), mend) from None
    if not stat.S_ISREG(status.st_mode):
        raise _unusable(kind, file, 'it is no regular file', 'give the path of a file')
    if not status.st_size:
        return
    with (
        store_errors(kind, file),
        closing(sqlite3.connect(file, timeout=LOCK_TIMEOUT_S)) as connection,
    ):
        found = {
            name
            for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
        }
        ((fault, *_), *_) = connection.execute('PRAGMA quick_check(1)').fetchall()
    if fault != 'ok':
        raise _unusable(kind, file, fault, _MENDS['SQLITE_CORRUPT'])
    if found and not tables <= found:
        reason = f'it has the tables {listed(sorted(found))}, which are not those of such a store'
        raise _unusable(kind, file, reason, _MENDS['SQLITE_NOTADB'])


def opened_store(
    file: Path | None, kind: str, version: int, tables: Mapping[str, str]
) -> sqlite3.Connection:
    """Open a store, which is created if there is none. Then no other process may write to it.

    Args:
        file: its file; `None` keeps it in memory.
        kind: the kind of the store in messages.
        version: the version of the tables; stores from before it was written have 0.
        tables: the statements that create each table, if it does not exist.

    Raises:
        SemanticsError: UNAVAILABLE, if it cannot be used, is damaged, or is something else.
    """
    if file is not None:
        prepare_file(file, kind, frozenset(tables))
    with store_errors(kind, file), ExitStack() as resources:
        connection = sqlite3.connect(file or ':memory:', timeout=LOCK_TIMEOUT_S)
        resources.callback(connection.close)
        connection.execute('PRAGMA locking_mode = EXCLUSIVE')
        # Writes survive the end of the process, and do not wait for the disk.
        connection.execute('PRAGMA journal_mode = WAL')
        connection.execute('PRAGMA synchronous = NORMAL')
        (found,) = connection.execute('PRAGMA user_version').fetchone()
        if found > version:
            raise newer_version(kind, file, found, version)
        connection.executescript(
            f'BEGIN; {"".join(tables.values())} PRAGMA user_version = {version}; COMMIT;'
        )
        resources.pop_all()
    return connection


def newer_version(kind: str, file: Path | None, version: int, known: int) -> SemanticsError:
    """Return the error for a store of a version that is not known yet."""
    reason = f'it has version {version}, and this node knows versions up to {known}'
    return _unusable(kind, file, reason, 'update this node, or give it a store of its own')


def _private(path: str, flags: int) -> int:
    # A pipe without a reader must not make the node wait.
    return os.open(path, flags | NO_WAIT, 0o600)


def _unusable(kind: str, file: Path | None, reason: str, *mends: str) -> SemanticsError:
    text = '; '.join([f"cannot open the {kind} '{file}': {reason}", *mends])
    return SemanticsError(text, ExitCode.UNAVAILABLE)
