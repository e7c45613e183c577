"""The file from which a stream manager restores its streams."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from dyknow_common import ExitCode, read_file, replace_private
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.management.persistence import streams_from_json, streams_to_json
from dyknow_stream_processing.management.streams import Stream


class PersistenceFile:
    """File that keeps streams over a restart.

    Args:
        path: the path of the file; if empty, nothing is kept.
        manager: the name of the node whose streams it keeps.
    """

    def __init__(self, path: str, manager: str) -> None:
        self._manager = manager
        self._path = Path(path) if path else None
        self._written = ''

    def read(self) -> tuple[Stream, ...]:
        """Return the streams in the file; none if there is no file yet.

        Raises:
            StreamError: naming the file, if it cannot be read, was not written by `write`, or is
                that of another manager.
        """
        if self._path is None or not os.path.lexists(self._path):
            return ()
        if not self._path.is_file():
            message = f'cannot read the streams in {self._path}: it is no regular file'
            raise StreamError(message)

        def parse(text: str) -> tuple[Stream, ...]:
            return streams_from_json(text, self._manager)

        return read_file(self._path, 'streams', parse, StreamError)

    def write(self, streams: Iterable[Stream]) -> None:
        """Replace the content of the file; an interrupted write leaves the old content.

        Raises:
            StreamError: if the file cannot be written.
        """
        if self._path is None:
            return
        text = streams_to_json(streams, self._manager)
        if text == self._written:
            return
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            replace_private(self._path, text)
        except OSError as error:
            raise StreamError(
                f'cannot write the memory {self._path}: {error.strerror}', ExitCode.UNAVAILABLE
            ) from None
        self._written = text
