"""Parsing of stream specifications to their abstract syntax."""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any, Final

from lark import Token

from dyknow_common import (
    NO_CONSTRAINTS,
    NOWHERE,
    ArrayElements,
    DyKnowError,
    FieldBuilder,
    PositionedError,
    StreamConstraints,
    TextPosition,
    ValueType,
    builder,
    cached_by_text,
    distinct_settings,
    duration_value,
    field_name,
    literal_value,
    text_value,
)
from dyknow_stream_processing.language import specification as syntax
from dyknow_stream_processing.language.built_in_sources import built_in_source
from dyknow_stream_processing.language.specification import (
    LANGUAGE,
    Assignment,
    Declaration,
    SinkMessage,
    Specification,
    Term,
)

LONG_TEXT: Final = 5000
"""Characters of a specification that takes tens of milliseconds to parse."""


@cached_by_text
def parse_specification(text: str) -> Specification:
    """Return the abstract syntax of a stream specification.

    A text that is one bare stream, such as `select a from b`, stands for a sink of that stream.

    Raises:
        LanguageError: with the position and what was expected there.
    """
    return parse_once(text)


def parse_once(text: str) -> Specification:
    """Return what `parse_specification` does, for a text that is not parsed again."""
    declarations = LANGUAGE.parse(text, _SpecificationBuilder())
    with LANGUAGE.errors_in(text):
        for each in declarations:
            if isinstance(each, syntax.StreamDeclaration | syntax.SinkDeclaration):
                LANGUAGE.check_depth(each.stream, attrgetter('inputs'))
    return Specification(declarations, text=text)


@dataclass(frozen=True, slots=True)
class _GivenConstraints:
    """A list of constraints in the text; the approximation of a sync is written among them."""

    values: StreamConstraints = NO_CONSTRAINTS
    approximation: syntax.Approximation | None = None
    position: TextPosition = NOWHERE

    def added_to(self, stream: Term) -> Term:
        """Return a stream with these constraints added."""
        try:
            merged = stream.constraints.merged(self.values)
        except DyKnowError as error:
            raise PositionedError(error.message, self.position) from None
        constrained = replace(stream, constraints=merged)
        if self.approximation is None:
            return constrained
        if not isinstance(constrained, syntax.Sync):
            message = 'only a sync has an approximation; others keep the samples as they are'
            raise PositionedError(message, self.position)
        return replace(constrained, approximation=self.approximation)


