"""Texts that name a value in a message, as all languages write them.

    pose.position.z                         a member of a member
    ranges[3], ranges[-1]                   an element of an array, the last one
    ranges[closest]                         the element whose number is in the field `closest`
    position[name = "elbow"]                the element where the parallel array `name` has "elbow"
    status[name = "lidar"].level            a member of the first struct whose `name` is "lidar"
    min(ranges[90:270])                     an aggregate of the elements 90 to 269
    count(status.level >= 2)                the number of elements that satisfy a condition
    count(objects.p > 0.5 and objects.x < 2)    conditions of the same element
    number(status[name = "lidar"].message)  a text as a number
    samples(poses.position.x)               all numbers, as a text with spaces

The terminals of `common.lark` find such a text among others; `parse_field` takes it apart.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from typing import Final

from dyknow_common.values import TEXT_COMPARISONS, Value

AGGREGATES: Final = ('min', 'max', 'mean', 'sum', 'count', 'any', 'all', 'samples')
"""Functions of many values."""

CONDITIONED: Final = ('count', 'any', 'all')
"""The aggregates that may have a condition."""

CONVERSIONS: Final = ('number', 'text')
"""Functions of one value."""

INDEX: Final = 'index'
"""The function that gives the number of an element, counted from 0, where each is a sample."""

WKT: Final = 'wkt'
"""The function that gives the polygon of an array of points, or the line of an array of stamped
poses, in well-known text."""

TEXTUAL: Final = ('text', WKT, 'samples')
"""The functions that give texts."""

NUMERIC: Final = ('min', 'max', 'mean', 'sum', 'samples', 'number')
"""The functions that take numbers, or texts that are numbers."""

_FUNCTIONS: Final = (*AGGREGATES, *CONVERSIONS, INDEX, WKT)
_EACH: Final = 'each '
_MAX_DIGITS: Final = 400
"""The digits of a number; Python refuses to convert thousands."""

_NAME: Final = r"[A-Za-z_][A-Za-z0-9_]*'*"
_QUOTED: Final = r'"(?:[^"\\\x00-\x1f]|\\.)*"'
_INDEX: Final = f'(?:0|[1-9][0-9]{{,{_MAX_DIGITS}}})'
_STEP: Final = re.compile(
    rf"""(?P<name>{_NAME})(?:\[(?:
        (?P<index>{_INDEX}|-(?!0){_INDEX})
        | \s*(?:(?P<start>{_INDEX})\s*)?(?P<colon>:)\s*(?:(?P<stop>{_INDEX})\s*)?
        | \s*(?P<key>{_NAME}(?:\.{_NAME})*)\s*
          (?:=\s*(?P<value>{_QUOTED}|-?{_INDEX}|true|false)\s*)?
    )\])?""",
    re.VERBOSE,
)
_FUNCTION: Final = re.compile(rf'({"|".join(_FUNCTIONS)})\s*\(\s*')
_CONDITION: Final = re.compile(
    rf"""\s*(?P<operator>!=|<=|>=|=|<|>|{'|'.join(TEXT_COMPARISONS).replace(' ', '[ ]')})\s*
    (?P<value>{_QUOTED}|true|false|-?[0-9]+(?:\.[0-9]+)?(?:[eE][+-]?[0-9]+)?)\s*
    (?:\Z|(?P<word>and|or)\b\s*)""",
    re.VERBOSE,
)


@dataclass(frozen=True, slots=True)
class ArraySlice:
    """The elements of an array from `start` up to, but not including, `stop`; None is the end."""

    start: int
    stop: int | None

    def __str__(self) -> str:
        return f'{self.start or ""}:{"" if self.stop is None else self.stop}'


@dataclass(frozen=True, slots=True)
class ElementKey:
    """The first element whose member, or element of a parallel array, has a value."""

    field: str
    value: str | int | bool

    def __str__(self) -> str:
        return f'{self.field} = {value_text(self.value)}'


@dataclass(frozen=True, slots=True)
class IndexField:
    """The element whose number, from 0, is the value of a field of the message of the array."""

    field: str

    def __str__(self) -> str:
        return self.field


Selector = int | ArraySlice | ElementKey | IndexField | None


@dataclass(frozen=True, slots=True)
class PathStep:
    """A member of a message, `ranges[3]`; without a selector, of an array all elements."""

    name: str
    selector: Selector = None

    def __str__(self) -> str:
        return self.name if self.selector is None else f'{self.name}[{self.selector}]'


@dataclass(frozen=True, slots=True)
class MessagePath:
    """A path to a value of a message, or to many."""

    steps: tuple[PathStep, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the steps."""
        return tuple(step.name for step in self.steps)

    @property
    def is_keyed(self) -> bool:
        """True if it leads through a struct that is found by a key."""
        return any(isinstance(step.selector, ElementKey) for step in self.steps[:-1])

    @property
    def is_direct(self) -> bool:
        """True if no element depends on the content or the length of its array."""
        return not any(
            isinstance(step.selector, ElementKey | IndexField)
            or (isinstance(step.selector, int) and step.selector < 0)
            for step in self.steps
        )

    def before(self, number: int) -> str:
        """Return the text up to a step, without the selector of the step."""
        return '.'.join([*map(str, self.steps[:number]), self.steps[number].name])

    def __str__(self) -> str:
        return '.'.join(map(str, self.steps))


