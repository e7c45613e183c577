"""Specifications with the same meaning on every engine: aliases for streams, absolute topics."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace

from dyknow_common import cached_by_text
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


@cached_by_text
def in_namespace(specification: str, namespace: str, other: str) -> str:
    """Return a specification that has the same meaning in another namespace.

    The last results are kept: the reports of an engine repeat its specifications each second.

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
        if isinstance(term, StreamReference | BuiltInSource):
            return _moved_source(term, sources, absolute)
        if isinstance(term, Select):
            return replace(term, source=moved(term.source))
        return replace(term, inputs=tuple(map(moved, term.inputs)))

    def moved_declaration(declaration: Declaration) -> Declaration:
        if isinstance(declaration, SourceDeclaration):
            return replace(declaration, name=absolute(declaration.name))
        if isinstance(declaration, StreamDeclaration):
            return replace(declaration, stream=moved(declaration.stream))
        if isinstance(declaration, SinkDeclaration):
            message = declaration.message
            message = message and replace(message, topic=absolute(message.topic))
            return replace(declaration, stream=moved(declaration.stream), message=message)
        return declaration

    return replace(specification, declarations=tuple(map(moved_declaration, declared)))


def _moved_source(
    source: StreamReference | BuiltInSource,
    declared: Collection[str],
    absolute: Callable[[str], str],
) -> Term:
    """Return a stream, a topic or a built-in source with its absolute topic."""
    if isinstance(source, BuiltInSource):
        if source.kind is not BuiltIn.TF:
            return replace(source, arguments=tuple(map(absolute, source.arguments)))
        return source
    if source.is_topic or source.name in declared:
        return replace(source, name=absolute(source.name), is_topic=True)
    return source
