"""A store of annotations: the texts of added annotations, in their order, in an SQLite file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import Final

from dyknow_common import DyKnowError, ExitCode, listed, shortened
from dyknow_semantics.annotations.annotation import Annotation
from dyknow_semantics.annotations.parsing import parse_annotations
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.sqlite_files import opened_store, store_errors

_KIND: Final = 'store of annotations'
_VERSION: Final = 1
_TABLE: Final = """
CREATE TABLE IF NOT EXISTS annotation (stream TEXT, text TEXT UNIQUE);
CREATE INDEX IF NOT EXISTS stream ON annotation (stream);
"""


class AnnotationStore:
    """Annotations in a file; each change is in the file when its method returns.

    Args:
        file: is created if it does not exist; `None` keeps the annotations in memory only.

    Raises:
        SemanticsError: if the file is in use, damaged or not a store of annotations; from the
            methods that write, if they cannot, as the disk is full.
    """

    def __init__(self, file: Path | None = None) -> None:
        self._file = file
        self._connection = opened_store(file, _KIND, _VERSION, {'annotation': _TABLE})
        with self._sqlite_errors(), ExitStack() as resources:
            resources.callback(self._connection.close)
            self._annotations = self._read()
            resources.pop_all()

    @property
    def by_text(self) -> Mapping[str, Annotation]:
        """All annotations, by canonical text, in the order in which they were added."""
        return dict(self._annotations)

    @property
    def texts(self) -> tuple[str, ...]:
        """The canonical texts of all annotations, in the same order."""
        return tuple(self._annotations)

    def __contains__(self, annotation: Annotation) -> bool:
        return str(annotation) in self._annotations

    def close(self) -> None:
        """Close the file and release its lock."""
        self._connection.close()

    def add(self, annotations: Iterable[Annotation]) -> None:
        """Add annotations, all or none.

        Raises:
            SemanticsError: ALREADY_EXISTS, if one exists already or is given twice.
        """
        added: dict[str, Annotation] = {}
        for annotation in annotations:
            text = str(annotation)
            if text in added or text in self._annotations:
                raise SemanticsError(
                    f"there is already the annotation '{shortened(text)}'",
                    ExitCode.ALREADY_EXISTS,
                )
            added[text] = annotation
        with self._sqlite_errors(), self._connection:
            self._connection.executemany(
                'INSERT INTO annotation (stream, text) VALUES (?, ?)',
                [(annotation.stream, text) for text, annotation in added.items()],
            )
        self._annotations |= added

    def remove(self, stream: str) -> tuple[Annotation, ...]:
        """Remove all annotations of a stream, and return them.

        Raises:
            SemanticsError: NOT_FOUND, if it has none.
        """
        removed = {text: each for text, each in self._annotations.items() if each.stream == stream}
        if not removed:
            streams = sorted({each.stream for each in self._annotations.values()})
            raise SemanticsError(
                f"stream '{shortened(stream)}' has no annotation "
                f'(there are: {listed(streams) or "none"})',
                ExitCode.NOT_FOUND,
            )
        with self._sqlite_errors(), self._connection:
            self._connection.execute('DELETE FROM annotation WHERE stream = ?', (stream,))
        for text in removed:
            del self._annotations[text]
        return tuple(removed.values())

    def _read(self) -> dict[str, Annotation]:
        rows = self._connection.execute('SELECT text FROM annotation ORDER BY rowid').fetchall()
        try:
            return {text: each for (text,) in rows for each in parse_annotations(text)}
        except DyKnowError as error:
            raise SemanticsError(f'{self._file}: {error.message}', error.code) from None

    def _sqlite_errors(self) -> AbstractContextManager[None]:
        return store_errors(_KIND, self._file)