@dataclass(frozen=True, slots=True)
class ElementCondition:
    """A comparison of each element with a value."""

    operator: str
    value: Value

    @property
    def fault(self) -> str:
        """The reason why no element can be compared so; empty if one can."""
        if self.operator in TEXT_COMPARISONS and not isinstance(self.value, str):
            return f"'{self.operator}' takes a text in quotes, not {value_text(self.value)}"
        return ''

    def __str__(self) -> str:
        return f' {self.operator} {value_text(self.value)}'


@dataclass(frozen=True, slots=True)
class JoinedCondition:
    """A further condition of the same element, after `and` or `or`; `and` binds tighter."""

    word: str
    path: MessagePath
    condition: ElementCondition


@dataclass(frozen=True, slots=True)
class ComputedField:
    """A function of the values at a path, `count(ranges < 0.3)`.

    Args:
        function: a function of many values, or of one.
        path: the path to the values.
        condition: the condition of each value.
        others: further conditions, of values at other paths that belong to the same elements.
    """

    function: str
    path: MessagePath
    condition: ElementCondition | None = None
    others: tuple[JoinedCondition, ...] = ()

    @property
    def parts(self) -> tuple[ComputedField, ...]:
        """The function of each condition alone."""
        others = (ComputedField(self.function, each.path, each.condition) for each in self.others)
        return (replace(self, others=()), *others)

    @property
    def gives_number(self) -> bool:
        """True if its value is a number."""
        return self.function not in {'any', 'all', *TEXTUAL}

    @property
    def fault(self) -> str:
        """The reason why there is no such function; empty if there is one."""
        if self.function not in _FUNCTIONS:
            known = ', '.join(_FUNCTIONS)
            return f"'{self.function}' is no function of fields (there are: {known})"
        if self.condition is not None and self.function not in CONDITIONED:
            return f"'{self.function}' takes no condition; {', '.join(CONDITIONED)} do"
        conditions = [each.condition for each in self.parts if each.condition is not None]
        return next((each.fault for each in conditions if each.fault), '')

    def __str__(self) -> str:
        return f'{self.function}({self.of("")})'

    def of(self, owner: str) -> str:
        """Return the operand, with the name of an owner and a dot before each path, or nothing."""
        first = f'{owner}{self.path}{"" if self.condition is None else self.condition}'
        others = (f' {each.word} {owner}{each.path}{each.condition}' for each in self.others)
        return ''.join([first, *others])


@dataclass(frozen=True, slots=True)
class ArrayElements:
    """An array whose elements become samples; a variable stands for the element.

    Args:
        array: the path to the array, `status`.
        variable: the first step of paths into the element: `s` in `s.name`.
    """

    array: str
    variable: str

    def __str__(self) -> str:
        return f'each {self.array} as {self.variable} in'

    @property
    def index(self) -> str:
        """The field with the number of the element, `index(s)`."""
        return f'{INDEX}({self.variable})'

    def rows(self, fields: Collection[str]) -> str:
        """Return the name of the field that holds some fields of all elements."""
        return f'{_EACH}{json.dumps([self.array, self.variable, *sorted(fields)])}'


