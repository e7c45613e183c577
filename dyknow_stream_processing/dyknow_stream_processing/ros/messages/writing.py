"""Messages from values: the only place that decides which value fits a field.

Sinks and generated code give values by their paths, `{'ranges[2]': 1.5}`; triggers and guards give
trees as in YAML, `{'ranges': [0, 0, 1.5]}`. The same rules apply to both:

- A boolean is no number, and a text neither. An int becomes a float where one is wanted.
- A number lies within the range of its type; a float may be infinite or NaN.
- A byte is an int from 0 to 255, and a `char` or `wchar` of IDL one character.
- A text has neither NUL, at which rclpy would cut it, nor surrogates, which UTF-8 lacks.

Other fields keep their default values.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, reduce
from typing import Any, Final, Generic, TypeVar

from rosidl_parser.definition import (
    AbstractGenericString,
    AbstractNestedType,
    AbstractType,
    AbstractWString,
    Array,
    NamespacedType,
)

from dyknow_common import (
    ExitCode,
    MessagePath,
    Value,
    absence,
    listed_as,
    parse_field,
    shortened,
)
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.ros.messages.message_types import (
    field_types,
    max_size,
    nested_class,
    scalar_fields,
    type_name_of,
)

MAX_FILLED: Final = 10_000
"""The elements of the arrays of a message that nobody gave, before ones that are given."""

Step = str | int
"""A field of a message, or the number of an element of an array."""

_Length = tuple[tuple[Step, ...], '_Array', int]
"""The steps to an array of a message, its type, and the length that it must have at least."""

Substitute = Callable[[str, Any], Any]
"""Returns what stands for a value of a tree, given the name of its type, `float64`."""

M = TypeVar('M')

_MAX_BITS: Final = 500
"""The bits of an integer that an error shows."""
_UNSENDABLE: Final = re.compile('[\0\ud800-\udfff]')


class FieldError(StreamError):
    """A value that does not fit into a field, or a field that a message does not have.

    Args:
        path: the path from the message to the value; for an unknown field, to its parent.
        reason: names the value, the type and what the type holds.
        code: NOT_FOUND for an unknown field.
    """

    def __init__(
        self, path: tuple[Step, ...], reason: str, code: ExitCode = ExitCode.INVALID_ARGUMENT
    ) -> None:
        # The reason why a message lacks a field names the field.
        named = path[:-1] if code is ExitCode.NOT_FOUND else path
        steps = ''.join(f'[{step}]' if isinstance(step, int) else f'.{step}' for step in named)
        super().__init__(f"field '{steps.removeprefix('.')}': {reason}" if named else reason, code)
        self.path, self.reason = path, reason

    def within(self, step: Step) -> FieldError:
        """Return this error, seen from the message or array that has the field or element."""
        return FieldError((step, *self.path), self.reason, self.code)


class MessageWriter(Generic[M]):
    """Writer of messages of a class.

    Args:
        class_: the class of the messages, requests or goals.
    """

    def __init__(self, class_: Callable[[], M]) -> None:
        self._kind = _message(class_)

    def paths(self, values: Mapping[str, Value]) -> M:
        """Return a message with values at some paths; arrays grow to the highest index.

        Raises:
            FieldError: for an unknown path, a value that does not fit, or an index so high that
                more than MAX_FILLED elements would be missing.
        """
        places, arrays = _layout(self._kind, tuple(values))
        message: M = self._kind.default()
        for steps, kind, length in arrays:
            array: Any = reduce(_part, steps, message)
            array.extend(kind.element.default() for _ in range(len(array), length))
        for place, value in zip(places, values.values(), strict=True):
            place.set(message, value)
        return message

    def tree(self, values: Mapping[str, Any], substitute: Substitute | None = None) -> M:
        """Return a message with some fields, each a value, a list or a mapping of fields.

        Args:
            values: the fields.
            substitute: returns what stands for a value; None: each value stands for itself.

        Raises:
            FieldError: for an unknown field, or a value that does not fit.
        """
        message: M = self._kind.written(values, substitute)
        return message


@dataclass(frozen=True, slots=True)
class _Single:
    """The type of a single value; `fitting` returns None for what does not fit."""

    name: str
    holds: str
    initial: Any
    fitting: Callable[[Any], Any]

    def default(self) -> Any:
        return self.initial

    def written(self, value: Any, use: Substitute | None) -> Any:
        """Return a value as messages hold it."""
        del use
        found = self.fitting(value)
        if found is None:
            raise _misfit(self, value)
        return found


class _Message:
    """The type of a message."""

    def __init__(self, class_: Callable[[], Any]) -> None:
        self.default = class_
        self.name = type_name_of(class_)
        self.members = {name: _kind(each) for name, each in field_types(class_).items()}
        self.holds = 'mappings from fields to values'

    def written(self, value: Any, use: Substitute | None) -> Any:
        if not isinstance(value, Mapping):
            raise _misfit(self, value)
        message = self.default()
        for name, each in value.items():
            if name not in self.members:
                lack = absence(self.name, self.members, str(name))
                raise FieldError((name,), lack, ExitCode.NOT_FOUND)
            setattr(message, name, _within(name, self.members[name], each, use))
        return message


class _Array:
    """The type of an array, whose length is from `least` to `most`."""

    def __init__(self, array_type: AbstractNestedType) -> None:
        self.element, size = _element(array_type.value_type), max_size(array_type)
        self.least = array_type.size if isinstance(array_type, Array) else 0
        self.most = math.inf if size is None else size
        bound = '' if size is None else f'{"<=" * (not self.least)}{size}'
        self.name = f'{self.element.name}[{bound}]'
        self.holds = f'lists of length {bound}' if bound else 'lists'

    def written(self, value: Any, use: Substitute | None) -> Any:
        if not isinstance(value, list) or not self.least <= len(value) <= self.most:
            raise _misfit(self, value)
        return [_within(index, self.element, each, use) for index, each in enumerate(value)]


_Element = _Single | _Message
_Kind = _Element | _Array


def _within(step: Step, kind: _Kind, value: Any, use: Substitute | None) -> Any:
    """Return a value of a field or an element as messages hold it; its errors name the step."""
    try:
        return kind.written(value if use is None else use(kind.name, value), use)
    except FieldError as error:
        raise error.within(step) from None


def _misfit(kind: _Kind, value: Any, path: tuple[Step, ...] = ()) -> FieldError:
    match value:
        case bool() | None | str():
            shown = shortened(json.dumps(value, ensure_ascii=False))
        case int() if value.bit_length() > _MAX_BITS:
            shown = f'an integer of {value.bit_length()} bits'
        case Mapping():
            shown = 'a mapping'
        case list():
            shown = f'a list of length {len(value)}'
        case _:
            shown = shortened(value)
    mend = ''
    if getattr(kind, 'initial', None) == '':
        found = _UNSENDABLE.search(value) if isinstance(value, str) else None
        mend = f'; remove the character {found[0]!r}' if found else ''
        mend = '; quotes make it a text' if isinstance(value, int | float) else mend
    reason = f'{shown} does not fit into {kind.name}, which holds {kind.holds}{mend}'
    return FieldError(path, reason)


@dataclass(frozen=True, slots=True)
class _Place:
    """The place of a single value in messages.

    Args:
        steps: the steps from the message to the value.
        kind: the kind of the value.
        arrays: the arrays on the way that may be too short: their steps, the index, and the type.
    """

    steps: tuple[Step, ...]
    kind: _Single
    arrays: tuple[tuple[tuple[Step, ...], int, _Array], ...]

    def set(self, message: Any, value: Any) -> None:
        held = self.kind.fitting(value)
        if held is None:
            raise _misfit(self.kind, value, self.steps)
        *way, last = self.steps
        owner = reduce(_part, way, message)
        if isinstance(last, int):
            owner[last] = held
        else:
            setattr(owner, last, held)


@lru_cache(maxsize=10_000)
def _place(kind: _Message, path: str) -> _Place:
    """Return the place of a path to a single value.

    Raises:
        FieldError: if the message has no such path, or it is found by a key or computed.
    """
    field, steps, arrays = parse_field(path), list[Step](), []
    found: _Kind | None = kind
    for step in field.steps if isinstance(field, MessagePath) else ():
        found = found.members.get(step.name) if isinstance(found, _Message) else None
        steps.append(step.name)
        if isinstance(found, _Array) and isinstance(step.selector, int):
            if not found.least:
                arrays.append((tuple(steps), step.selector, found))
            found = found.element if -found.least <= step.selector < found.most else None
            steps.append(step.selector)
        elif step.selector is not None:
            break
    else:
        if isinstance(found, _Single):
            return _Place(tuple(steps), found, tuple(arrays))
    known = scalar_fields(kind.default)
    lack = absence(kind.name, known, path)
    if field is not None and listed_as(known, path):
        mend = 'set the fields that it is made of, and elements by their numbers from 0'
        lack = f"'{path}' of {kind.name} is found or computed; {mend}"
    raise FieldError((path,), lack, ExitCode.NOT_FOUND)


def _part(value: Any, step: Step) -> Any:
    return value[step] if isinstance(step, int) else getattr(value, step)


@lru_cache(maxsize=50)
def _layout(kind: _Message, paths: tuple[str, ...]) -> tuple[list[_Place], list[_Length]]:
    """Return the places of some paths, and the lengths of the arrays that lead to them.

    Raises:
        FieldError: for an unknown path, or an index that leaves out too many elements.
    """
    places, arrays = [], dict[tuple[Step, ...], _Array]()
    given: defaultdict[tuple[Step, ...], set[int]] = defaultdict(set)
    for place in (_place(kind, path) for path in paths):
        places.append(place)
        for steps, index, array in place.arrays:
            arrays[steps] = array
            given[steps].add(index)
    filled, lengths = 0, []
    for steps, indexes in given.items():  # Outer arrays come before the arrays in them.
        last = max(indexes)
        filled += last + 1 - len(indexes)
        if filled > MAX_FILLED:
            reason = f'give the elements before it; at most {MAX_FILLED} may be missing'
            raise FieldError((*steps, last), reason)
        lengths.append((steps, arrays[steps], last + 1))
    return places, lengths


_message: Final = lru_cache(maxsize=1000)(_Message)


def _kind(field_type: AbstractType) -> _Kind:
    is_array = isinstance(field_type, AbstractNestedType)
    return _Array(field_type) if is_array else _element(field_type)


def _element(field_type: AbstractType) -> _Element:
    if isinstance(field_type, NamespacedType):
        return _message(nested_class(field_type))
    if not isinstance(field_type, AbstractGenericString):
        return _SINGLE[field_type.typename]
    name = 'wstring' if isinstance(field_type, AbstractWString) else 'string'
    most: int | None = getattr(field_type, 'maximum_size', None)
    if most is None:
        return _text(name, 'texts', (0, math.inf))
    return _text(f'{name}<={most}', f'texts of at most {most} characters', (0, most))


def _text(
    name: str,
    holds: str,
    lengths: tuple[int, float],
    excluded: re.Pattern[str] = _UNSENDABLE,
) -> _Single:
    def fitting(value: Any) -> str | None:
        has_length = isinstance(value, str) and lengths[0] <= len(value) <= lengths[1]
        return value if has_length and not excluded.search(value) else None

    return _Single(name, holds, '\0' * lengths[0], fitting)


def _integer(name: str, low: int, high: int, held: Callable[[int], Any] = int) -> _Single:
    def fitting(value: Any) -> Any:
        is_number = isinstance(value, int) and not isinstance(value, bool)
        return held(value) if is_number and low <= value <= high else None

    return _Single(name, f'integers from {low} to {high}', held(0), fitting)


def _float(name: str, most: float) -> _Single:
    def fitting(value: Any) -> float | None:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        return None if not is_number or most < abs(value) < math.inf else float(value)

    return _Single(name, f'numbers up to {most:.2g}', 0.0, fitting)


_SINGLE: Final = {
    'boolean': _Single(
        'bool', 'true or false', False, lambda value: value if isinstance(value, bool) else None
    ),
    'octet': _integer('byte', 0, 255, lambda value: bytes([value])),
    'char': _text('char', 'an ASCII character', (1, 1), re.compile('[^\0-\x7f]')),
    'wchar': _text(
        'wchar', 'a character of UTF-16', (1, 1), re.compile('[^\0-\ud7ff\ue000-\uffff]')
    ),
    'float': _float('float32', (2 - 2**-23) * 2.0**127),
    'double': _float('float64', sys.float_info.max),
    'long double': _float('long double', sys.float_info.max),
    **{
        name: _integer(name, low, low + 2**bits - 1)
        for bits in (8, 16, 32, 64)
        for name, low in ((f'int{bits}', -(2 ** (bits - 1))), (f'uint{bits}', 0))
    },
}
"""The types of single values by their names in IDL."""
