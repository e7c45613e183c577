"""Stream specifications as abstract syntax; `str` gives the canonical text."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Iterable, Iterator
from enum import StrEnum
from typing import Final

from dyknow_common import (
    FIELD_PATH,
    NO_CONSTRAINTS,
    NOWHERE,
    ExitCode,
    LanguageError,
    StreamConstraints,
    TextPosition,
    Value,
    ValueType,
    format_duration,
)

LANGUAGE: Final = 'stream specification'
"""What a text of the stream language is called in messages."""

_NAME = re.compile(r'[A-Za-z_]\w*', re.ASCII)
_FIELD = re.compile(FIELD_PATH, re.ASCII)
_RENAMING = re.compile(rf'(?![\d.])([\w]|\.(?=\w)|%{FIELD_PATH}%)+', re.ASCII)


@dataclasses.dataclass(frozen=True, slots=True)
class TypedField:
    """A field and its type, `voltage: float`."""

    name: str
    type: ValueType
    place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)

    def __str__(self) -> str:
        """The canonical text."""
        return f'{_field_text(self.name)}: {self.type}'


@dataclasses.dataclass(frozen=True, slots=True)
class StreamReference:
    """A stream by its name: a topic (quoted in the text), or a stream or source (an identifier)."""

    name: str
    is_topic: bool = False
    place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)
    constraints: StreamConstraints = dataclasses.field(default=NO_CONSTRAINTS, kw_only=True)

    @property
    def inputs(self) -> tuple[Term, ...]:
        """The streams that it is made of: none."""
        return ()

    def __str__(self) -> str:
        """The canonical text."""
        return _constrained(json_text(self.name) if self.is_topic else self.name, self.constraints)


@dataclasses.dataclass(frozen=True, slots=True)
class UnitArgument:
    """What a use of a computational unit settles besides its streams, `window = 5 s`.

    Args:
        name: of the parameter of the unit.
        value: a duration is in nanoseconds.
        is_duration: whether it was written with a unit of time.
    """

    name: str
    value: Value
    is_duration: bool = False
    place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)

    def __str__(self) -> str:
        """The canonical text."""
        if self.is_duration and isinstance(self.value, int):
            return f'{self.name} = {format_duration(self.value)}'
        return f'{self.name} = {value_text(self.value)}'


@dataclasses.dataclass(frozen=True, slots=True)
class Call:
    """A computational unit over streams, `power(select voltage, current from battery)`.

    Args:
        unit: the name of the computational unit.
        inputs: one stream for each of its parameters.
        arguments: what it takes besides.
        declaration: how the unit is declared; known once names have been resolved.
    """

    unit: str
    inputs: tuple[Term, ...]
    arguments: tuple[UnitArgument, ...] = ()
    declaration: UnitDeclaration | None = dataclasses.field(default=None, kw_only=True)
    place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)
    constraints: StreamConstraints = dataclasses.field(default=NO_CONSTRAINTS, kw_only=True)

    def __str__(self) -> str:
        """The canonical text."""
        listed = _listed((*self.inputs, *self.arguments))
        return _constrained(f'{self.unit}({listed})', self.constraints)


@dataclasses.dataclass(frozen=True, slots=True)
class Selection:
    """One field of a select, `power as "Power[%id%]"`.

    Args:
        field: the field to select.
        renaming: its name in the result, where `%C%` stands for the value of field `C`; `None`
            keeps the name.
    """

    field: str
    renaming: str | None = None
    place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)

    @property
    def embedded_fields(self) -> tuple[str, ...]:
        """The fields whose values the new name embeds."""
        return tuple((self.renaming or '').split('%')[1::2])

    @property
    def name(self) -> str:
        """The name in the result; a pattern, if it embeds fields."""
        return self.field if self.renaming is None else self.renaming

    def __str__(self) -> str:
        """The canonical text."""
        if self.renaming is None:
            return _field_text(self.field)
        bare = _RENAMING.fullmatch(self.renaming)
        return f'{_field_text(self.field)} as {self.renaming if bare else json_text(self.renaming)}'


@dataclasses.dataclass(frozen=True, slots=True)
class Condition:
    """A comparison of a field with a value, `altitude >= 10.5`.

    Args:
        field: the field.
        operator: one of `= != < <= > >=`.
        value: what it is compared with.
    """

    field: str
    operator: str
    value: Value
    place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)

    def __str__(self) -> str:
        """The canonical text."""
        return f'{_field_text(self.field)} {self.operator} {value_text(self.value)}'


@dataclasses.dataclass(frozen=True, slots=True)
class Select:
    """Some fields of those samples of a stream that satisfy every condition."""

    selections: tuple[Selection, ...]
    source: Term
    conditions: tuple[Condition, ...] = ()
    place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)
    constraints: StreamConstraints = dataclasses.field(default=NO_CONSTRAINTS, kw_only=True)

    @property
    def inputs(self) -> tuple[Term, ...]:
        """The one stream that it selects from."""
        return (self.source,)

    def __str__(self) -> str:
        """The canonical text."""
        source = f'({self.source})' if _ends_open(self.source) else str(self.source)
        parts = ['select', _listed(self.selections), 'from', source]
        if self.conditions:
            parts += ['where', ' and '.join(map(str, self.conditions))]
        return _constrained(' '.join(parts), self.constraints)


@dataclasses.dataclass(frozen=True, slots=True)
class Merge:
    """Every sample of every input."""

    inputs: tuple[Term, ...]
    place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)
    constraints: StreamConstraints = dataclasses.field(default=NO_CONSTRAINTS, kw_only=True)

    def __str__(self) -> str:
        """The canonical text."""
        return _constrained(f'merge({_listed(self.inputs)})', self.constraints)


class Approximation(StrEnum):
    """How a value between two samples is found (paper, section III)."""

    LATEST = 'latest'
    LINEAR = 'linear'


@dataclasses.dataclass(frozen=True, slots=True)
class Sync:
    """Samples that join the values that all inputs have at the same valid time."""

    inputs: tuple[Term, ...]
    approximation: Approximation = Approximation.LATEST
    place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)
    constraints: StreamConstraints = dataclasses.field(default=NO_CONSTRAINTS, kw_only=True)

    def __str__(self) -> str:
        """The canonical text."""
        text = _constrained(f'sync({_listed(self.inputs)})', self.constraints)
        if self.approximation is Approximation.LATEST:
            return text
        link = ' with' if self.constraints.is_empty else ','
        return f'{text}{link} approximation = {self.approximation}'


Term = StreamReference | Call | Select | Merge | Sync
"""What denotes a stream."""


@dataclasses.dataclass(frozen=True, slots=True)
class SourceDeclaration:
    """A topic and those of its fields that are used."""

    name: str
    fields: tuple[TypedField, ...]
    place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)

    def __str__(self) -> str:
        """The canonical text."""
        name = self.name if _NAME.fullmatch(self.name) else json_text(self.name)
        return f'source ({_listed(self.fields)}) {name}'


@dataclasses.dataclass(frozen=True, slots=True)
class UnitDeclaration:
    """A computational unit, `compunit power: float electrical_power((voltage: float, ...))`.

    Args:
        name: under which it is registered.
        output: the one field of its result.
        parameters: for each input stream, the fields that the unit takes from it.
    """

    name: str
    output: TypedField
    parameters: tuple[tuple[TypedField, ...], ...]
    place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)

    def __str__(self) -> str:
        """The canonical text."""
        texts = [
            str(fields[0]) if len(fields) == 1 else f'({_listed(fields)})'
            for fields in self.parameters
        ]
        return f'compunit {self.output} {self.name}({", ".join(texts)})'


@dataclasses.dataclass(frozen=True, slots=True)
class StreamDeclaration:
    """A name for a stream, known within its text."""

    name: str
    stream: Term
    place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)

    def __str__(self) -> str:
        """The canonical text."""
        return f'stream {self.name} = {self.stream}'


@dataclasses.dataclass(frozen=True, slots=True)
class SinkDeclaration:
    """The stream that the text is there to make."""

    stream: Term
    place: TextPosition = dataclasses.field(default=NOWHERE, compare=False, kw_only=True)

    def __str__(self) -> str:
        """The canonical text."""
        return f'sink {self.stream}'


Declaration = SourceDeclaration | UnitDeclaration | StreamDeclaration | SinkDeclaration
"""One sentence of a specification."""


@dataclasses.dataclass(frozen=True, slots=True)
class Specification:
    """A stream specification.

    Args:
        declarations: in the order of the text.
        text: what was parsed, for error messages.
    """

    declarations: tuple[Declaration, ...]
    text: str = dataclasses.field(default='', compare=False, kw_only=True)

    def error(
        self, message: str, place: TextPosition, code: ExitCode = ExitCode.INVALID_ARGUMENT
    ) -> LanguageError:
        """An error at a place of this specification."""
        return LanguageError(message, LANGUAGE, self.text, place, code)

    def __str__(self) -> str:
        """The canonical text."""
        return ';\n'.join(map(str, self.declarations))


def made(specification: Specification) -> Term:
    """The stream that a specification makes: its sink, or the one stream that no other uses.

    Raises:
        LanguageError: if there is none, or more than one.
    """
    declared = specification.declarations
    sinks = [each for each in declared if isinstance(each, SinkDeclaration)]
    if len(sinks) > 1:
        raise specification.error('a second sink; keep one', sinks[1].place)
    return sinks[0].stream if sinks else _unused(specification).stream


def _unused(specification: Specification) -> StreamDeclaration:
    streams = [each for each in specification.declarations if isinstance(each, StreamDeclaration)]
    used = {each.name for stream in streams for each in references(stream.stream)}
    unused = [stream for stream in streams if stream.name not in used]
    if len(unused) == 1:
        return unused[0]
    candidates = unused or streams
    if not candidates:
        raise specification.error('no stream is made; add a sink, such as: sink a', NOWHERE)
    raise specification.error(
        f'it is not clear which stream is made ({_listed(each.name for each in candidates)}); '
        f'add a sink, such as: sink {candidates[-1].name}',
        candidates[-1].place,
    )


def references(term: Term) -> Iterator[StreamReference]:
    """Every reference in a term."""
    if isinstance(term, StreamReference):
        yield term
    for each in term.inputs:
        yield from references(each)


def json_text(text: str) -> str:
    """A text in double quotes, escaped as in JSON."""
    return json.dumps(text, ensure_ascii=False)


def value_text(value: Value) -> str:
    """A value as it is written in the stream language."""
    if isinstance(value, bool):
        return 'true' if value else 'false'
    return json_text(value) if isinstance(value, str) else repr(value)


def _field_text(name: str) -> str:
    return name if _FIELD.fullmatch(name) else json_text(name)


def _listed(parts: Iterable[object]) -> str:
    return ', '.join(map(str, parts))


def _ends_open(term: Term) -> bool:
    """Whether constraints that follow the text of a term would be read as its own."""
    approximated = isinstance(term, Sync) and term.approximation is not Approximation.LATEST
    return isinstance(term, Select) or approximated or not term.constraints.is_empty


def _constrained(text: str, constraints: StreamConstraints) -> str:
    return text if constraints.is_empty else f'{text} with {constraints}'
