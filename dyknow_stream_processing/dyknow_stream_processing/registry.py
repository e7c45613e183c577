"""What the stream manager knows: every stream, its topic, and the engine that makes it (VI-A.2)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from dyknow_stream_processing.errors import ExitCode, StreamError
from dyknow_stream_processing.parsing import parse_specification
from dyknow_stream_processing.resolution import free_names
from dyknow_stream_processing.specification import Reference, StreamDeclaration

if TYPE_CHECKING:
    from collections.abc import Iterable

    from dyknow_stream_processing.constraints import StreamConstraints

SAMPLE_TYPE: Final = 'dyknow_interfaces/msg/Sample'


@dataclass(frozen=True, slots=True)
class CreatedStream:
    """A stream that an engine makes.

    Args:
        specification: its text; none when another asked the engine for it, so that it cannot be
            made anew elsewhere.
        engine: the name of the node that makes it; none while it waits for one.
        topic: where its samples are; empty while it waits.
    """

    name: str
    specification: str | None
    constraints: StreamConstraints
    engine: str | None = None
    topic: str = ''
    message_type: str = SAMPLE_TYPE


@dataclass(frozen=True, slots=True)
class RegisteredStream:
    """A topic of some other program that was given a stream name."""

    name: str
    topic: str
    message_type: str


Stream = CreatedStream | RegisteredStream


class StreamRegistry:
    """All streams of a system, by name."""

    def __init__(self) -> None:
        self._streams: dict[str, Stream] = {}

    def names(self) -> tuple[str, ...]:
        """The streams that flow, sorted; those that wait for an engine are not among them."""
        return tuple(sorted(name for name, stream in self._streams.items() if stream.topic))

    def waiting(self) -> tuple[CreatedStream, ...]:
        """The streams that wait for an engine, in the order in which they were asked for."""
        created = [each for each in self._streams.values() if isinstance(each, CreatedStream)]
        return tuple(each for each in created if each.engine is None)

    def find(self, name: str) -> Stream:
        """A stream.

        Raises:
            StreamError: NOT_FOUND, naming the streams that there are.
        """
        if name not in self._streams:
            raise StreamError(
                f"there is no stream '{name}' (there are: {', '.join(self.names()) or 'none'})",
                ExitCode.NOT_FOUND,
            )
        return self._streams[name]

    def add(self, stream: Stream) -> None:
        """Makes a stream known.

        Raises:
            StreamError: ALREADY_EXISTS.
        """
        if stream.name in self._streams:
            raise StreamError(f"there is a stream '{stream.name}' already", ExitCode.ALREADY_EXISTS)
        self._streams[stream.name] = stream

    def remove(self, name: str) -> Stream:
        """Forgets a stream.

        Raises:
            StreamError: NOT_FOUND, naming the streams that there are.
        """
        stream = self.find(name)
        del self._streams[name]
        return stream

    def place(self, name: str, engine: str, topic: str) -> None:
        """Notes that an engine makes a stream now."""
        stream = self._streams.get(name)
        if isinstance(stream, CreatedStream):
            self._streams[name] = replace(stream, engine=engine, topic=topic)

    def lose(self, engine: str) -> None:
        """Notes that an engine is gone: its streams wait for another, or are gone with it."""
        for stream in self.made_by(engine):
            if stream.specification is None:
                del self._streams[stream.name]
            else:
                self._streams[stream.name] = replace(stream, engine=None, topic='')

    def made_by(self, engine: str) -> tuple[CreatedStream, ...]:
        """The streams of an engine."""
        created = [each for each in self._streams.values() if isinstance(each, CreatedStream)]
        return tuple(each for each in created if each.engine == engine)

    def least_loaded(self, engines: Iterable[str]) -> str | None:
        """The engine with the fewest streams; none where there is no engine."""
        return min(engines, key=lambda engine: (len(self.made_by(engine)), engine), default=None)

    def text_for(self, specification: str, engine: str) -> str:
        """A specification as an engine can make it: names it does not know become topics.

        Raises:
            LanguageError: when the text is no specification.
            StreamError: NOT_FOUND or UNAVAILABLE, for a stream that it is made of.
        """
        parsed = parse_specification(specification)
        aliases = [self._alias(name, engine) for name in sorted(free_names(parsed).streams)]
        return ';\n'.join([*filter(None, aliases), str(parsed)])

    def _alias(self, name: str, engine: str) -> str | None:
        stream = self.find(name)
        if isinstance(stream, CreatedStream) and stream.engine == engine:
            return None
        if not stream.topic:
            raise StreamError(
                f"stream '{name}' waits for a stream processing engine", ExitCode.UNAVAILABLE
            )
        return str(StreamDeclaration(name, Reference(stream.topic, is_topic=True)))


def engines_missing(engines: Iterable[str]) -> StreamError:
    """The error for a stream that no engine can make now, given those that were ever seen."""
    known = ', '.join(sorted(engines)) or 'none was ever seen'
    return StreamError(
        f'no stream processing engine is running ({known}); start one', ExitCode.UNAVAILABLE
    )
