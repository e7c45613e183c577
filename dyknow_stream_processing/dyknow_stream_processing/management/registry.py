"""Registry of all streams: their topics and the engines that make them (paper, VI-A.2).

A specification in the registry refers to other streams by name. An engine knows only the names of
its own streams. `text_for` therefore adds an alias for each other stream, `stream a = "/topic";`,
and texts reported by engines are read with these aliases removed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Final

from dyknow_common import ExitCode
from dyknow_stream_processing.errors import StreamError, unknown_stream
from dyknow_stream_processing.language.built_in_sources import TF_STATIC
from dyknow_stream_processing.language.parsing import parse_specification
from dyknow_stream_processing.language.resolution import free_names
from dyknow_stream_processing.language.specification import SourceDeclaration, Specification
from dyknow_stream_processing.management.naming import Namespaces, NamingConvention, namespace_of
from dyknow_stream_processing.management.relocation import (
    aliases,
    in_namespace,
    with_absolute_topics,
    with_aliases,
    without,
)
from dyknow_stream_processing.management.streams import (
    CreatedStream,
    RegisteredStream,
    Stream,
    canonical,
)
from dyknow_stream_processing.reporting.stream_report import StreamReport, StreamState, is_hidden

DEFAULT_CONVENTION: Final = NamingConvention('dyknow/streams/<name>')
"""The topics on which engines publish streams by default."""


class StreamRegistry:
    """All streams of a system, by name.

    Args:
        convention: relates names to topics of streams that are not in the registry.
        namespace: the namespace of the manager, for relative topics in specifications.
        published: returns the absolute name and the type of a topic if it has publishers.
        engine_namespaces: the namespaces in which the streams of the system can be.
    """

    def __init__(
        self,
        convention: NamingConvention = DEFAULT_CONVENTION,
        namespace: str = '',
        published: Callable[[str], tuple[str, str] | None] = lambda _: None,
        engine_namespaces: Namespaces | None = None,
    ) -> None:
        self.version = 0
        self._convention = convention
        self._namespace = namespace.rstrip('/')
        self._published = published
        self.engine_namespaces = engine_namespaces or Namespaces.of((), namespace)
        self._streams: dict[str, Stream] = {}

    def streams(self) -> tuple[Stream, ...]:
        """Return all streams, in the order in which they were added."""
        return tuple(self._streams.values())

    def specifications(self) -> tuple[str, ...]:
        """Return the specification of each stream; empty for a registered one."""
        return tuple(getattr(each, 'specification', '') for each in self._streams.values())

    def names(self) -> tuple[str, ...]:
        """Return the names of the streams that have a topic, sorted."""
        return tuple(sorted(name for name, stream in self._streams.items() if stream.topic))

    def listed_names(self, topics: Iterable[str]) -> tuple[str, ...]:
        """Return `names` and the names that the convention gives to existing topics, sorted."""
        found = set(self.names())
        for topic in topics:
            name = self._convention.name(topic)
            if name is not None and name not in self._streams:
                published = self._published(self._convention.topic(name))
                # A topic in another namespace may have the same end.
                if published is not None and published[0] == topic:
                    found.add(name)
        return tuple(sorted(found))

    def is_stream_topic(self, topic: str) -> bool:
        """Return True if an absolute topic is one of a stream of this system, by the convention."""
        return self.engine_namespaces.contain(topic) and self._convention.name(topic) is not None

    def waiting(self) -> tuple[CreatedStream, ...]:
        """Return the streams that wait for an engine, in the order of the requests."""
        return tuple(each for each in self._created() if each.waits)

    def recreated(self) -> dict[str, str]:
        """Return where, when and why streams were recreated, by stream name."""
        return {each.name: each.message for each in self._created() if each.topic and each.message}

    def get(self, name: str) -> Stream | None:
        """Return a stream that was created or registered; `None` if there is none."""
        return self._streams.get(name)

    def find(self, name: str) -> Stream:
        """Return a stream that was created or registered, or whose topic the convention gives.

        Raises:
            StreamError: NOT_FOUND, naming the existing streams.
        """
        if name in self._streams:
            return self._streams[name]
        found = self._published(self._convention.topic(name))
        if found is None:
            topic, _ = self._published(name) or ('', '')
            shown = (each for each in self.names() if not is_hidden(each))
            raise unknown_stream(name, shown, topic)
        return RegisteredStream(name, *found)

    def topic(self, name: str) -> str:
        """Return the topic of a stream.

        Raises:
            StreamError: NOT_FOUND, or UNAVAILABLE while no engine makes it.
        """
        stream = self.find(name)
        if stream.topic:
            return stream.topic
        reason = 'waits for a stream processing engine'
        if isinstance(stream, CreatedStream) and stream.failed:
            reason = f'cannot be made: {stream.message}'
        raise StreamError(f"stream '{name}' {reason}", ExitCode.UNAVAILABLE)

    def add(self, stream: Stream) -> None:
        """Add a stream.

        Raises:
            StreamError: ALREADY_EXISTS.
        """
        known = self._streams.get(stream.name)
        if known is not None:
            state = '' if known.topic else ', which is not made yet'
            made = known.definition if isinstance(known, CreatedStream) else f'topic {known.topic}'
            raise StreamError(
                f"there is a stream '{stream.name}' already{state}; "
                f'destroy it or choose another name; it is {made}',
                ExitCode.ALREADY_EXISTS,
            )
        self._set(stream)

    def remove(self, name: str) -> Stream:
        """Remove a stream that no other stream is made from, and return it.

        Raises:
            StreamError: NOT_FOUND, naming the existing streams; INVALID_ARGUMENT, naming the
                streams that are made from it.
        """
        if name not in self._streams:
            raise unknown_stream(name, self.names())
        users = self.made_from(name)
        if users:
            raise StreamError(
                f"stream '{name}' is used: {', '.join(users)} "
                f'{"is" if len(users) == 1 else "are"} made from it; destroy what uses it first'
            )
        return self.forget(name)

    def forget(self, name: str) -> Stream:
        """Remove a stream that no longer exists, even if others are made from it."""
        self.version += 1
        return self._streams.pop(name)

    def assign(self, name: str, engine: str) -> None:
        """Record that an engine is asked to make a stream."""
        self._change(name, engine=engine, topic='')

    def place(
        self,
        name: str,
        engine: str,
        topic: str,
        sources: Mapping[str, str],
        message: str = '',
        stream_id: int = 0,
    ) -> None:
        """Record that an engine makes a stream."""
        self._change(
            name,
            engine=engine,
            topic=topic,
            stream_id=stream_id,
            sources=sources,
            message=message,
            failed=False,
        )

    def release(self, name: str, message: str, *, failed: bool = False) -> None:
        """Record that no engine makes a requested stream, and why."""
        self._change(name, engine=None, topic='', message=message, failed=failed)

    def withdraw(self, name: str, lost: str, *, failed: bool = False) -> None:
        """Record that a stream must be recreated, and why."""
        self._change(name, engine=None, topic='', message=lost, lost=lost, failed=failed)

    def withdraw_all(self, engine: str) -> None:
        """Record that an engine is gone: its streams must be recreated.

        A stream that it was only asked for stays assigned: the caller handles the failed request.
        """
        for stream in self.made_by(engine):
            if stream.topic:
                self.withdraw(stream.name, f'{engine} is gone')

    def restore_names(self) -> None:
        """Replace aliases in reported texts by names of streams, before their topics change."""
        for stream in self._created():
            found = self._aliases(stream)
            if found:
                text = str(self._original(stream))
                sources = {**found, **stream.sources}
                self._change(stream.name, specification=text, sources=sources)

    def made_by(self, engine: str) -> tuple[CreatedStream, ...]:
        """Return the streams that an engine makes or is asked to make."""
        return tuple(each for each in self._created() if each.engine == engine)

    def made_from(self, name: str) -> tuple[str, ...]:
        """Return the names of the streams that are made from a stream, sorted."""
        return tuple(sorted(each.name for each in self._created() if name in self._inputs(each)))

    def outdated(self) -> tuple[CreatedStream, ...]:
        """Return the streams that read from a topic that is no longer the topic of their input.

        While an input merely waits for an engine, they stay: it may return on the same topic. If an
        input has failed, another stream may be on its topic.

        If an engine makes a stream from another of its own streams, it does so without a topic. The
        stream is then outdated whenever the other one is.
        """
        made = [each for each in self._created() if each.topic]
        topics = {each.name: each.topic for each in self._streams.values() if each.topic}
        failed = [each for each in self._created() if each.failed]
        topics.update((each.name, '') for each in failed)
        found = [
            each
            for each in made
            if any(topics.get(name, topic) != topic for name, topic in each.sources.items())
        ]
        for source in found:  # The list grows in the loop.
            found += [
                each
                for each in made
                if each not in found
                and each.engine == source.engine
                and source.name not in each.sources
                and source.name in self._inputs(each)
            ]
        return tuple(found)

    def least_loaded(self, engines: Iterable[str]) -> str | None:
        """Return the engine with the fewest streams; `None` if there is no engine."""
        return min(engines, key=lambda engine: (len(self.made_by(engine)), engine), default=None)

    def keepers(self, stream: CreatedStream, is_kept: Callable[[str], bool]) -> frozenset[str]:
        """Return the engines on which a stream begins with the last value of a silent topic.

        They make streams that it is made from, of topics whose publishers keep their messages. An
        engine does not keep samples for others, and may never publish the next one.

        Args:
            stream: the stream.
            is_kept: returns True if the publishers of a topic keep messages for late subscribers.
        """
        inputs = (self._streams.get(name) for name in self._inputs(stream))
        made = [each for each in inputs if isinstance(each, CreatedStream)]
        found = [each.engine for each in made if any(map(is_kept, self._topics(each)))]
        return frozenset(filter(None, found))

    def text_for(self, stream: CreatedStream, engine: str) -> tuple[str, Mapping[str, str]]:
        """Return a specification with aliases for an engine, and the topics of the aliases.

        Raises:
            LanguageError: if the text is not a specification.
            StreamError: NOT_FOUND or UNAVAILABLE, for a stream that it is made from.
        """
        text = self._original(stream)
        sources: dict[str, str] = {}
        for name in sorted(free_names(text).streams):
            if name == stream.name:
                raise StreamError(f"stream '{name}' is made from itself")
            known = self.find(name)
            if not (known.topic and isinstance(known, CreatedStream) and known.engine == engine):
                sources[name] = self.topic(name)
        if namespace_of(engine) != self._namespace:
            text = with_absolute_topics(text, self._namespace)
        return str(with_aliases(text, sources)), sources

    def reported_stream(self, engine: str, report: StreamReport) -> CreatedStream:
        """Return a stream as its engine reports it, in whose namespace its relative topics are."""
        text = in_namespace(report.specification, namespace_of(engine), self._namespace)
        name, constraints, topic = report.name, report.constraints, report.topic
        return CreatedStream(name, text, constraints, engine, topic, reported=True)

    def is_copy(self, reported: CreatedStream) -> bool:
        """Return true if a reported stream is equivalent to the known stream of its name."""
        known = self._streams.get(reported.name)
        if not isinstance(known, CreatedStream) or known.constraints != reported.constraints:
            return False
        plain = without(parse_specification(reported.specification), self._sources(known, reported))
        one, other = (
            str(with_absolute_topics(each, self._namespace))
            for each in (plain, self._original(known))
        )
        return one == other

    def adopt(self, reported: CreatedStream) -> None:
        """Record that an engine already makes a stream that waits."""
        known = self._streams[reported.name]
        if isinstance(known, CreatedStream) and reported.engine is not None:
            sources = self._sources(known, reported)
            self.place(reported.name, reported.engine, reported.topic, sources)

    def report(self, stream: Stream, reported: StreamReport | None) -> StreamReport:
        """Return the report of a stream, from the registry and from the report of its engine."""
        if isinstance(stream, RegisteredStream):
            return StreamReport(
                stream.name,
                StreamState.REGISTERED,
                topic=stream.topic,
                message_type=stream.message_type,
            )
        unreported = StreamReport(
            stream.name, StreamState.WAITING, 'its engine has yet to report it'
        )
        found = reported or unreported
        state, message = found.state, '; '.join(filter(None, (found.message, stream.message)))
        if not stream.topic:
            state, message = StreamState.WAITING, stream.message
        return replace(
            found,
            state=StreamState.FAILED if stream.failed else state,
            message=message,
            engine=stream.engine or '',
            topic=stream.topic,
            specification=canonical(stream.specification),
            constraints=stream.constraints,
        )

    def _created(self) -> list[CreatedStream]:
        return [each for each in self._streams.values() if isinstance(each, CreatedStream)]

    def _set(self, stream: Stream) -> None:
        self.version += 1
        self._streams[stream.name] = stream

    def _change(self, name: str, **values: object) -> None:
        stream = self._streams.get(name)
        if isinstance(stream, CreatedStream):
            self._set(replace(stream, **values))  # type: ignore[arg-type]

    def _aliases(self, stream: CreatedStream) -> Mapping[str, str]:
        """Return the aliases in a text that stand for known streams, as `text_for` adds them."""
        found = {}
        for name, topic in aliases(parse_specification(stream.specification)).items():
            known = self._streams.get(name)
            if known is not None and name != stream.name:
                former = stream.reported and self._may_be_topic_of(known, topic)
                if known.topic == topic or former:
                    found[name] = topic
        return found

    def _may_be_topic_of(self, stream: Stream, topic: str) -> bool:
        """Return True if an engine of this system can have made a stream on a topic."""
        return (
            isinstance(stream, CreatedStream)
            and self.engine_namespaces.contain(topic)
            and self._convention.matches(stream.name, topic)
        )

    def _original(self, stream: CreatedStream) -> Specification:
        """Return a specification that refers to other streams by name instead of by alias."""
        return without(parse_specification(stream.specification), self._aliases(stream))

    def _inputs(self, stream: CreatedStream) -> frozenset[str]:
        return free_names(self._original(stream)).streams

    def _topics(self, stream: CreatedStream) -> frozenset[str]:
        """Return the topics that a stream is made of, also through other streams."""
        topics: set[str] = set()
        names = [stream.name]
        for name in names:  # The list grows in the loop.
            known = self._streams.get(name)
            if isinstance(known, CreatedStream):
                text = self._original(known)
                free = free_names(text)
                topics |= free.topics | {each.name for each in text.declared(SourceDeclaration)}
                names += free.streams - {*names}
            elif known is not None:
                topics.add(known.topic)
        return frozenset(topics | ({TF_STATIC} if '/tf' in topics else set()))

    def _sources(self, known: CreatedStream, reported: CreatedStream) -> Mapping[str, str]:
        """Return the topics from which an engine reads the streams that a stream is made from."""
        names = self._inputs(known)
        found = aliases(parse_specification(reported.specification))
        return {
            name: topic
            for name, topic in found.items()
            if name in names and self._may_be_source(name, topic)
        }

    def _may_be_source(self, name: str, topic: str) -> bool:
        """Return True if a stream can be or have been on a topic."""
        known = self._streams.get(name)
        return (
            isinstance(known, RegisteredStream)
            or (known is not None and known.topic == topic)
            or self.engine_namespaces.contain(topic)
        )


def engines_missing(engines: Iterable[str], namespaces: Namespaces) -> StreamError:
    """Return the error if no engine is running.

    Args:
        engines: all engines that were ever found.
        namespaces: the namespaces in which engines are searched.
    """
    known = ', '.join(sorted(engines)) or 'none was ever seen'
    return StreamError(
        f'no stream processing engine is running in {namespaces} ({known}); start one there, or '
        f'name its namespace in the parameter engine_namespaces of the stream manager',
        ExitCode.UNAVAILABLE,
    )


def name_taken(stream: CreatedStream, others: Iterable[CreatedStream]) -> StreamError:
    """Return the error if engines already make streams of the name of a requested stream."""
    found = '; '.join(f'{other.engine} makes {other.definition}' for other in others)
    return StreamError(
        f"there is another stream '{stream.name}': {found}; requested is {stream.definition}; "
        f'destroy the other by stream_destroy of its engine, or choose another name',
        ExitCode.ALREADY_EXISTS,
    )


def two_streams(used: Stream, other: CreatedStream) -> StreamError:
    """Return the error if an engine makes another stream of the name of one in use."""
    if isinstance(used, CreatedStream):
        description = f'that of {used.engine}, {used.definition},'
    else:
        description = f'the registered topic {used.topic}'
    return StreamError(
        f"there are two streams '{used.name}': {description} is used, that of {other.engine}, "
        f'{other.definition}, is not; destroy it by {other.engine}/stream_destroy',
        ExitCode.ALREADY_EXISTS,
    )
