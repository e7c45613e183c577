"""Known streams: their sources, whether these are available, and the fields of samples."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain

from dyknow_common import (
    NO_CONSTRAINTS,
    DyKnowError,
    ExitCode,
    StreamConstraints,
    cached_by_text,
)
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.feature_sources import FeatureSource
from dyknow_stream_processing import (
    TF_STATIC,
    BuiltInSource,
    Call,
    FreeNames,
    Select,
    SinkDeclaration,
    SourceDeclaration,
    StreamDeclaration,
    StreamReference,
    Sync,
    Term,
    UnitDeclaration,
    built_in_fields,
    free_names,
    made,
    parse_specification,
    subterms,
)


@dataclass(frozen=True, slots=True)
class KnownStream:
    """A stream, as the stream manager reports it.

    Args:
        specification: empty for a topic that another program publishes.
        topic: empty while the stream is not published.
        stream_id: as in its samples; 0 if it is no stream of an engine, or is being replaced.
        engine: the node that makes the stream, or made it last.
        received: for each topic that the stream is made from, the time at which the engine
            received the latest message, in nanoseconds; 0 before the first.
        constraints: added to the constraints in the specification.
        waits_for: why it has no samples; empty if they come.
        samples: their number since the stream was created.
        max_delay: the longest delay of the latest ones from valid to available time, in ns.
    """

    name: str
    specification: str = ''
    topic: str = ''
    stream_id: int = 0
    message_type: str = ''
    engine: str = ''
    received: Mapping[str, int] = field(default_factory=dict)
    constraints: StreamConstraints = NO_CONSTRAINTS
    waits_for: str = ''
    samples: int = 0
    max_delay: int = 0


class KnownStreams:
    """All streams that the stream manager reports.

    Args:
        is_published: returns True if a topic has a publisher.
        absolute: returns the absolute name of a topic.
        has_begun: returns False if a topic is known to have had no message; by default, if no
            stream that is made from it has received one.
    """

    def __init__(
        self,
        streams: Iterable[KnownStream],
        is_published: Callable[[str], bool],
        absolute: Callable[[str], str] = lambda topic: topic,
        has_begun: Callable[[str], bool] | None = None,
    ) -> None:
        self._streams = {stream.name: stream for stream in streams}
        self._by_topic = {each.topic: each for each in self._streams.values() if each.topic}
        self._is_published = is_published
        self._absolute = absolute
        self._has_begun = has_begun or self._is_received
        self._known_origins: dict[FreeNames, frozenset[str]] = {}

    @staticmethod
    def parse(source: FeatureSource) -> None:
        """Parse the specification of a source: other methods use the result, which is cached."""
        _source_names(source)

    def get(self, name: str) -> KnownStream | None:
        """Return a stream by its name; None if there is none."""
        return self._streams.get(name)

    def published(self) -> frozenset[str]:
        """Return the names of the streams that are published."""
        return frozenset(stream.name for stream in self._by_topic.values())

    def origins(self, source: FeatureSource) -> frozenset[str]:
        """Return the names of all streams and topics that a source is made from, transitively.

        Streams that are declared within others are included.
        """
        return self._origins(_source_names(source))

    def topics(self, sources: Iterable[FeatureSource]) -> tuple[str, ...]:
        """Return the topics that sources are made from, but not topics of streams in between."""
        named = set(map(_source_names, sources))
        found = {
            name
            for names in named
            for name in self._origins(names)
            if name.startswith('/') and not self._is_made(name)
        }
        # Transforms are read from both topics of tf2.
        return tuple(sorted(found | {TF_STATIC} if '/tf' in found else found))

    def _is_made(self, topic: str) -> bool:
        stream = self._by_topic.get(topic)
        return stream is not None and bool(stream.specification)

    def is_overdue(self, source: FeatureSource, silences: Mapping[str, int]) -> bool:
        """Return True if a stream that a source is made from should have had a sample by now.

        This is a stream with a `sample_period` or a `max_gap` if all topics that it is made from
        have been silent for longer than this time.

        Args:
            source: the source.
            silences: for each topic that has had a message, the time for which it has been
                silent, or that time less a tolerance; nanoseconds.
        """
        origins = [self._streams[name] for name in self.origins(source) & self._streams.keys()]
        periods = chain(
            _periods(_source_text(source), NO_CONSTRAINTS),
            *(_periods(each.specification, each.constraints) for each in origins),
        )
        for longest, names in periods:
            topics = self._origins(names) & silences.keys()
            if topics and all(silences[topic] > longest for topic in topics):
                return True
        return False

    def _origins(self, names: FreeNames) -> frozenset[str]:
        if names not in self._known_origins:
            self._known_origins[names] = self._find_origins(names)
        return self._known_origins[names]

    def _find_origins(self, names: FreeNames) -> frozenset[str]:
        found: set[str] = set()
        pending = [names]
        while pending:
            names = pending.pop()
            for name in (names.streams | names.topics) - found:
                found.add(name)
                stream = self._streams.get(name)
                if name in names.topics:
                    found.add(self._absolute(name))
                    stream = self._by_topic.get(self._absolute(name))
                if stream is not None:
                    found |= {stream.name, stream.topic, *_declared_names(stream.specification)}
                    pending.append(_free_names(stream.specification))
        return frozenset(found - {''})

    def is_available(self, source: FeatureSource) -> bool:
        """Return True if all streams that a source names, and its topics, are published.

        A stream whose topics nobody publishes may be published all the same, without samples.
        """
        are_published = all(map(self._is_stream_published, _source_names(source).streams))
        return are_published and self._hold(source, self._is_published)

    def is_flowing(self, source: FeatureSource) -> bool:
        """Return True unless a stream that a source is made from is known to have no samples."""
        is_waiting = any(stream.waits_for for stream in self._named(source))
        return not is_waiting and self._hold(source, self._has_begun)

    def are_received(self, stream: str, source: FeatureSource, since: int) -> bool:
        """Return True if a stream has received messages of all topics of one of its sources.

        Args:
            stream: its name.
            source: the source.
            since: the time after which messages count, in nanoseconds.
        """
        made = self._streams.get(stream)
        if made is None:
            return False
        return self._hold(source, lambda topic: made.received.get(topic, 0) > since)

    def _hold(self, source: FeatureSource, condition: Callable[[str], bool]) -> bool:
        """Return True if a condition holds for all topics of a source; one of tf2 is enough."""
        topics = {*self.topics([source])}
        transforms = topics & {'/tf', TF_STATIC}
        others_hold = all(map(condition, topics - transforms))
        return others_hold and (not transforms or any(map(condition, transforms)))

    def _is_received(self, topic: str) -> bool:
        return topic not in self._unheard

    @cached_property
    def _unheard(self) -> frozenset[str]:
        """The topics that streams are made from, but that none has received a message of."""
        latest: dict[str, int] = {}
        for stream in self._streams.values():
            for topic, time in stream.received.items():
                latest[topic] = max(time, latest.get(topic, 0))
        return frozenset(topic for topic, time in latest.items() if not time)

    def identities(self, sources: Iterable[FeatureSource]) -> Mapping[str, int]:
        """Return the ids of the streams of engines that sources name, by their topics.

        Raises:
            CoordinationError: UNAVAILABLE, naming a stream that is being replaced.
        """
        found: dict[str, int] = {}
        for source in sources:
            for stream in self._named(source):
                if not (stream.specification and stream.topic):
                    continue
                if not stream.stream_id:
                    text = f"stream '{stream.name}' is being made or replaced"
                    raise CoordinationError(text, ExitCode.UNAVAILABLE)
                found[stream.topic] = stream.stream_id
        return found

    def affected(self, sources: Iterable[FeatureSource], origin: str) -> tuple[FeatureSource, ...]:
        """Return the sources that are affected by a fault.

        Args:
            sources: the sources in use.
            origin: the stream or topic at fault: a name, or the text of an unnamed stream.
        """
        names = _names_in(origin)
        return tuple(
            source for source in sources if source.stream in names or names & self.origins(source)
        )

    def _named(self, source: FeatureSource) -> Iterator[KnownStream]:
        """Yield the known streams that a source names."""
        names = _source_names(source)
        named = map(self._streams.get, names.streams)
        topics = map(self._absolute, names.topics)
        yield from filter(None, chain(named, map(self._by_topic.get, topics)))

    def _is_stream_published(self, name: str) -> bool:
        stream = self._streams.get(name)
        if stream is None:
            return self._is_published(stream_topic(name))
        return bool(stream.topic) and self._is_published(stream.topic)


def stream_topic(name: str) -> str:
    """Return the topic of a stream, relative to the namespace of its engine."""
    return f'dyknow/streams/{name}'


def _source_names(source: FeatureSource) -> FreeNames:
    """Return the streams and topics that a source names."""
    if source.select is not None:
        return _names_of(source.select, {})
    return _free_names(_source_text(source))


def _source_text(source: FeatureSource) -> str:
    return ';\n'.join([*source.units, source.declaration])


def _names_in(origin: str) -> frozenset[str]:
    try:
        found = _free_names(origin)
    except DyKnowError:
        return frozenset({origin, f'/{origin}'})  # A topic.
    return found.streams | found.topics | {origin}


@cached_by_text
def _free_names(specification: str) -> FreeNames:
    if not specification:
        return FreeNames(frozenset(), frozenset())
    return free_names(parse_specification(specification))


@cached_by_text
def _declared_names(specification: str) -> frozenset[str]:
    declared = parse_specification(specification).declarations if specification else ()
    return frozenset(each.name for each in declared if isinstance(each, StreamDeclaration))


@cached_by_text
def _periods(specification: str, added: StreamConstraints) -> tuple[tuple[int, FreeNames], ...]:
    """Return the longest distance of the samples of each stream that bounds it, and its origins.

    A `sync` with a period is left out: its ticks go on while an input is silent.
    """
    if not specification:
        return ()
    parsed = parse_specification(specification)
    declared = {each.name: each.stream for each in parsed.declared(StreamDeclaration)}
    stated = [*declared.values(), *(each.stream for each in parsed.declared(SinkDeclaration))]
    terms = [(each.constraints, each) for term in stated for each in subterms(term)]
    terms.append((added, made(parsed)))
    return tuple(
        (constraints.longest_distance, _names_of(term, declared))
        for constraints, term in terms
        if constraints.longest_distance is not None and not _is_periodic_sync(term, constraints)
    )


def _is_periodic_sync(term: Term, added: StreamConstraints) -> bool:
    period = term.constraints.sample_period or added.sample_period
    return isinstance(term, Sync) and period is not None


def _names_of(term: Term, declared: Mapping[str, Term]) -> FreeNames:
    """Return the streams and topics that a term names, also by way of declared streams."""
    found = list(_references(term, declared))
    return FreeNames(
        frozenset(each.name for each in found if not each.is_topic),
        frozenset(each.name for each in found if each.is_topic),
    )


def _references(term: Term, declared: Mapping[str, Term]) -> Iterator[StreamReference]:
    for each in subterms(term):
        if isinstance(each, StreamReference):
            if each.is_topic or each.name not in declared:
                yield each
            else:
                yield from _references(declared[each.name], declared)


def field_names(
    specification: str,
    stream_fields: Callable[[str], Iterable[str]],
    topic_fields: Callable[[str], Iterable[str]],
) -> tuple[str, ...]:
    """Return the fields of the stream that a specification makes.

    Fields that are named by the samples themselves (`A%b%`) are unknown, and left out. The
    functions return the fields of a stream that is not declared, and of a topic.
    """
    parsed = parse_specification(specification)
    named = StreamDeclaration | SourceDeclaration | UnitDeclaration
    declared = {each.name: each for each in parsed.declarations if isinstance(each, named)}

    def fields_of(term: Term) -> Iterable[str]:
        match term:
            case StreamReference():
                return fields_of_reference(term)
            case BuiltInSource():
                return built_in_fields(term)
            case Select():
                return [each.name for each in term.selections if not each.embedded_fields]
            case Call():
                unit = declared.get(term.unit)
                outputs = unit.outputs if isinstance(unit, UnitDeclaration) else ()
                return [each.name for each in outputs]
            case _:
                return [name for each in term.inputs for name in fields_of(each)]

    def fields_of_reference(reference: StreamReference) -> Iterable[str]:
        declaration = declared.get(reference.name)
        if isinstance(declaration, SourceDeclaration):
            return [field.name for field in declaration.fields]
        if reference.is_topic:
            return topic_fields(reference.name)
        if isinstance(declaration, StreamDeclaration):
            return fields_of(declaration.stream)
        return stream_fields(reference.name)

    return tuple(dict.fromkeys(fields_of(made(parsed))))
