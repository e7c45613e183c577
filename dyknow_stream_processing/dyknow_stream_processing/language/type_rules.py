"""Rules about types that the resolution of names and the running operators share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import Parameter, isclass, signature
from typing import Annotated, Any, Final

from dyknow_common import ValueType, with_article
from dyknow_stream_processing.language.specification import Condition, UnitArgument

Unit = Callable[..., Any]
"""A registered computational unit: a function, or a class with callable instances."""

TIME: Final = 'valid_time'
"""The parameter of a unit that receives the valid time of the sample."""

Nanoseconds = Annotated[int, 'nanoseconds']
"""The annotation of a setting that is a duration, which calls write with a unit of time."""

_SETTING_TYPES: Final[Mapping[str, ValueType]] = {
    'bool': ValueType.BOOLEAN,
    'float': ValueType.FLOAT,
    'int': ValueType.INT,
    'str': ValueType.STRING,
}
"""The types of settings by their annotations; others are not checked."""

_NUMBERS: Final = frozenset({ValueType.INT, ValueType.FLOAT})


def comparable_types(condition: Condition) -> frozenset[ValueType]:
    """Return the types that a field may have to be compared with the value of a condition."""
    value_type = ValueType.of(condition.value)
    return _NUMBERS if value_type in _NUMBERS else frozenset({value_type})


def collision_text(field: str, first: str, second: str) -> str:
    """Return the message about a field that two inputs of a `sync` have."""
    return f"field '{field}' comes from both {first} and {second}; rename it in one of them"


def settings(unit: Unit) -> Mapping[str, Parameter] | None:
    """Return the parameters of a unit that a call may set by name, `mean(power, window = 5 s)`.

    The constructor's parameters of a class, and a function's keyword-only ones; None if it takes
    any.
    """
    try:
        parameters = tuple(signature(unit).parameters.values())
    except ValueError:  # Some functions written in C have no signature.
        return {}
    if isclass(unit) and any(each.kind is Parameter.VAR_KEYWORD for each in parameters):
        return None
    kinds = [Parameter.KEYWORD_ONLY, *([Parameter.POSITIONAL_OR_KEYWORD] * isclass(unit))]
    return {each.name: each for each in parameters if each.kind in kinds and each.name != TIME}


def setting_fault(parameter: Parameter, argument: UnitArgument) -> str:
    """Return why a setting is not of the type of its annotation; empty if it is, or may be."""
    kind, given = parameter.annotation, str(argument).partition(' = ')[2]
    if kind in ('Nanoseconds', Nanoseconds):
        with_unit = f'is a duration; write one with a unit, such as 5 s, instead of {given}'
        return '' if argument.is_duration else with_unit
    wanted = _SETTING_TYPES.get(kind if isinstance(kind, str) else getattr(kind, '__name__', ''))
    if wanted is None or (
        wanted.accepts(ValueType.of(argument.value))
        and (wanted is ValueType.INT or not argument.is_duration)
    ):
        return ''
    return f'is {with_article(wanted)}; write one instead of {given}'


def interpolated(found: ValueType | None) -> ValueType | None:
    """Return the type of a field whose numbers are interpolated."""
    return ValueType.FLOAT if found is ValueType.INT else found


def fits(found: ValueType | None, wanted: ValueType) -> bool:
    """Return True if a field may have a type, as far as its own is known."""
    return found is None or wanted.accepts(found)
