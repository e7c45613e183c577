"""What the stream manager knows: every stream, its topic, and the engine that makes it (VI-A.2)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Final

from dyknow_common import ExitCode, StreamConstraints
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.parsing import parse_specification
from dyknow_stream_processing.language.resolution import free_names
from dyknow_stream_processing.language.specification import Specification
from dyknow_stream_processing.management.naming import NamingConvention
from dyknow_stream_processing.management.relocation import (
    aliases,
    with_absolute_topics,
    with_aliases,
    without,
)
from dyknow_stream_processing.reporting.stream_report import SAMPLE_TYPE, StreamReport, StreamState

DEFAULT_CONVENTION: Final = NamingConvention('dyknow/streams/<name>')
"""Where engines publish streams, unless they are told otherwise."""


@dataclass(frozen=True, slots=True)
class CreatedStream:
    """A stream that an engine makes.

    Args:
        specification: its text, as it was asked for or as an engine tells it.
        engine: the node that makes it, or is just asked to; none while it waits for one.
        topic: where its samples are; empty until an engine makes it.
        sources: the topics of the streams that it is made from and that others publish.
        message: why it waits or cannot be made; where, when and why it was made anew.
        lost: why its last engine makes it no more; empty where it never had another.
        failed: whether it cannot be made, for reasons that time alone does not mend.
    """

    name: str
    specification: str
    constraints: StreamConstraints
    engine: str | None = None
    topic: str = ''
    sources: Mapping[str, str] = field(default_factory=dict)
    message: str = ''
    lost: str = ''
    failed: bool = False
    message_type: str = SAMPLE_TYPE

    @property
    def waits(self) -> bool:
        """Whether no engine makes it or is asked to."""
        return self.engine is None


@dataclass(frozen=True, slots=True)
class RegisteredStream:
    """A topic of some other program that was given a stream name."""

    name: str
    topic: str
    message_type: str


Stream = CreatedStream | RegisteredStream


class StreamRegistry:
    """All streams of a system, by name.

    Args:
        convention: by which names and topics belong together where nothing else is known.
        namespace: that of the manager: relative topics in specifications are meant in it.
        published: the absolute name and the type of a topic, if anybody publishes it.
    """

    def __init__(
        self,
        convention: NamingConvention = DEFAULT_CONVENTION,
        namespace: str = '',
        published: Callable[[str], tuple[str, str] | None] = lambda _: None,
    ) -> None:
        self.version = 0
        self._convention = convention
        self._namespace = namespace.rstrip('/')
        self._published = published
        self._streams: dict[str, Stream] = {}

    def streams(self) -> tuple[Stream, ...]:
        """All streams, in the order in which they became known."""
        return tuple(self._streams.values())

    def names(self) -> tuple[str, ...]:
        """The streams that flow, sorted; those that wait for an engine are not among them."""
        return tuple(sorted(name for name, stream in self._streams.items() if stream.topic))

    def waiting(self) -> tuple[CreatedStream, ...]:
        """The streams that no engine makes, in the order in which they were asked for."""
        return tuple(each for each in self._created() if each.waits)

    def get(self, name: str) -> Stream | None:
        """A stream that was created or registered; none where there is none."""
        return self._streams.get(name)

    def find(self, name: str) -> Stream:
        """A stream that was created or registered, or that the naming convention gives a topic.

        Raises:
            StreamError: NOT_FOUND, naming the streams that there are.
        """
        if name in self._streams:
            return self._streams[name]
        found = self._published(self._convention.topic(name))
        if found is None:
            raise self._unknown(name)
        return RegisteredStream(name, *found)

    def topic(self, name: str) -> str:
        """The topic of a stream.

        Raises:
            StreamError: NOT_FOUND, or UNAVAILABLE while it is not made.
        """
        stream = self.find(name)
        if stream.topic:
            return stream.topic
        if isinstance(stream, CreatedStream) and stream.failed:
            raise StreamError(
                f"stream '{name}' cannot be made: {stream.message}", ExitCode.UNAVAILABLE
            )
        raise StreamError(
            f"stream '{name}' waits for a stream processing engine", ExitCode.UNAVAILABLE
        )

    def add(self, stream: Stream) -> None:
        """Makes a stream known.

        Raises:
            StreamError: ALREADY_EXISTS.
        """
        known = self._streams.get(stream.name)
        if known is not None:
            state = '' if known.topic else ', which is not made yet'
            raise StreamError(
                f"there is a stream '{stream.name}' already{state}; "
                f'destroy it or choose another name',
                ExitCode.ALREADY_EXISTS,
            )
        self._set(stream)

    def remove(self, name: str) -> Stream:
        """Forgets a stream.

        Raises:
            StreamError: NOT_FOUND, naming the streams that there are; INVALID_ARGUMENT, naming
                those that are made from it.
        """
        if name not in self._streams:
            raise self._unknown(name)
        users = self.made_from(name)
        if users:
            raise StreamError(
                f"stream '{name}' is used: {', '.join(users)} "
                f'{"is" if len(users) == 1 else "are"} made from it; destroy what uses it first'
            )
        return self.forget(name)

    def forget(self, name: str) -> Stream:
        """Forgets a stream that is no more, whatever is made from it."""
        self.version += 1
        return self._streams.pop(name)

    def assign(self, name: str, engine: str) -> None:
        """Notes that an engine is asked to make a stream."""
        self._change(name, engine=engine, topic='')

    def place(
        self, name: str, engine: str, topic: str, sources: Mapping[str, str], message: str = ''
    ) -> None:
        """Notes that an engine makes a stream now."""
        self._change(
            name, engine=engine, topic=topic, sources=sources, message=message, failed=False
        )

    def release(self, name: str, message: str, *, failed: bool = False) -> None:
        """Notes that no engine makes a stream that was asked for, and why."""
        self._change(name, engine=None, topic='', message=message, failed=failed)

    def withdraw(self, name: str, lost: str) -> None:
        """Notes that a stream that flowed has to be made anew, and why."""
        self._change(name, engine=None, topic='', message=lost, lost=lost)

    def lose(self, engine: str) -> None:
        """Notes that an engine is gone: its streams wait for another.

        Those that it was just asked for are left to whoever asked.
        """
        for stream in self.made_by(engine):
            if stream.topic:
                self.withdraw(stream.name, f'{engine} is gone')

    def recognise(self) -> None:
        """Notes which topics in what engines told stand for streams, before those move."""
        for stream in self._created():
            found = self._aliases(stream)
            if found:
                text = str(self._original(stream))
                sources = {**found, **stream.sources}
                self._change(stream.name, specification=text, sources=sources)

    def made_by(self, engine: str) -> tuple[CreatedStream, ...]:
        """The streams of an engine, and those that it is asked for."""
        return tuple(each for each in self._created() if each.engine == engine)

    def made_from(self, name: str) -> tuple[str, ...]:
        """The names of the streams that are made from a stream, sorted."""
        users = [each.name for each in self._created() if name in self._sources_by_name(each)]
        return tuple(sorted(users))

    def outdated(self) -> tuple[CreatedStream, ...]:
        """The streams that read from where what they are made from is no more.

        What an engine makes from one of its own streams goes on with that as it was, so it is
        outdated with it.
        """
        made = [each for each in self._created() if each.topic]
        found = {each.name: each for each in made if self._reads_elsewhere(each)}
        new = list(found.values())
        while new:
            new = [
                each
                for each in made
                if each.name not in found and any(self._is_local(each, one) for one in new)
            ]
            found.update((each.name, each) for each in new)
        return tuple(found.values())

    def least_loaded(self, engines: Iterable[str]) -> str | None:
        """The engine with the fewest streams; none where there is no engine."""
        return min(engines, key=lambda engine: (len(self.made_by(engine)), engine), default=None)

    def text_for(self, stream: CreatedStream, engine: str) -> tuple[str, Mapping[str, str]]:
        """A specification as an engine can make it, and the topics of other streams in it.

        Names that the engine does not know become topics.

        Raises:
            LanguageError: when the text is no specification.
            StreamError: NOT_FOUND or UNAVAILABLE, for a stream that it is made of.
        """
        parsed = self._original(stream)
        sources: dict[str, str] = {}
        for name in sorted(free_names(parsed).streams):
            if name == stream.name:
                raise StreamError(f"stream '{name}' is made from itself")
            known = self.find(name)
            if not (known.topic and isinstance(known, CreatedStream) and known.engine == engine):
                sources[name] = self.topic(name)
        if namespace_of(engine) != self._namespace:
            parsed = with_absolute_topics(parsed, self._namespace)
        return str(with_aliases(parsed, sources)), sources

    def is_copy(self, told: CreatedStream) -> bool:
        """Whether what an engine tells of a stream is just what is known of it."""
        known = self._streams.get(told.name)
        if not isinstance(known, CreatedStream) or known.constraints != told.constraints:
            return False
        plain = without(_parsed(told.specification), self._told_sources(known, told))
        return self._meaning(plain) == self._meaning(self._original(known))

    def take_over(self, told: CreatedStream) -> None:
        """Notes that an engine makes a stream already that waits."""
        known = self._streams[told.name]
        if isinstance(known, CreatedStream) and told.engine is not None:
            self.place(told.name, told.engine, told.topic, self._told_sources(known, told))

    def told(
        self,
        engine: str,
        name: str,
        specification: str,
        constraints: StreamConstraints,
        topic: str,
    ) -> CreatedStream:
        """A stream as its engine tells it; its relative topics are meant where the engine is."""
        if namespace_of(engine) != self._namespace:
            parsed = with_absolute_topics(_parsed(specification), namespace_of(engine))
            specification = str(parsed)
        return CreatedStream(name, specification, constraints, engine, topic)

    def _created(self) -> Iterable[CreatedStream]:
        return [each for each in self._streams.values() if isinstance(each, CreatedStream)]

    def _set(self, stream: Stream) -> None:
        self.version += 1
        self._streams[stream.name] = stream

    def _change(self, name: str, **values: object) -> None:
        stream = self._streams.get(name)
        if isinstance(stream, CreatedStream):
            self._set(replace(stream, **values))  # type: ignore[arg-type]

    def _unknown(self, name: str) -> StreamError:
        known = ', '.join(self.names()) or 'none'
        return StreamError(f"there is no stream '{name}' (there are: {known})", ExitCode.NOT_FOUND)

    def _aliases(self, stream: CreatedStream) -> Mapping[str, str]:
        """Those topics in a text that stand for streams: `text_for` put them there."""
        found = aliases(_parsed(stream.specification))
        return {
            name: topic
            for name, topic in found.items()
            if name != stream.name and self._belongs(name, topic)
        }

    def _belongs(self, name: str, topic: str) -> bool:
        known = self._streams.get(name)
        return known is not None and (
            known.topic == topic
            or (isinstance(known, CreatedStream) and self._convention.holds(name, topic))
        )

    def _original(self, stream: CreatedStream) -> Specification:
        """A specification with the streams that it is made from as names."""
        return without(_parsed(stream.specification), self._aliases(stream))

    def _meaning(self, specification: Specification) -> str:
        """What tells streams apart: the text that all engines understand alike."""
        return str(with_absolute_topics(specification, self._namespace))

    def _told_sources(self, known: CreatedStream, told: CreatedStream) -> Mapping[str, str]:
        """The topics that an engine was told for the streams that one is made from."""
        names = self._sources_by_name(known)
        found = aliases(_parsed(told.specification))
        return {name: topic for name, topic in found.items() if name in names}

    def _sources_by_name(self, stream: CreatedStream) -> frozenset[str]:
        return free_names(self._original(stream)).streams

    def _reads_elsewhere(self, stream: CreatedStream) -> bool:
        for name, topic in stream.sources.items():
            source = self._streams.get(name)
            if source is not None and source.topic not in ('', topic):
                return True
        return False

    def _is_local(self, stream: CreatedStream, source: CreatedStream) -> bool:
        """Whether an engine makes a stream from another one without its topic."""
        return (
            stream.engine == source.engine
            and source.name not in stream.sources
            and source.name in self._sources_by_name(stream)
        )

    def account(self, stream: Stream, reported: StreamReport | None) -> StreamReport:
        """What is known of a stream, with what its engine reported of it."""
        if isinstance(stream, RegisteredStream):
            return StreamReport(
                stream.name,
                StreamState.REGISTERED,
                topic=stream.topic,
                message_type=stream.message_type,
            )
        state = StreamState.FLOWING if stream.topic else StreamState.WAITING
        return replace(
            reported or StreamReport(stream.name, state),
            state=StreamState.FAILED if stream.failed else state,
            message=stream.message,
            engine=stream.engine or '',
            topic=stream.topic,
            specification=_canonical(stream.specification),
            constraints=stream.constraints,
        )


def namespace_of(node: str) -> str:
    """`/robot1/stream_processing_engine` -> `/robot1`; the root is empty."""
    return node.rpartition('/')[0]


def engines_missing(engines: Iterable[str]) -> StreamError:
    """The error for a stream that no engine can make now, given those that were ever seen."""
    known = ', '.join(sorted(engines)) or 'none was ever seen'
    return StreamError(
        f'no stream processing engine is running ({known}); start one', ExitCode.UNAVAILABLE
    )


@lru_cache(maxsize=4096)
def _parsed(specification: str) -> Specification:
    return parse_specification(specification)


@lru_cache(maxsize=4096)
def _canonical(specification: str) -> str:
    return str(_parsed(specification))