@dataclass(frozen=True, slots=True)
class UnnestedArray:
    """Fields of all elements of an array."""

    elements: ArrayElements
    fields: tuple[str, ...]


def parse_field(text: str) -> MessagePath | ComputedField | UnnestedArray | None:
    """Return what a text names in a message; None if it names nothing there could be."""
    if text.startswith(_EACH):
        return _unnested(text.removeprefix(_EACH))
    head = _FUNCTION.match(text)
    if head is None:
        return _path(text)
    if not text.endswith(')'):
        return None
    inner = text[head.end() : -1].rstrip()
    path = _path(inner)
    return _conditioned(head[1], inner) if path is None else ComputedField(head[1], path)


def joined_field(
    function: str, conditions: Iterable[tuple[str, MessagePath, ElementCondition]]
) -> ComputedField:
    """Return a function of conditions, each after a word, which is unused for the first."""
    (_, path, condition), *others = conditions
    return ComputedField(
        function, path, condition, tuple(JoinedCondition(*each) for each in others)
    )


def _unnested(text: str) -> UnnestedArray | None:
    try:
        array, variable, *fields = json.loads(text)
    except (ValueError, TypeError, RecursionError):
        return None
    if not all(isinstance(each, str) for each in (array, variable, *fields)):
        return None
    return UnnestedArray(ArrayElements(array, variable), tuple(fields))


def number_of(text: str) -> str:
    """Return the name of a field where a number is needed.

    The texts in structs that are found by keys become numbers.
    """
    field = parse_field(text)
    is_keyed = isinstance(field, MessagePath) and field.is_keyed
    return f'number({field})' if is_keyed else text


def value_text(value: Value) -> str:
    """Return a value as the languages write it."""
    if isinstance(value, bool):
        return 'true' if value else 'false'
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)


def _conditioned(function: str, text: str) -> ComputedField | None:
    conditions: list[tuple[str, MessagePath, ElementCondition]] = []
    word, end = 'and', 0
    while word:
        steps, end = _steps(text, end)
        found = _CONDITION.match(text, end)
        value = None if found is None else _literal(found['value'])
        if not steps or found is None or value is None:
            return None
        condition = ElementCondition(found['operator'], value)
        if condition.fault:
            return None
        conditions.append((word, MessagePath(steps), condition))
        word, end = found['word'] or '', found.end()
    return joined_field(function, conditions)


def _path(text: str) -> MessagePath | None:
    steps, end = _steps(text, 0)
    return MessagePath(steps) if steps and end == len(text) else None


def _steps(text: str, position: int) -> tuple[tuple[PathStep, ...], int]:
    """Return the steps from a position of a text on, and their end; none if they are no path."""
    steps: list[PathStep] = []
    while found := _STEP.match(text, position):
        selector: Selector = None
        if found['index']:
            selector = int(found['index'])
        elif found['colon']:
            start, stop = int(found['start'] or '0'), found['stop']
            selector = ArraySlice(start, None if stop is None else int(stop))
        elif found['value']:
            value = _literal(found['value'])
            if value is None or isinstance(value, float):
                break
            selector = ElementKey(found['key'], value)
        elif found['key']:
            selector = IndexField(found['key'])
        steps.append(PathStep(found['name'], selector))
        position = found.end()
        if not text.startswith('.', position):
            return tuple(steps), position
        position += 1
    return (), 0


def _literal(text: str) -> Value | None:
    if text.startswith('"'):
        try:
            value = str(json.loads(text))
        except ValueError:
            return None
        return None if re.search('[\x00\ud800-\udfff]', value) else value
    if text in {'true', 'false'}:
        return text == 'true'
    if len(text) > _MAX_DIGITS:
        return None
    if set(text) & set('.eE'):
        number = float(text)
        return number if math.isfinite(number) else None
    return int(text)
