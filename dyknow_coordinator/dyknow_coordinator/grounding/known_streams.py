"""What is known of the streams of a system: what they are made from, whether they are there."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache

from dyknow_common import DyKnowError
from dyknow_coordinator.grounding.grounding import FeatureSource
from dyknow_stream_processing import FreeNames, StreamDeclaration, free_names, parse_specification


@dataclass(frozen=True, slots=True)
class KnownStream:
    """A stream as the stream manager tells it.

    Args:
        specification: how it is made; empty for a topic that some other program publishes.
        topic: empty while it does not flow.
        engine: the node that makes it, or made it last.
        received: when the latest message of each topic that it is made of came, nanoseconds by
            the clock of the engine; 0 before the first.
    """

    name: str
    specification: str = ''
    topic: str = ''
    message_type: str = ''
    engine: str = ''
    received: Mapping[str, int] = field(default_factory=dict)


class KnownStreams:
    """All streams that the stream manager told of.

    Args:
        streams: those streams.
        is_published: whether anybody publishes a topic.
        absolute: the absolute name of a topic.
    """

    def __init__(
        self,
        streams: Iterable[KnownStream],
        is_published: Callable[[str], bool],
        absolute: Callable[[str], str] = lambda topic: topic,
    ) -> None:
        self._streams = {stream.name: stream for stream in streams}
        self._by_topic = {each.topic: each for each in self._streams.values() if each.topic}
        self._is_published = is_published
        self._absolute = absolute

    def get(self, name: str) -> KnownStream | None:
        """A stream by its name; None where there is none."""
        return self._streams.get(name)

    def flowing(self) -> frozenset[str]:
        """The names of the streams that flow."""
        return frozenset(stream.name for stream in self._by_topic.values())

    def silent_topics(self, name: str, limit: int) -> tuple[str, ...]:
        """The topics of a stream that are silent while others are not.

        Args:
            name: of the stream.
            limit: nanoseconds since the latest sample of any.
        """
        stream = self._streams.get(name)
        received = stream.received if stream else {}
        newest = max(received.values(), default=0)
        return tuple(topic for topic, latest in received.items() if newest - latest > limit)

    def origins(self, source: FeatureSource) -> frozenset[str]:
        """All streams and topics that a source is made from, directly or not, by name.

        Streams that are declared within others are among them.
        """
        found: set[str] = set()
        pending = [free_names_of(source)]
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

    def is_there(self, source: FeatureSource) -> bool:
        """Whether the streams and topics that a source names are there."""
        names = free_names_of(source)
        return all(map(self._has_stream, names.streams)) and all(
            map(self._is_published, names.topics)
        )

    def _has_stream(self, name: str) -> bool:
        stream = self._streams.get(name)
        if stream is None:
            return self._is_published(f'dyknow/streams/{name}')
        return bool(stream.topic) and self._is_published(stream.topic)


def suspects(
    chosen: Iterable[FeatureSource], origin: str, streams: KnownStreams
) -> tuple[FeatureSource, ...]:
    """The sources in which something went wrong, given where it did.

    Args:
        chosen: the sources in use.
        origin: the name of a stream or a topic, or the text of an unnamed part of a stream.
        streams: from which it is known what sources are made from.
    """
    names = _names_in(origin)
    return tuple(
        source for source in chosen if source.stream in names or names & streams.origins(source)
    )


def _names_in(origin: str) -> frozenset[str]:
    try:
        found = _free_names(origin)
    except DyKnowError:
        return frozenset({origin, f'/{origin}'})  # A topic.
    return found.streams | found.topics | {origin}


def free_names_of(source: FeatureSource) -> FreeNames:
    """The streams and topics that a source names."""
    return _free_names(';\n'.join([*source.units, source.declaration]))


@lru_cache(maxsize=4096)
def _free_names(specification: str) -> FreeNames:
    if not specification:
        return FreeNames(frozenset(), frozenset())
    return free_names(parse_specification(specification))


@lru_cache(maxsize=4096)
def _declared_names(specification: str) -> frozenset[str]:
    if not specification:
        return frozenset()
    declared = parse_specification(specification).declarations
    return frozenset(each.name for each in declared if isinstance(each, StreamDeclaration))
