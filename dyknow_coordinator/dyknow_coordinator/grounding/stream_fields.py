"""Which fields the samples of a stream have, read off its specification."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from dyknow_stream_processing import (
    Call,
    Select,
    SourceDeclaration,
    Specification,
    StreamDeclaration,
    StreamReference,
    Term,
    UnitDeclaration,
    made,
    parse_specification,
)


def field_names(
    specification: str,
    stream_fields: Callable[[str], Iterable[str]],
    topic_fields: Callable[[str], Iterable[str]],
) -> tuple[str, ...]:
    """The fields of the stream that a specification makes; those that samples name are not known.

    Args:
        specification: in the stream language.
        stream_fields: those of a stream that it refers to and does not declare.
        topic_fields: those of a topic.
    """
    parsed = parse_specification(specification)
    return tuple(dict.fromkeys(_Reader(parsed, stream_fields, topic_fields).of(made(parsed))))


class _Reader:
    def __init__(
        self,
        specification: Specification,
        stream_fields: Callable[[str], Iterable[str]],
        topic_fields: Callable[[str], Iterable[str]],
    ) -> None:
        self._declared = {
            each.name: each
            for each in specification.declarations
            if isinstance(each, StreamDeclaration | SourceDeclaration | UnitDeclaration)
        }
        self._stream_fields = stream_fields
        self._topic_fields = topic_fields

    def of(self, term: Term) -> Iterable[str]:
        match term:
            case StreamReference():
                return self._of_reference(term)
            case Select():
                return [each.name for each in term.selections if not each.embedded_fields]
            case Call():
                unit = self._declared.get(term.unit)
                return [unit.output.name] if isinstance(unit, UnitDeclaration) else []
            case _:
                return [name for each in term.inputs for name in self.of(each)]

    def _of_reference(self, reference: StreamReference) -> Iterable[str]:
        declared = self._declared.get(reference.name)
        if isinstance(declared, SourceDeclaration):
            return [field.name for field in declared.fields]
        if reference.is_topic:
            return self._topic_fields(reference.name)
        if isinstance(declared, StreamDeclaration):
            return self.of(declared.stream)
        return self._stream_fields(reference.name)
