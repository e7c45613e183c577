"""The files from which a stream manager restores and makes streams at its start."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from dyknow_common import NO_CONSTRAINTS, ExitCode, read_file, replace_private
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.parsing import parse_specification
from dyknow_stream_processing.language.sinks import specifications_by_sink
from dyknow_stream_processing.language.specification import Specification
from dyknow_stream_processing.management.persistence import streams_from_json, streams_to_json
from dyknow_stream_processing.management.streams import CreatedStream, Stream


def read_streams(paths: Iterable[str]) -> Iterator[CreatedStream]:
    """Yield a stream for each sink in files in the stream language.

    Raises:
        StreamError: naming a file that cannot be read or parsed.
    """
    known: set[str] = set()
    for path in map(Path, paths):
        for name, part in read_file(path, 'streams', _specifications, StreamError).items():
            if name in known:
                message = f"{path}: there is a sink '{name}' in another file already; keep one"
                raise StreamError(message, ExitCode.ALREADY_EXISTS)
            known.add(name)
            yield CreatedStream(name, str(part), NO_CONSTRAINTS)


def _specifications(text: str) -> Mapping[str, Specification]:
    return specifications_by_sink(parse_specification(text))


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
