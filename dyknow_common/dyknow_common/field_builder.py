"""Fields of messages in the texts of all languages."""

from __future__ import annotations

from lark import Token

from dyknow_common.errors import DyKnowError, shortened
from dyknow_common.fields import (
    ArrayElements,
    ComputedField,
    ElementCondition,
    MessagePath,
    joined_field,
    number_of,
    parse_field,
)
from dyknow_common.message_constants import message_constant
from dyknow_common.parsing import (
    ConstraintBuilder,
    Language,
    PositionedError,
    Syntax,
    TextPosition,
    builder,
    comparison_value,
    number_value,
    quoted,
    text_value,
)
from dyknow_common.values import Value, ValueType


@builder
class FieldBuilder(ConstraintBuilder[Syntax]):
    """A builder for the rules of `common.lark`."""

    def computed(self, function: Token, path: Token, *conditions: Token) -> Token:
        """Return the canonical text of a function of the values at a path, or at several."""
        field = ComputedField(str(function), message_path(path))
        if conditions:  # Each is a word, a path, a comparison and a value.
            flat = (path, path, *conditions)
            groups = zip(flat[::4], flat[1::4], flat[2::4], flat[3::4], strict=True)
            field = joined_field(str(function), (_condition(*each) for each in groups))
        return Token.new_borrow_pos('COMPUTED', str(checked_field(field, function)), function)

    def compared(
        self, field: Token, comparison: Token, value: Token
    ) -> tuple[str, ElementCondition]:
        """Return a field and what it is compared with."""
        name = field_name(field)
        condition = ElementCondition(comparison_value(comparison), literal_value(value))
        if condition.fault:
            raise PositionedError(condition.fault, TextPosition.of(value))
        if ValueType.of(condition.value) in {ValueType.INT, ValueType.FLOAT}:
            name = number_of(name)
        return name, condition

    def elements(self, array: Token, variable: Token) -> ArrayElements:
        """Return the elements of an array."""
        return ArrayElements(str(message_path(array)), str(variable))


def _condition(
    word: Token, path: Token, comparison: Token, value: Token
) -> tuple[str, MessagePath, ElementCondition]:
    condition = ElementCondition(comparison_value(comparison), literal_value(value))
    return str(word), message_path(path), condition


def checked_field(field: ComputedField, function: Token) -> ComputedField:
    """Return a function of fields, whose name is at a token.

    Raises:
        PositionedError: for an unknown function, or one that has no condition.
    """
    if field.fault:
        raise PositionedError(field.fault, TextPosition.of(function))
    return field


def message_path(token: Token) -> MessagePath:
    """Return the path that a token stands for.

    Raises:
        PositionedError: for a key that no message of ROS can hold.
    """
    path = parse_field(token)
    if not isinstance(path, MessagePath):
        message = f'{shortened(token)!r} is no path to a field; look at the key'
        raise PositionedError(message, TextPosition.of(token))
    return path


def field_name(token: Token) -> str:
    """Return the name of a field: the canonical text of a path, or the content of quotes.

    Raises:
        PositionedError: see `message_path` and `text_value`.
    """
    return str(message_path(token)) if token.type == 'FIELD' else text_value(token)


def field_text(language: Language, name: str) -> str:
    """Return the name of a field in texts of a language."""
    field = parse_field(name)
    if str(field) != name:
        return quoted(name)
    return name if isinstance(field, ComputedField) else language.name_text(name, 'FIELD')


def _installed_constant(token: Token) -> Value:
    try:
        found = message_constant(token)
    except DyKnowError as error:
        raise PositionedError(error.message, TextPosition.of(token)) from None
    if found is None:
        message = f"the message type of '{token}' is not installed; write the value"
        raise PositionedError(message, TextPosition.of(token))
    return found


def literal_value(token: Token) -> Value:
    """Return the value of a number, a quoted text, `true`, `false` or a constant of a message type.

    Raises:
        PositionedError: see `number_value` and `text_value`; for a constant that is not installed.
    """
    if token.type == 'MESSAGE_CONSTANT':
        return _installed_constant(token)
    if token.type == 'QUOTED':
        return text_value(token)
    return token.startswith('t') if token.type == 'TRUTH' else number_value(token)
