"""Specifications with the same meaning on every engine: aliases for streams, absolute topics."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

from dyknow_stream_processing.language.parsing import parse_specification
from dyknow_stream_processing.language.specification import (
    BuiltIn,
    BuiltInSource,
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
    """Return the names that a text gives to topics and uses: `stream a = "/topic"; sink a`."""
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
    """Return a specification without its declarations of some names, which refer to others then."""
    kept = tuple(
        each
        for each in specification.declarations
        if not (isinstance(each, StreamDeclaration) and each.name in names)
    )
    return replace(specification, declarations=kept)


def with_aliases(specification: Specification, topics: Mapping[str, str]) -> Specification:
    """Return a specification that begins with aliases for topics, given by name."""
    declared = [
        StreamDeclaration(name, StreamReference(topic, is_topic=True))
        for name, topic in topics.items()
    ]
    return replace(specification, declarations=(*declared, *specification.declarations))


def in_namespace(specification: str, namespace: str, other: str) -> str:
    """Return a specification that means in another namespace what it means in a namespace.

    Raises:
        LanguageError: if the text is not a specification.
    """
    if namespace.rstrip('/') == other.rstrip('/'):
        return specification
    return str(with_absolute_topics(parse_specification(specification), namespace))


def with_absolute_topics(specification: Specification, namespace: str) -> Specification:
    """Return a specification whose relative topics are in a namespace, such as `/robot1`."""
    declared = specification.declarations
    sources = {each.name for each in declared if isinstance(each, SourceDeclaration)}
    prefix = namespace.rstrip('/')

    def absolute(topic: str) -> str:
        return f'{prefix}/{topic}' if topic and topic[0] not in '/~' else topic

    def moved(term: Term) -> Term:
        if isinstance(term, StreamReference):
            if term.is_topic or term.name in sources:
                return replace(term, name=absolute(term.name), is_topic=True)
            return term
        if isinstance(term, BuiltInSource):
            is_action = term.kind is BuiltIn.ACTION
            return replace(term, arguments=(absolute(*term.arguments),)) if is_action else term
        if isinstance(term, Select):
            return replace(term, source=moved(term.source))
        return replace(term, inputs=tuple(map(moved, term.inputs)))

    def moved_declaration(declaration: Declaration) -> Declaration:
        if isinstance(declaration, SourceDeclaration):
            return replace(declaration, name=absolute(declaration.name))
        if isinstance(declaration, SinkDeclaration) and declaration.publication is not None:
            published = declaration.publication
            published = replace(published, topic=absolute(published.topic))
            return replace(declaration, stream=moved(declaration.stream), publication=published)
        if isinstance(declaration, StreamDeclaration | SinkDeclaration):
            return replace(declaration, stream=moved(declaration.stream))
        return declaration

    return replace(specification, declarations=tuple(map(moved_declaration, declared)))
