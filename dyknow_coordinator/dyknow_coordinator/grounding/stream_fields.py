"""Fields of the samples of a stream, derived from its specification."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from dyknow_stream_processing import (
    BuiltInSource,
    Call,
    Select,
    SourceDeclaration,
    StreamDeclaration,
    StreamReference,
    Term,
    UnitDeclaration,
    built_in_fields,
    made,
    parse_specification,
)


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
