"""Stream specifications as abstract syntax; `str` gives the canonical text."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, TypeVar

from dyknow_common import (
    NO_CONSTRAINTS,
    ArrayElements,
    ExitCode,
    Language,
    LanguageError,
    StreamConstraints,
    SyntaxNode,
    TextPosition,
    Value,
    ValueType,
    field_text,
    format_duration,
    quoted,
    value_text,
)

LANGUAGE: Final = Language(
    'stream specification',
    __package__,
    'stream.lark',
    {
        'COMPARISON': 'a comparison (= != < <= > >= contains)',
        'TYPE': f'a type ({", ".join(ValueType)})',
        'RENAMING': 'a new name',
        'CHOICE': 'approximation',
        'APPROXIMATION': 'latest or linear',
        'QUANTITY': 'a number or a duration',
        '_ANOTHER': "','",
        'BUILT_IN': 'a name',
        'STREAM_NAME': 'a name other than select, merge and sync',
        'MESSAGE_TYPE': 'a message type, such as std_msgs/msg/Float64',
    },
)


@dataclass(frozen=True, slots=True)
class Assignment(SyntaxNode):
    """The value of a field of the messages, `point.x = east` or `header.frame_id = "map"`.

    Args:
        path: the path of the field in a message.
        field: the field of the stream; empty for a constant.
        constant: the value; `None` for a field of the stream.
    """

    path: str
    field: str = ''
    constant: Value | None = None

    def __str__(self) -> str:
        value = quoted(self.constant) if isinstance(self.constant, str) else repr(self.constant)
        return f'{self.path} = {self.field or value}'


@dataclass(frozen=True, slots=True)
class SinkMessage(SyntaxNode):
    """The messages as which a stream is published too.

    Args:
        message_type: such as `std_msgs/msg/Float64`.
        assignments: the values of message fields; if empty, stream and message have the same field
            names, or one field each.
        topic: the topic; if empty, the topic of the stream with `/message` appended.
    """

    message_type: str
    assignments: tuple[Assignment, ...] = ()
    topic: str = ''

    def __str__(self) -> str:
        assigned = f' ({", ".join(map(str, self.assignments))})' if self.assignments else ''
        topic = f' on {quoted(self.topic)}' if self.topic else ''
        return f'as {self.message_type}{assigned}{topic}'


@dataclass(frozen=True, slots=True)
class TypedField(SyntaxNode):
    """A field and its type, `voltage: float`."""

    name: str
    type: ValueType

    def __str__(self) -> str:
        return f'{field_text(LANGUAGE, self.name)}: {self.type}'


@dataclass(frozen=True, slots=True, kw_only=True)
class _Constrained(SyntaxNode):
    """A term, whose canonical text ends with its constraints."""

    constraints: StreamConstraints = NO_CONSTRAINTS

    def _with_constraints(self, text: str) -> str:
        return text if self.constraints.is_empty else f'{text} with {self.constraints}'


@dataclass(frozen=True, slots=True)
class StreamReference(_Constrained):
    """A stream by its name: a topic (quoted in the text), or a stream or source (an identifier)."""

    name: str
    is_topic: bool = False

    @property
    def inputs(self) -> tuple[Term, ...]:
        """The streams that it is made of: none."""
        return ()

    def __str__(self) -> str:
        return self._with_constraints(quoted(self.name) if self.is_topic else self.name)


class BuiltIn(StrEnum):
    """The built-in sources, which are made of whole messages, or of their times."""

    TF = 'tf'
    ACTION = 'action'
    RATE = 'rate'


@dataclass(frozen=True, slots=True)
class BuiltInSource(_Constrained):
    """A built-in source, `tf("map", "base_link")`.

    Args:
        arguments: two frames, an action, or a topic.
        window: in which the messages of a topic are counted, nanoseconds; 0 for other sources.
    """

    kind: BuiltIn
    arguments: tuple[str, ...]
    window: int = 0

    @property
    def inputs(self) -> tuple[Term, ...]:
        """The topic that it needs; what /tf_static adds to a transform may be missing."""
        match self.kind:
            case BuiltIn.TF:
                topic = '/tf'
            case BuiltIn.ACTION:
                topic = f'{self.arguments[0]}/_action/status'
            case BuiltIn.RATE:
                (topic,) = self.arguments
        return (StreamReference(topic, is_topic=True),)

    def __str__(self) -> str:
        windows = [format_duration(self.window)] if self.window else []
        text = f'{self.kind}({_listed([*map(quoted, self.arguments), *windows])})'
        return self._with_constraints(text)


@dataclass(frozen=True, slots=True)
class UnitArgument(SyntaxNode):
    """A setting of a computational unit, `window = 5 s`.

    Args:
        value: a duration is in nanoseconds.
        is_duration: true if the value was written with a unit of time.
    """

    name: str
    value: Value
    is_duration: bool = False

    def __str__(self) -> str:
        if self.is_duration and isinstance(self.value, int):
            return f'{self.name} = {format_duration(self.value)}'
        return f'{self.name} = {value_text(self.value)}'


@dataclass(frozen=True, slots=True)
class Call(_Constrained):
    """A computational unit over streams, `power(select voltage, current from battery)`.

    Args:
        inputs: one stream for each of its parameters.
        declaration: the declaration of the unit; known after the resolution of names.
    """

    unit: str
    inputs: tuple[Term, ...]
    arguments: tuple[UnitArgument, ...] = ()
    declaration: UnitDeclaration | None = field(default=None, kw_only=True)

    def __str__(self) -> str:
        return self._with_constraints(f'{self.unit}({_listed((*self.inputs, *self.arguments))})')


@dataclass(frozen=True, slots=True)
class Selection(SyntaxNode):
    """One field of a select, `power as "Power[%id%]"`.

    Args:
        renaming: its name in the result, where `%C%` stands for the value of field `C` and `%%` for
            a percent sign; `None` keeps the name.
        unless: the value, a number, is NaN in samples that satisfy this.
    """

    field: str
    renaming: str | None = None
    unless: Condition | None = None

    @property
    def embedded_fields(self) -> tuple[str, ...]:
        """The fields whose values the new name embeds."""
        return tuple(filter(None, (self.renaming or '').split('%')[1::2]))

    @property
    def name(self) -> str:
        """The name in the result; a pattern, if it embeds fields."""
        if self.renaming is None:
            return self.field
        return self.renaming if self.embedded_fields else self.renaming.replace('%%', '%')

    def __str__(self) -> str:
        text = field_text(LANGUAGE, self.field)
        if self.renaming is not None:
            text += f' as {LANGUAGE.name_text(self.renaming, "RENAMING")}'
        return text if self.unless is None else f'{text} unless {self.unless}'


@dataclass(frozen=True, slots=True)
class Condition(SyntaxNode):
    """A comparison (`= != < <= > >= contains`...) of a field with a value, `altitude >= 10.5`."""

    field: str
    operator: str
    value: Value

    def __str__(self) -> str:
        return f'{field_text(LANGUAGE, self.field)} {self.operator} {value_text(self.value)}'


@dataclass(frozen=True, slots=True)
class Select(_Constrained):
    """Some fields of the samples of a stream that satisfy every condition.

    Args:
        conditions: a sample must satisfy all.
        elements: the elements of an array of the messages of the source; each is a sample.
    """

    selections: tuple[Selection, ...]
    source: Term
    conditions: tuple[Condition, ...] = ()
    elements: ArrayElements | None = None

    @property
    def demand(self) -> frozenset[str]:
        """The fields that it reads of its source."""
        named = {name for each in self.selections for name in (each.field, *each.embedded_fields)}
        conditions = (*self.conditions, *(each.unless for each in self.selections))
        fields = named | {each.field for each in conditions if each is not None}
        return frozenset({self.elements.rows(fields)} if self.elements else fields)

    @property
    def inputs(self) -> tuple[Term, ...]:
        """The one stream that it selects from."""
        return (self.source,)

    def __str__(self) -> str:
        source = f'({self.source})' if _ends_open(self.source) else str(self.source)
        source = source if self.elements is None else f'{self.elements} {source}'
        conditions = f' where {" and ".join(map(str, self.conditions))}' if self.conditions else ''
        return self._with_constraints(
            f'select {_listed(self.selections)} from {source}{conditions}'
        )


@dataclass(frozen=True, slots=True)
class Merge(_Constrained):
    """Every sample of every input."""

    inputs: tuple[Term, ...]

    def __str__(self) -> str:
        return self._with_constraints(f'merge({_listed(self.inputs)})')


class Approximation(StrEnum):
    """The value of a field between two samples (paper, section III)."""

    LATEST = 'latest'
    LINEAR = 'linear'


@dataclass(frozen=True, slots=True)
class Sync(_Constrained):
    """Samples that join the values that all inputs have at the same valid time."""

    inputs: tuple[Term, ...]
    approximation: Approximation = Approximation.LATEST

    def __str__(self) -> str:
        text = self._with_constraints(f'sync({_listed(self.inputs)})')
        if self.approximation is Approximation.LATEST:
            return text
        link = ' with' if self.constraints.is_empty else ','
        return f'{text}{link} approximation = {self.approximation}'


Term = StreamReference | BuiltInSource | Call | Select | Merge | Sync
"""A term that denotes a stream."""


@dataclass(frozen=True, slots=True)
class SourceDeclaration(SyntaxNode):
    """A topic and its used fields."""

    name: str
    fields: tuple[TypedField, ...]

    def __str__(self) -> str:
        return f'source ({_listed(self.fields)}) {LANGUAGE.name_text(self.name)}'


@dataclass(frozen=True, slots=True)
class UnitDeclaration(SyntaxNode):
    """A computational unit, `compunit power: float electrical_power((voltage: float, ...))`.

    Args:
        name: the name under which it is registered.
        outputs: the fields of its result, often one field.
        parameters: for each input stream, the fields that the unit uses.
    """

    name: str
    outputs: tuple[TypedField, ...]
    parameters: tuple[tuple[TypedField, ...], ...]

    def __str__(self) -> str:
        output, *texts = (
            str(fields[0]) if len(fields) == 1 else f'({_listed(fields)})'
            for fields in (self.outputs, *self.parameters)
        )
        return f'compunit {output} {self.name}({", ".join(texts)})'


@dataclass(frozen=True, slots=True)
class StreamDeclaration(SyntaxNode):
    """A name for a stream, known within its text."""

    name: str
    stream: Term

    def __str__(self) -> str:
        return f'stream {self.name} = {self.stream}'


@dataclass(frozen=True, slots=True)
class SinkDeclaration(SyntaxNode):
    """A stream that the text makes, and the messages in which it is published, too."""

    stream: Term
    message: SinkMessage | None = None

    def __str__(self) -> str:
        text = f'sink {self.stream}'
        return text if self.message is None else f'{text} {self.message}'


Declaration = SourceDeclaration | UnitDeclaration | StreamDeclaration | SinkDeclaration
"""One sentence of a specification."""

Declared = TypeVar('Declared', bound=Declaration)


@dataclass(frozen=True, slots=True)
class Specification:
    """A stream specification.

    Args:
        declarations: in the order of the text.
        text: the parsed text, for error messages.
    """

    declarations: tuple[Declaration, ...]
    text: str = field(default='', compare=False, kw_only=True)

    def declared(self, kind: type[Declared]) -> list[Declared]:
        """Return the declarations of one kind, in the order of the text."""
        return [each for each in self.declarations if isinstance(each, kind)]

    def error(
        self, message: str, position: TextPosition, code: ExitCode = ExitCode.INVALID_ARGUMENT
    ) -> LanguageError:
        """Return an error at a position of this specification."""
        return LANGUAGE.error(message, self.text, position, code)

    def __str__(self) -> str:
        return ';\n'.join(map(str, self.declarations))


def subterms(term: Term) -> Iterator[Term]:
    """Yield a term and all terms in it."""
    yield term
    for each in term.inputs:
        yield from subterms(each)


def references(term: Term) -> Iterator[StreamReference]:
    """Yield every reference in a term."""
    return (each for each in subterms(term) if isinstance(each, StreamReference))


def _listed(parts: Iterable[object]) -> str:
    return ', '.join(map(str, parts))


def _ends_open(term: Term) -> bool:
    """Return True if constraints after the text of a term would be read as its own."""
    approximated = isinstance(term, Sync) and term.approximation is not Approximation.LATEST
    return isinstance(term, Select) or approximated or not term.constraints.is_empty
