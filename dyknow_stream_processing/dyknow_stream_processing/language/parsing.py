"""From the text of a stream specification to its abstract syntax."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from typing import Any, Final

from lark import Token, Transformer, v_args

from dyknow_common import (
    NO_CONSTRAINTS,
    NOWHERE,
    DyKnowError,
    Language,
    StreamConstraints,
    TextPosition,
    Value,
    ValueType,
    parse_duration,
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

_SPELLINGS: Final = {
    'NAME': 'a name',
    'FIELD': 'a field',
    'QUOTED': 'a quoted text',
    'NUMBER': 'a number',
    'TRUTH': 'true or false',
    'DURATION': 'a duration',
    'TYPE': 'a type (int, float, string, boolean)',
    'COMPARISON': 'a comparison (= != < <= > >=)',
    'CONSTRAINT': (
        'a constraint (start_time, end_time, max_delay, sample_period, sample_period_deviation)'
    ),
    'RENAMING': 'a new name',
    'CHOICE': 'approximation',
    'APPROXIMATION': 'latest or linear',
    'QUANTITY': 'a number or a duration',
    '_ANOTHER': "','",
}


def parse_specification(text: str) -> Specification:
    """The abstract syntax of a stream specification.

    A text that is one bare stream, such as `select a from b`, stands for a sink of that stream.

    Raises:
        LanguageError: with the place and what was expected there.
    """
    return Specification(_STREAMS.parse(text), text=text)


@v_args(inline=True)
class _SpecificationBuilder(Transformer[Any]):
    """Makes the abstract syntax; one method for each rule of the grammar."""

    def start(self, *declarations: Declaration) -> tuple[Declaration, ...]:
        return declarations

    def anonymous(self, stream: Term) -> tuple[Declaration, ...]:
        return (SinkDeclaration(stream, place=stream.place),)

    def source(self, fields: tuple[TypedField, ...], name: Token) -> SourceDeclaration:
        return SourceDeclaration(_name(name), fields, place=TextPosition.of(name))

    def sink(self, stream: Term) -> SinkDeclaration:
        return SinkDeclaration(stream, place=stream.place)

    def unit(
        self, output: TypedField, name: Token, *parameters: tuple[TypedField, ...]
    ) -> UnitDeclaration:
        return UnitDeclaration(str(name), output, parameters, place=TextPosition.of(name))

    def named(self, name: Token, stream: Term) -> StreamDeclaration:
        return StreamDeclaration(str(name), stream, place=TextPosition.of(name))

    def fields(self, *fields: TypedField) -> tuple[TypedField, ...]:
        for field in fields:
            if sum(field.name == other.name for other in fields) > 1:
                raise ValueError(f"field '{field.name}' is declared twice", field.place)
        return fields

    def typed(self, name: Token, value_type: Token) -> TypedField:
        return TypedField(_name(name), ValueType(value_type), place=TextPosition.of(name))

    def constrained(self, stream: Term, *constraints: _Constraints) -> Term:
        return constraints[0].on(stream) if constraints else stream

    def reference(self, name: Token) -> StreamReference:
        return StreamReference(_name(name), name.type == 'QUOTED', place=TextPosition.of(name))

    def call(self, unit: Token, *parts: Term | UnitArgument) -> Call:
        inputs = tuple(part for part in parts if not isinstance(part, UnitArgument))
        arguments = tuple(part for part in parts if isinstance(part, UnitArgument))
        if (*inputs, *arguments) != parts:
            raise ValueError('write the streams before the parameters', TextPosition.of(unit))
        return Call(str(unit), inputs, arguments, place=TextPosition.of(unit))

    def argument(self, name: Token, value: Token) -> UnitArgument:
        if value.type == 'QUANTITY' and value[-1].isalpha():
            return UnitArgument(
                str(name), _duration(value), is_duration=True, place=TextPosition.of(name)
            )
        return UnitArgument(str(name), _value(value), place=TextPosition.of(name))

    @v_args(inline=False, meta=True)
    def merge(self, meta: Any, inputs: list[Term]) -> Merge:
        return Merge(tuple(inputs), place=_start(meta))

    @v_args(inline=False, meta=True)
    def sync(self, meta: Any, inputs: list[Term]) -> Sync:
        return Sync(tuple(inputs), place=_start(meta))

    @v_args(inline=False, meta=True)
    def select(self, meta: Any, parts: list[Any]) -> Term:
        selections, source, *rest = parts
        conditions: tuple[Condition, ...] = ()
        constraints = _Constraints()
        for part in rest:
            # Constraints that something follows are the source's own.
            source, constraints = constraints.on(source), _Constraints()
            if isinstance(part, _Constraints):
                constraints = part
            else:
                conditions = part
        return constraints.on(Select(selections, source, conditions, place=_start(meta)))

    def selections(self, *selections: Selection) -> tuple[Selection, ...]:
        return selections

    def selection(self, field: Token, renaming: Token | None = None) -> Selection:
        if renaming is None:
            return Selection(_name(field), place=TextPosition.of(field))
        return Selection(_name(field), _renaming(renaming), place=TextPosition.of(field))

    def where(self, *conditions: Condition) -> tuple[Condition, ...]:
        return conditions

    def condition(self, field: Token, comparison: Token, value: Token) -> Condition:
        return Condition(_name(field), str(comparison), _value(value), place=TextPosition.of(field))

    def constraints(self, *constraints: tuple[Token, Any]) -> _Constraints:
        values: dict[str, Any] = {}
        for name, value in constraints:
            if name in values:
                raise ValueError(f'{name} is given twice', TextPosition.of(name))
            values[name] = value
        approximation = values.pop('approximation', None)
        place = TextPosition.of(constraints[0][0])
        return _Constraints(StreamConstraints(**values), approximation, place)

    def constraint(self, name: Token, duration: Token) -> tuple[Token, int]:
        return name, _duration(duration)

    def approximation(self, name: Token, approximation: Token) -> tuple[Token, Approximation]:
        return name, Approximation(approximation)


@dataclass(frozen=True, slots=True)
class _Constraints:
    """Constraints before they are given to a stream."""

    values: StreamConstraints = NO_CONSTRAINTS
    approximation: Approximation | None = None
    place: TextPosition = NOWHERE

    def on(self, stream: Term) -> Term:
        """The stream with these constraints added."""
        try:
            merged = stream.constraints.merged(self.values)
        except DyKnowError as error:
            raise ValueError(error.message, self.place) from None
        constrained = replace(stream, constraints=merged)
        if self.approximation is None:
            return constrained
        if not isinstance(constrained, Sync):
            message = 'only a sync has an approximation; others keep the samples as they are'
            raise ValueError(message, self.place)  # noqa: TRY004 - an error in the text
        return replace(constrained, approximation=self.approximation)


def _start(meta: Any) -> TextPosition:
    return TextPosition(meta.line, meta.column)


def _name(token: Token) -> str:
    if token.type != 'QUOTED':
        return str(token)
    name: str = json.loads(token)
    if not name:
        raise ValueError('a name must not be empty', TextPosition.of(token))
    return name


def _renaming(token: Token) -> str:
    name = _name(token)
    parts = name.split('%')
    if len(parts) % 2 == 0 or not all(parts[1::2]):
        raise ValueError(
            f"'{name}' has a % without its pair; a field's value is embedded as %field%",
            TextPosition.of(token),
        )
    return name


def _duration(token: Token) -> int:
    try:
        return parse_duration(token)
    except ValueError as error:
        raise ValueError(str(error), TextPosition.of(token)) from None


def _value(token: Token) -> Value:
    if token.type == 'QUOTED':
        text: str = json.loads(token)
        return text
    if token.type == 'TRUTH':
        return token.startswith('t')
    if not set(token) & set('.eE'):
        return int(token)
    number = float(token)
    if math.isinf(number):
        raise ValueError(f'{token} is too large for a float', TextPosition.of(token))
    return number


_STREAMS: Final[Language[tuple[Declaration, ...]]] = Language(
    LANGUAGE, __package__, 'stream.lark', _SpecificationBuilder(), _SPELLINGS
)
