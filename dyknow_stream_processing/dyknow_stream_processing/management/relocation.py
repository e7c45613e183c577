"""Specifications that mean the same on every engine: aliases for streams, absolute topics."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

from dyknow_stream_processing.language.specification import (
    Declaration,
    Select,
    SinkDeclaration,
    SourceDeclaration,
    Specification,
    StreamDeclaration,
    StreamReference,
    Term,
    references,
)


def aliases(specification: Specification) -> Mapping[str, str]:
    """The topics that a text merely gives names to and uses by them: `stream a = "/topic"`."""
    used = {
        reference.name
        for each in specification.declarations
        if isinstance(each, StreamDeclaration | SinkDeclaration)
        for reference in references(each.stream)
        if not reference.is_topic
    }
    return {
        each.name: each.stream.name
        for each in specification.declarations
        if isinstance(each, StreamDeclaration)
        and isinstance(each.stream, StreamReference)
        and each.stream.is_topic
        and each.stream.constraints.is_empty
        and each.name in used
    }


def without(specification: Specification, names: Collection[str]) -> Specification:
    """A specification without some of its streams: their names mean what they mean outside."""
    kept = tuple(
        each
        for each in specification.declarations
        if not (isinstance(each, StreamDeclaration) and each.name in names)
    )
    return replace(specification, declarations=kept)


def with_aliases(specification: Specification, topics: Mapping[str, str]) -> Specification:
    """A specification in which names stand for topics."""
    declared = [
        StreamDeclaration(name, StreamReference(topic, is_topic=True))
        for name, topic in topics.items()
    ]
    return replace(specification, declarations=(*declared, *specification.declarations))


def with_absolute_topics(specification: Specification, namespace: str) -> Specification:
    """A specification whose relative topics are those of a namespace, such as `/robot1`."""
    sources = {
        each.name for each in specification.declarations if isinstance(each, SourceDeclaration)
    }
    moving = _Moving(namespace.rstrip('/'), frozenset(sources))
    declared = tuple(moving.declaration(each) for each in specification.declarations)
    return replace(specification, declarations=declared)


class _Moving:
    def __init__(self, namespace: str, sources: frozenset[str]) -> None:
        self._namespace = namespace
        self._sources = sources

    def declaration(self, declaration: Declaration) -> Declaration:
        if isinstance(declaration, SourceDeclaration):
            return replace(declaration, name=self._absolute(declaration.name))
        if isinstance(declaration, StreamDeclaration | SinkDeclaration):
            return replace(declaration, stream=self._term(declaration.stream))
        return declaration

    def _term(self, term: Term) -> Term:
        if isinstance(term, StreamReference):
            if term.is_topic or term.name in self._sources:
                return replace(term, name=self._absolute(term.name), is_topic=True)
            return term
        if isinstance(term, Select):
            return replace(term, source=self._term(term.source))
        return replace(term, inputs=tuple(map(self._term, term.inputs)))

    def _absolute(self, topic: str) -> str:
        return f'{self._namespace}/{topic}' if topic and topic[0] not in '/~' else topic
