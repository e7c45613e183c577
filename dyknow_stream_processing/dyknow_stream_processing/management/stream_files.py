"""Files in the stream language: each sink in them is a stream that is made at the start."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from dyknow_common import NO_CONSTRAINTS, ExitCode, InlineText, read_file
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.parsing import parse_specification
from dyknow_stream_processing.language.sinks import specifications_by_sink
from dyknow_stream_processing.language.specification import Specification
from dyknow_stream_processing.management.streams import CreatedStream


def read_streams(files: Iterable[Path | InlineText]) -> Iterator[CreatedStream]:
    """Yield a stream for each sink in files in the stream language.

    Raises:
        StreamError: naming a file that cannot be read or parsed.
    """
    known: set[str] = set()
    for path in files:
        for name, part in read_file(path, 'streams', _specifications, StreamError).items():
            if name in known:
                message = f"{path}: there is a sink '{name}' in another file already; keep one"
                raise StreamError(message, ExitCode.ALREADY_EXISTS)
            known.add(name)
            yield CreatedStream(name, str(part), NO_CONSTRAINTS)


def _specifications(text: str) -> Mapping[str, Specification]:
    return specifications_by_sink(parse_specification(text))
