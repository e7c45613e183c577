"""Streams, as a stream manager knows them, and as files in the stream language state them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from dyknow_common import (
    NO_CONSTRAINTS,
    ExitCode,
    InlineText,
    StreamConstraints,
    cached_by_text,
    read_file,
)
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.parsing import parse_specification
from dyknow_stream_processing.language.sinks import specifications_by_sink
from dyknow_stream_processing.language.specification import Specification
from dyknow_stream_processing.reporting.stream_report import SAMPLE_TYPE


@dataclass(frozen=True, slots=True)
class CreatedStream:
    """A stream that an engine makes.

    Args:
        specification: the text, as it was requested or as an engine reports it.
        engine: the node that makes it or is asked to; `None` while it waits for an engine.
        topic: the topic of its samples; empty until an engine makes it.
        stream_id: as its engine stated it when it made the stream; 0 if a manager found it made.
        sources: the topics of the streams that it is made from and that other nodes publish.
        message: why it waits or failed; where, when and why it was recreated.
        reported: True for the text of an engine, with aliases that a manager wrote into it.
        lost: why its last engine no longer makes it; empty if it had none.
        failed: True if it cannot be made and a later attempt would fail for the same reason.
    """

    name: str
    specification: str
    constraints: StreamConstraints
    engine: str | None = None
    topic: str = ''
    stream_id: int = 0
    sources: Mapping[str, str] = field(default_factory=dict)
    message: str = ''
    lost: str = ''
    failed: bool = False
    reported: bool = False
    message_type: str = SAMPLE_TYPE

    @property
    def waits(self) -> bool:
        """True if no engine makes it or is asked to."""
        return self.engine is None

    @property
    def definition(self) -> str:
        """The canonical text with the constraints, on one line."""
        text = ' '.join(canonical(self.specification).split())
        return f"'{text}'" if self.constraints.is_empty else f"'{text}' with {self.constraints}"


@dataclass(frozen=True, slots=True)
class RegisteredStream:
    """A topic of another program that was registered under a stream name."""

    name: str
    topic: str
    message_type: str


Stream = CreatedStream | RegisteredStream


@cached_by_text
def canonical(specification: str) -> str:
    """Return the canonical text of a specification."""
    return str(parse_specification(specification))


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
