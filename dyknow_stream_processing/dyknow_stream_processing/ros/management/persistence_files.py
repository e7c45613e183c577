"""The files from which a stream manager learns at its start what is wanted of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from dyknow_common import NO_CONSTRAINTS, ExitCode, read_file
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.parsing import parse_specification
from dyknow_stream_processing.language.sinks import specifications_by_sink
from dyknow_stream_processing.language.specification import Specification
from dyknow_stream_processing.management.persistence import read_memory, write_memory
from dyknow_stream_processing.management.registry import CreatedStream, Stream


def read_streams(paths: Iterable[str]) -> Iterator[CreatedStream]:
    """A stream for each sink in files in the stream language.

    Raises:
        StreamError: when a file cannot be read, or is in no such language; it names the file.
    """
    known: set[str] = set()
    for path in map(Path, paths):
        parts = read_file(path, 'streams', _sinks, StreamError)
        for name, part in parts.items():
            if name in known:
                message = f"{path}: there is a sink '{name}' in another file already; keep one"
                raise StreamError(message, ExitCode.ALREADY_EXISTS)
            known.add(name)
            yield CreatedStream(name, str(part), NO_CONSTRAINTS)


class PersistenceFile:
    """Keeps streams over a restart.

    Args:
        path: of the file; nothing is kept where it is empty.
    """

    def __init__(self, path: str) -> None:
        self._path = Path(path) if path else None
        self._written = ''

    def read(self) -> tuple[Stream, ...]:
        """The streams in the file; none where there is no file yet.

        Raises:
            StreamError: when it cannot be read, or somebody else wrote it; it names the file.
        """
        if self._path is None or not self._path.exists():
            return ()
        return read_file(self._path, 'streams', read_memory, StreamError)

    def write(self, streams: Iterable[Stream]) -> None:
        """Replaces what is in the file; one who dies meanwhile leaves what was there.

        Raises:
            StreamError: when the file cannot be written.
        """
        if self._path is None:
            return
        text = write_memory(streams)
        if text == self._written:
            return
        draft = self._path.with_name(f'{self._path.name}.new')
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            draft.write_text(text, encoding='utf-8')
            draft.replace(self._path)
        except OSError as error:
            raise StreamError(
                f'cannot write the memory {self._path}: {error.strerror}', ExitCode.UNAVAILABLE
            ) from None
        self._written = text


def _sinks(text: str) -> Mapping[str, Specification]:
    return specifications_by_sink(parse_specification(text))
