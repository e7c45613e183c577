"""Parsing of stream specifications to their abstract syntax."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from lark import Token, v_args

from dyknow_common import (
    NO_CONSTRAINTS,
    NOWHERE,
    ConstraintBuilder,
    DyKnowError,
    PositionedError,
    StreamConstraints,
    TextPosition,
    Value,
    ValueType,
    distinct_settings,
    duration_value,
    text_value,
)
from dyknow_stream_processing.language.specification import (
    LANGUAGE,
    Approximation,
    Call,
    Condition,
    Declaration,
    Merge,
    Select,
    Selection,
    SinkDeclaration,
    SourceDeclaration,
    Specification,
    StreamDeclaration,
    StreamReference,
    Sync,
    Term,
    TypedField,
    UnitArgument,
    UnitDeclaration,
)


def parse_specification(text: str) -> Specification:
    """Return the abstract syntax of a stream specification.

    A text that is one bare stream, such as `select a from b`, stands for a sink of that stream.

    Raises:
        LanguageError: with the position and what was expected there.
    """
    return Specification(LANGUAGE.parse(text, _SpecificationBuilder()), text=text)


@dataclass(frozen=True, slots=True)
class _GivenConstraints:
    """A list of constraints in the text; the approximation of a sync is written among them."""

    values: StreamConstraints = NO_CONSTRAINTS
    approximation: Approximation | None = None
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
        if not isinstance(constrained, Sync):
            message = 'only a sync has an approximation; others keep the samples as they are'
            raise PositionedError(message, self.position)
        return replace(constrained, approximation=self.approximation)


@v_args(inline=True)
class _SpecificationBuilder(ConstraintBuilder[tuple[Declaration, ...]]):
    """The builder of the abstract syntax; it has a method for each rule of the grammar."""

    def start(self, *declarations: Declaration) -> tuple[Declaration, ...]:
        return declarations

    def anonymous(self, stream: Term) -> tuple[Declaration, ...]:
        return (SinkDeclaration(stream, position=stream.position),)

    def source(self, fields: tuple[TypedField, ...], name: Token) -> SourceDeclaration:
        return SourceDeclaration(_name(name), fields, position=TextPosition.of(name))

    def sink(self, stream: Term) -> SinkDeclaration:
        return SinkDeclaration(stream, position=stream.position)

    def unit(
        self, output: TypedField, name: Token, *parameters: tuple[TypedField, ...]
    ) -> UnitDeclaration:
        return UnitDeclaration(str(name), output, parameters, position=TextPosition.of(name))

    def named(self, name: Token, stream: Term) -> StreamDeclaration:
        return StreamDeclaration(str(name), stream, position=TextPosition.of(name))

    def fields(self, *fields: TypedField) -> tuple[TypedField, ...]:
        for field in fields:
            if sum(field.name == other.name for other in fields) > 1:
                raise PositionedError(f"field '{field.name}' is declared twice", field.position)
        return fields

    def typed(self, name: Token, value_type: Token) -> TypedField:
        return TypedField(_name(name), ValueType(value_type), position=TextPosition.of(name))

    def constrained(self, stream: Term, *constraints: _GivenConstraints) -> Term:
        return constraints[0].added_to(stream) if constraints else stream

    def reference(self, name: Token) -> StreamReference:
        return StreamReference(_name(name), name.type == 'QUOTED', position=TextPosition.of(name))

    def call(self, unit: Token, *parts: Term | UnitArgument) -> Call:
        inputs = tuple(part for part in parts if not isinstance(part, UnitArgument))
        arguments = tuple(part for part in parts if isinstance(part, UnitArgument))
        if (*inputs, *arguments) != parts:
            raise PositionedError('write the streams before the parameters', TextPosition.of(unit))
        return Call(str(unit), inputs, arguments, position=TextPosition.of(unit))

    def argument(self, name: Token, value: Token) -> UnitArgument:
        position = TextPosition.of(name)
        if value.type == 'QUANTITY' and value[-1].isalpha():
            return UnitArgument(
                str(name), duration_value(value), is_duration=True, position=position
            )
        return UnitArgument(str(name), _value(value), position=position)

    @v_args(inline=False, meta=True)
    def merge(self, meta: Any, inputs: list[Term]) -> Merge:
        return Merge(tuple(inputs), position=TextPosition.of(meta))

    @v_args(inline=False, meta=True)
    def sync(self, meta: Any, inputs: list[Term]) -> Sync:
        return Sync(tuple(inputs), position=TextPosition.of(meta))

    @v_args(inline=False, meta=True)
    def select(self, meta: Any, parts: list[Any]) -> Term:
        selections, source, *rest = parts
        conditions: tuple[Condition, ...] = ()
        constraints = _GivenConstraints()
        for part in rest:
            # Constraints belong to the source if conditions or more constraints follow them.
            source, constraints = constraints.added_to(source), _GivenConstraints()
            if isinstance(part, _GivenConstraints):
                constraints = part
            else:
                conditions = part
        select = Select(selections, source, conditions, position=TextPosition.of(meta))
        return constraints.added_to(select)

    def selections(self, *selections: Selection) -> tuple[Selection, ...]:
        return selections

    def selection(self, field: Token, renaming: Token | None = None) -> Selection:
        new_name = None if renaming is None else _renaming(renaming)
        return Selection(_name(field), new_name, position=TextPosition.of(field))

    def where(self, *conditions: Condition) -> tuple[Condition, ...]:
        return conditions

    def condition(self, field: Token, comparison: Token, value: Token) -> Condition:
        position = TextPosition.of(field)
        return Condition(_name(field), str(comparison), _value(value), position=position)

    def constraints(self, *settings: tuple[Token, Any]) -> _GivenConstraints:
        values = distinct_settings(settings)
        approximation = values.pop('approximation', None)
        position = TextPosition.of(settings[0][0])
        return _GivenConstraints(StreamConstraints(**values), approximation, position)

    def approximation(self, name: Token, approximation: Token) -> tuple[Token, Approximation]:
        return name, Approximation(approximation)


def _name(token: Token) -> str:
    name = text_value(token)
    if not name:
        raise PositionedError('a name must not be empty', TextPosition.of(token))
    return name


def _renaming(token: Token) -> str:
    name = _name(token)
    parts = name.split('%')
    if len(parts) % 2 == 0 or not all(parts[1::2]):
        raise PositionedError(
            f"'{name}' has a % without its pair; a field's value is embedded as %field%",
            TextPosition.of(token),
        )
    return name


def _value(token: Token) -> Value:
    if token.type == 'QUOTED':
        return text_value(token)
    if token.type == 'TRUTH':
        return token.startswith('t')
    if not set(token) & set('.eE'):
        return int(token)
    number = float(token)
    if math.isinf(number):
        raise PositionedError(f'{token} is too large for a float', TextPosition.of(token))
    return number
