"""The sinks of a text: their messages, and one specification for each stream that it makes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from dyknow_common import NOWHERE
from dyknow_stream_processing.language.specification import (
    Call,
    SinkDeclaration,
    SinkMessage,
    SourceDeclaration,
    Specification,
    StreamDeclaration,
    StreamReference,
    Term,
    UnitDeclaration,
    references,
    subterms,
)


def made(specification: Specification) -> Term:
    """Return the stream that a specification makes: its sink, or its only unused stream.

    Raises:
        LanguageError: if there is none, or more than one.
    """
    sinks = specification.declared(SinkDeclaration)
    if len(sinks) > 1:
        raise specification.error('a second sink; keep one', sinks[1].position)
    return sinks[0].stream if sinks else _unused(specification).stream


def _unused(specification: Specification) -> StreamDeclaration:
    streams = specification.declared(StreamDeclaration)
    used = {each.name for stream in streams for each in references(stream.stream)}
    unused = [stream for stream in streams if stream.name not in used]
    if len(unused) == 1:
        return unused[0]
    candidates = unused or streams
    if not candidates:
        raise specification.error('no stream is made; add a sink, such as: sink a', NOWHERE)
    raise specification.error(
        f'it is not clear which stream is made ({", ".join(each.name for each in candidates)}); '
        f'add a sink, such as: sink {candidates[-1].name}',
        candidates[-1].position,
    )


def sink_message(specification: Specification) -> SinkMessage | None:
    """Return the messages as which the stream of a specification is published too, if any."""
    sinks = specification.declared(SinkDeclaration)
    return sinks[0].message if sinks else None


def specifications_by_sink(specification: Specification) -> Mapping[str, Specification]:
    """Return, for the name of each sink of a text, a specification of that stream alone.

    `sink altitude` names the stream `altitude`; the sinks keep their order, and a sink may use the
    streams of earlier sinks.

    Raises:
        LanguageError: for a text without sinks, a sink that is not the name of a declared stream,
            or two of one name.
    """
    streams = {each.name: each for each in specification.declared(StreamDeclaration)}
    places = _places(specification)
    found: dict[str, Specification] = {}
    for sink in specification.declared(SinkDeclaration):
        name = sink.stream.name if isinstance(sink.stream, StreamReference) else None
        if name not in streams:
            message = "a sink needs a name here; declare 'stream a = ...' and then write: sink a"
            raise specification.error(message, sink.position)
        if name in found:
            raise specification.error(f"a second sink '{name}'; keep one", sink.position)
        # The streams of earlier sinks exist by name.
        used = {name}
        pending = [name]
        while pending:
            for reference in references(streams[pending.pop()].stream):
                if reference.name in streams and reference.name not in {*used, *found}:
                    used.add(reference.name)
                    pending.append(reference.name)
        found[name] = _part(specification, places, sink, used)
    if not found:
        position = specification.declarations[-1].position
        latest = next(reversed(streams), 'a')
        message = f'no stream is made; add a sink, such as: sink {latest}'
        raise specification.error(message, position)
    return found


def _places(specification: Specification) -> Mapping[tuple[type, str], Sequence[int]]:
    """Return the places of the declarations, except sinks, by kind and name."""
    places: defaultdict[tuple[type, str], list[int]] = defaultdict(list)
    for place, each in enumerate(specification.declarations):
        if not isinstance(each, SinkDeclaration):
            places[type(each), each.name].append(place)
    return places


def _part(
    specification: Specification,
    places: Mapping[tuple[type, str], Sequence[int]],
    sink: SinkDeclaration,
    names: set[str],
) -> Specification:
    def declared(keys: Iterable[tuple[type, str]]) -> list[Any]:
        found = sorted(place for key in keys for place in places.get(key, ()))
        return [specification.declarations[place] for place in found]

    kept = declared((StreamDeclaration, name) for name in names)
    terms = [term for each in kept for term in subterms(each.stream)]
    units = {(UnitDeclaration, term.unit) for term in terms if isinstance(term, Call)}
    sources = {
        (SourceDeclaration, term.name) for term in terms if isinstance(term, StreamReference)
    }
    others = declared({*units, *sources})
    return Specification((*others, *kept, sink), text=specification.text)
