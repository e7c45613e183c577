"""A text with many sinks, taken apart into one specification for each stream that it makes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from dyknow_stream_processing.language.specification import (
    Call,
    Declaration,
    SinkDeclaration,
    SourceDeclaration,
    Specification,
    StreamDeclaration,
    StreamReference,
    Term,
    UnitDeclaration,
    references,
)


def specifications_by_sink(specification: Specification) -> Mapping[str, Specification]:
    """For each sink of a text, by its name, a specification of that stream alone.

    `sink altitude` names the stream `altitude`; the sinks keep their order, and a sink may use the
    streams of those before it.

    Raises:
        LanguageError: for a text without sinks, a sink that is not the name of a declared stream,
            or two of one name.
    """
    streams = {
        each.name: each
        for each in specification.declarations
        if isinstance(each, StreamDeclaration)
    }
    found: dict[str, Specification] = {}
    for sink in specification.declarations:
        if not isinstance(sink, SinkDeclaration):
            continue
        name = sink.stream.name if isinstance(sink.stream, StreamReference) else None
        if name not in streams:
            message = "a sink needs a name here; declare 'stream a = ...' and then write: sink a"
            raise specification.error(message, sink.place)
        if name in found:
            raise specification.error(f"a second sink '{name}'; keep one", sink.place)
        wanted = _used(name, streams, frozenset(found)) | {name}
        found[name] = _part(specification, sink, wanted)
    if not found:
        place = specification.declarations[-1].place
        raise specification.error('no stream is made; add a sink, such as: sink a', place)
    return found


def _used(
    name: str, streams: Mapping[str, StreamDeclaration], made: frozenset[str]
) -> frozenset[str]:
    """The streams that a stream is made of; those that are sinks already exist by name."""
    used: frozenset[str] = frozenset()
    pending = [name]
    while pending:
        for reference in references(streams[pending.pop()].stream):
            if reference.name in streams and reference.name not in used | made:
                used |= {reference.name}
                pending.append(reference.name)
    return used


def _part(
    specification: Specification, sink: SinkDeclaration, names: frozenset[str]
) -> Specification:
    kept: list[Declaration] = [
        each
        for each in specification.declarations
        if isinstance(each, StreamDeclaration) and each.name in names
    ]
    terms = [term for each in kept if isinstance(each, StreamDeclaration) for term in _terms(each)]
    units = {term.unit for term in terms if isinstance(term, Call)}
    sources = {term.name for term in terms if isinstance(term, StreamReference)}
    declared = [
        each
        for each in specification.declarations
        if (isinstance(each, UnitDeclaration) and each.name in units)
        or (isinstance(each, SourceDeclaration) and each.name in sources)
    ]
    return Specification((*declared, *kept, sink), text=specification.text)


def _terms(declaration: StreamDeclaration) -> Iterator[Term]:
    pending = [declaration.stream]
    while pending:
        term = pending.pop()
        yield term
        pending.extend(term.inputs)