@builder
class _SpecificationBuilder(FieldBuilder[tuple[Declaration, ...]]):
    """The builder of the abstract syntax; it has a method for each rule of the grammar."""

    def start(self, *parts: Any) -> tuple[Any, ...]:
        return parts

    selections = where = start

    def anonymous(self, stream: Term) -> tuple[Declaration, ...]:
        return (self.sink(stream),)

    def sink(self, stream: Term, message: SinkMessage | None = None) -> syntax.SinkDeclaration:
        return syntax.SinkDeclaration(stream, message, position=stream.position)

    def message(self, message_type: Token, *parts: Assignment | Token) -> SinkMessage:
        assignments = tuple(part for part in parts if isinstance(part, Assignment))
        seen: set[str] = set()
        for each in assignments:
            if each.path in seen:
                raise PositionedError(f"field '{each.path}' is given twice", each.position)
            seen.add(each.path)
        topics = [_name(part) for part in parts if isinstance(part, Token)]
        position = TextPosition.of(message_type)
        return SinkMessage(str(message_type), assignments, ''.join(topics), position=position)

    def assignment(self, path: Token, value: Token) -> Assignment:
        if value.type == 'FIELD':
            return Assignment(str(path), field=str(value))
        return Assignment(str(path), constant=literal_value(value))

    def source(
        self, fields: tuple[syntax.TypedField, ...], name: Token
    ) -> syntax.SourceDeclaration:
        return syntax.SourceDeclaration(_name(name), fields, position=TextPosition.of(name))

    def unit(
        self,
        outputs: tuple[syntax.TypedField, ...],
        name: Token,
        *parameters: tuple[syntax.TypedField, ...],
    ) -> syntax.UnitDeclaration:
        if name in list(syntax.BuiltIn):
            message = f"'{name}' is a built-in source; choose another name for the unit"
            raise PositionedError(message, TextPosition.of(name))
        return syntax.UnitDeclaration(
            str(name), outputs, parameters, position=TextPosition.of(name)
        )

    def named(self, name: Token, stream: Term) -> syntax.StreamDeclaration:
        return syntax.StreamDeclaration(str(name), stream, position=TextPosition.of(name))

    def fields(self, *fields: syntax.TypedField) -> tuple[syntax.TypedField, ...]:
        seen: dict[str, syntax.TypedField] = {}
        for field in fields:
            first = seen.setdefault(field.name, field)
            if first is not field:
                raise PositionedError(f"field '{field.name}' is declared twice", first.position)
        return fields

    def typed(self, name: Token, value_type: Token) -> syntax.TypedField:
        return syntax.TypedField(_field(name), ValueType(value_type))

    def constrained(self, stream: Term, *constraints: _GivenConstraints) -> Term:
        return constraints[0].added_to(stream) if constraints else stream

    def reference(self, name: Token) -> syntax.StreamReference:
        return syntax.StreamReference(_name(name), name.type == 'QUOTED')

    def built_in(self, kind: Token, *arguments: Token) -> syntax.BuiltInSource:
        names = tuple(_name(each) for each in arguments if each.type == 'QUOTED')
        windows = [duration_value(each) for each in arguments[len(names) :]]
        return built_in_source(
            syntax.BuiltIn(kind), names, next(iter(windows), None), TextPosition.of(kind)
        )

    def call(self, unit: Token, *parts: Term | syntax.UnitArgument) -> syntax.Call:
        inputs = tuple(part for part in parts if not isinstance(part, syntax.UnitArgument))
        arguments = tuple(part for part in parts if isinstance(part, syntax.UnitArgument))
        if (*inputs, *arguments) != parts:
            message = 'write the streams before the parameters'
            raise PositionedError(message, TextPosition.of(unit))
        return syntax.Call(str(unit), inputs, arguments)

    def argument(self, name: Token, value: Token) -> syntax.UnitArgument:
        if value.type == 'QUANTITY' and value[-1].isalpha():
            return syntax.UnitArgument(str(name), duration_value(value), is_duration=True)
        return syntax.UnitArgument(str(name), literal_value(value))

    def merge(self, *inputs: Term) -> syntax.Merge:
        return syntax.Merge(inputs)

    def sync(self, *inputs: Term) -> syntax.Sync:
        return syntax.Sync(inputs)

    def select(self, selections: tuple[syntax.Selection, ...], *rest: Any) -> Term:
        elements = rest[0] if isinstance(rest[0], ArrayElements) else None
        source, *others = rest[1:] if elements else rest
        conditions: tuple[syntax.Condition, ...] = ()
        constraints = _GivenConstraints()
        for part in others:
            # Constraints belong to the source if conditions or more constraints follow them.
            source, constraints = constraints.added_to(source), _GivenConstraints()
            if isinstance(part, _GivenConstraints):
                constraints = part
            else:
                conditions = part
        return constraints.added_to(syntax.Select(selections, source, conditions, elements))

    def selection(self, field: Token, *rest: Any) -> syntax.Selection:
        renaming = next((_renaming(each) for each in rest if isinstance(each, Token)), None)
        unless = next((each for each in rest if isinstance(each, syntax.Condition)), None)
        return syntax.Selection(_field(field), renaming, unless)

    def condition(self, field: Token, comparison: Token, value: Token) -> syntax.Condition:
        name, condition = self.compared(field, comparison, value)
        return syntax.Condition(_checked(name, field), condition.operator, condition.value)

    def constraints(self, *settings: tuple[Token, Any]) -> _GivenConstraints:
        values = distinct_settings(settings)
        approximation = values.pop('approximation', None)
        position = TextPosition.of(settings[0][0])
        return _GivenConstraints(StreamConstraints(**values), approximation, position)

    def approximation(
        self, name: Token, approximation: Token
    ) -> tuple[Token, syntax.Approximation]:
        return name, syntax.Approximation(approximation)


def _name(token: Token) -> str:
    return _checked(text_value(token), token)


def _field(token: Token) -> str:
    return _checked(field_name(token), token)


def _checked(name: str, token: Token) -> str:
    if not name:
        raise PositionedError('a name must not be empty', TextPosition.of(token))
    return name


def _renaming(token: Token) -> str:
    name = _name(token)
    if name.count('%') % 2:
        raise PositionedError(
            f"'{name}' has a % without its pair; a field's value is embedded as %field%, and a "
            'percent sign is %%',
            TextPosition.of(token),
        )
    return name
