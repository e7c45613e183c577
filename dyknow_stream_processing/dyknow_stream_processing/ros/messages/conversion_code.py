"""Python that converts messages to the fields of samples and back (paper, section VI).

The same text is written to a file by `generate_conversions` and compiled at run time, so that the
two cannot differ. Of each message type it has two functions, here of sensor_msgs/msg/LaserScan:

- `laser_scan_to_fields` makes a field of every single value: of nested messages by dotted paths,
  `header.stamp.sec`, and of each element of an array, whether its length is fixed or not, by its
  index, `ranges[0]`. A byte is an int.
- `laser_scan_from_fields` makes a message. What is not given keeps its default, and an array grows
  to the highest index that is given. An int may stand for a float, and nothing else for another.
  What does not fit is an error that names the field, its value and the type.

Back and forth, a message is the same again, but for elements at the end of an array that hold no
value themselves, such as an empty `LaserEcho`: they leave no trace among the fields.

Where certain paths are asked for, the first function reads just those, and leaves out an element
that the message does not have; the second sets just those, in an array at any index.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

from rosidl_parser.definition import (
    AbstractGenericString,
    AbstractNestedType,
    AbstractType,
    Array,
    NamespacedType,
)

from dyknow_common.ros import snake_case
from dyknow_stream_processing.ros.messages.message_types import (
    check_fields,
    field_types,
    largest_size,
    nested_class,
    type_name_of,
)

_WIDTH: Final = 100
_LISTS: Final = ('boolean', 'octet', 'char', 'wchar')
"""Arrays of these are lists, of other numbers arrays of numpy or Python."""

_COMMA = re.compile(r', (?![^\[]*\])')
_STEP = re.compile(r'(?P<name>\w+)(\[(?P<index>\d+)\])?', re.ASCII)


def module_text(classes: Iterable[Any], fields: Collection[str] | None, written_by: str) -> str:
    """The text of a module with the conversions of several message classes.

    Args:
        classes: of messages; their names differ.
        fields: paths to the fields to convert; None for all.
        written_by: the command that it is written by.

    Raises:
        StreamError: NOT_FOUND, for a field that a message type does not have.
    """
    classes = sorted(classes, key=type_name_of)
    functions = '\n'.join(conversion_text(each, fields) for each in classes)
    docstring = f'"""Between messages and the fields of samples.\n\nWritten by: {written_by}\n"""\n'
    return f'{docstring}\n{with_imports(functions)}'


def conversion_text(class_: Any, fields: Collection[str] | None) -> str:
    """The text of the two functions of a message class.

    Raises:
        StreamError: NOT_FOUND, for a field that the message type does not have.
    """
    if fields is not None:
        check_fields(class_, fields)
    name, type_name = snake_case(class_.__name__), type_name_of(class_)
    annotation = _class_text(class_)
    reading = _read_all(class_) if fields is None else _read(class_, sorted(fields))
    shapes = None if fields is None else frozenset(re.sub(r'\d+(?=\])', '', f) for f in fields)
    lines = [
        '',
        f'def {name}_to_fields(message: {annotation}) -> dict[str, Value]:',
        f'    """The fields of {type_name}."""',
        *_indented(reading),
        '',
        '',
        f'def {name}_from_fields(fields: Mapping[str, Value]) -> {annotation}:',
        '    """The message of some fields; the others keep their defaults."""',
        f'    message = {annotation}()',
        '    reader = FieldReader(fields)',
        *_indented(_set(class_, _CodePosition('', 'message'), shapes)),
        '    reader.finish(message)',
        '    return message',
        '',
    ]
    return '\n'.join(each for line in lines for each in _wrapped(line))


def with_imports(functions: str) -> str:
    """The text of functions after the imports that they need."""
    # Types of messages begin with a capital letter, and fields do not.
    packages = sorted(set(re.findall(r'(?<![.\w])(\w+)\.msg\.[A-Z]', functions)))
    helpers = [name for name in ('FieldReader', 'without_element') if f'{name}(' in functions]
    lines = [
        'from collections.abc import Mapping',
        '',
        *(f'import {package}.msg' for package in packages),
        'from dyknow_common import Value',
        f'from dyknow_stream_processing.ros import {", ".join(helpers)}',
        '',
    ]
    return '\n'.join([*lines, functions])


@dataclass(frozen=True, slots=True)
class _CodePosition:
    """A place in a message.

    Args:
        path: to it; indexes are variables, `points[{i}]`.
        expression: what it is in Python, `points_i`.
        depth: within how many arrays it is.
    """

    path: str
    expression: str
    depth: int = 0

    @property
    def literal(self) -> str:
        """The path as Python."""
        return f"{'f' * (self.depth > 0)}'{self.path}'"

    @property
    def shape(self) -> str:
        """The path without indexes."""
        return re.sub(r'{\w}', '', self.path)

    def member(self, name: str) -> _CodePosition:
        """A member of the message at this place."""
        path = f'{self.path}.{name}' if self.path else name
        return _CodePosition(path, f'{self.expression}.{name}', self.depth)

    @property
    def index(self) -> str:
        """The variable that counts the elements of the array at this place."""
        return 'ijkmnopqrstuvwxyz'[self.depth]

    @property
    def element(self) -> _CodePosition:
        """An element of the array at this place, in a loop over it."""
        variable = f'{self.expression.rpartition(".")[2]}_{self.index}'
        return _CodePosition(f'{self.path}[{{{self.index}}}]', variable, self.depth + 1)


def _members(class_: Any, place: _CodePosition) -> Iterator[tuple[_CodePosition, AbstractType]]:
    """The single values and the arrays in a message, in their order."""
    for name, field_type in field_types(class_).items():
        member = place.member(name)
        if isinstance(field_type, NamespacedType):
            yield from _members(nested_class(field_type), member)
        else:
            yield member, field_type


def _read_all(class_: Any) -> list[str]:
    members = list(_members(class_, _CodePosition('', 'message')))
    arrays = [each for each in members if isinstance(each[1], AbstractNestedType)]
    values = [_item(*each) for each in members if each not in arrays]
    if not arrays:
        return _dictionary('return', values)
    loops = [line for each in arrays for line in _read_array(*each)]
    return [*_dictionary('fields: dict[str, Value] =', values), *loops, 'return fields']


def _read_array(array: _CodePosition, array_type: AbstractType) -> list[str]:
    element, element_type = array.element, array_type.value_type
    if isinstance(element_type, NamespacedType):
        members = list(_members(nested_class(element_type), element))
        arrays = [each for each in members if isinstance(each[1], AbstractNestedType)]
        values = [_item(*each) for each in members if each not in arrays]
        body = _dictionary('fields |=', values) if values else []
        body += [line for each in arrays for line in _read_array(*each)]
    else:
        path, value = _item(element, element_type)
        body = [f'fields[{path}] = {value}']
    elements = f'{array.expression}{".tolist()" * _is_compact(element_type)}'
    head = f'for {array.index}, {element.expression} in enumerate({elements}):'
    return [head, *_indented(body)] if body else []


def _item(place: _CodePosition, field_type: AbstractType) -> tuple[str, str]:
    return place.literal, f'{place.expression}{"[0]" * _is_octet(field_type)}'


def _read(class_: Any, paths: Iterable[str]) -> list[str]:
    """Reads certain fields; an element may be beyond the end of its array."""
    certain: list[tuple[str, str]] = []
    uncertain: list[tuple[str, str]] = []
    for path in paths:
        expression, is_certain = _expression(class_, path)
        (certain if is_certain else uncertain).append((f"'{path}'", expression))
    if not uncertain:
        return _dictionary('return', certain)
    lines = _dictionary('fields: dict[str, Value] =', certain)
    for path, expression in uncertain:
        lines += [
            'try:',
            f'    fields[{path}] = {expression}',
            'except IndexError:',
            f'    fields = without_element(fields, message, {path})',
        ]
    return [*lines, 'return fields']


def _expression(class_: Any, path: str) -> tuple[str, bool]:
    """A path in Python, and whether every message has it."""
    expression, is_certain, field_type = 'message', True, None
    for step in _STEP.finditer(path):
        field_type = field_types(class_)[step['name']]
        expression += f'.{step["name"]}'
        if isinstance(field_type, AbstractNestedType):
            is_fixed = isinstance(field_type, Array)
            is_certain = is_certain and is_fixed
            field_type = field_type.value_type
            is_numpy = is_fixed and _is_compact(field_type)
            expression += f'.item({step["index"]})' if is_numpy else f'[{step["index"]}]'
        if isinstance(field_type, NamespacedType):
            class_ = nested_class(field_type)
    return f'{expression}{"[0]" * _is_octet(field_type)}', is_certain


def _dictionary(head: str, items: Iterable[tuple[str, str]]) -> list[str]:
    lines = [f'    {path}: {value},' for path, value in items]
    return [f'{head} {{', *lines, '}'] if lines else [f'{head} {{}}']


def _set(class_: Any, place: _CodePosition, shapes: Collection[str] | None) -> list[str]:
    lines: list[str] = []
    for member, field_type in _members(class_, place):
        if shapes is not None and not any(_is_within(each, member.shape) for each in shapes):
            continue
        if isinstance(field_type, AbstractNestedType):
            lines += _set_array(member, field_type, shapes)
        else:
            lines.append(f'if {member.literal} in reader:')
            lines.append(f'    {member.expression} = {_value(member, field_type)}')
    return lines


def _set_array(
    array: _CodePosition, array_type: AbstractType, shapes: Collection[str] | None
) -> list[str]:
    element, element_type = array.element, array_type.value_type
    at_index = f'{array.expression}[{array.index}]'
    if isinstance(element_type, NamespacedType):
        body = _set(nested_class(element_type), element, shapes)
        body = [f'{element.expression} = {at_index}', *body] if body else []
    else:
        body = [f'{at_index} = {_value(element, element_type)}']
    arguments = [array.literal, array.expression]
    if not isinstance(array_type, Array):
        arguments.append(_blank(element_type))
        if largest_size(array_type) is not None:
            arguments.append(str(largest_size(array_type)))
    head = f'for {array.index} in reader.indexes({", ".join(arguments)}):'
    return [head, *_indented(body)] if body else []


def _value(place: _CodePosition, field_type: AbstractType) -> str:
    """How to take a value from the fields."""
    if isinstance(field_type, AbstractGenericString):
        bounded = getattr(field_type, 'maximum_size', None)
        longest = '' if bounded is None else f', {bounded}'
        return f'reader.string({place.literal}{longest})'
    kind = field_type.typename
    if kind in {'float', 'double'}:
        return f"reader.real({place.literal}, '{kind}')"
    methods = {'boolean': 'boolean', 'octet': 'octet', 'char': 'character', 'wchar': 'character'}
    if kind in methods:
        return f'reader.{methods[kind]}({place.literal})'
    return f"reader.integer({place.literal}, '{kind}')"


def _blank(element_type: AbstractType) -> str:
    """What makes an element with its default value."""
    if isinstance(element_type, NamespacedType):
        return _class_text(nested_class(element_type))
    if isinstance(element_type, AbstractGenericString):
        return 'str'
    makers = {'float': 'float', 'double': 'float', 'boolean': 'bool', 'octet': 'lambda: bytes(1)'}
    characters = dict.fromkeys(('char', 'wchar'), r"lambda: '\0'")
    return {**makers, **characters}.get(element_type.typename, 'int')


def _class_text(class_: Any) -> str:
    return type_name_of(class_).replace('/', '.')


def _is_compact(element_type: AbstractType) -> bool:
    nested = isinstance(element_type, NamespacedType | AbstractGenericString)
    return not nested and element_type.typename not in _LISTS


def _is_octet(field_type: AbstractType) -> bool:
    return getattr(field_type, 'typename', '') == 'octet'


def _is_within(shape: str, outer: str) -> bool:
    return shape == outer or shape.startswith((f'{outer}.', f'{outer}['))


def _indented(lines: Iterable[str]) -> list[str]:
    return [f'    {line}' for line in lines]


def _wrapped(line: str) -> list[str]:
    """A line as formatters break it where it is too long: within brackets."""
    if len(line) <= _WIDTH or line.lstrip().startswith(("'", "f'", '"')):
        return [line]
    indent = ' ' * (len(line) - len(line.lstrip()))
    if '(' in line:
        start, _, rest = line.partition('(')
        inner, _, end = rest.rpartition(')')
        separator, splits = ',', _COMMA.split(inner)
    elif ' = ' in line:
        start, _, inner = line.partition('= ')
        start, end, separator, splits = f'{start}= ', '', '', [inner]
    else:
        inner = line.strip().removeprefix('if ').removesuffix(':')
        start, end, separator = f'{indent}if ', ':', ''
        path, _, reader = inner.partition(' in ')
        splits = [path, f'in {reader}']
    is_whole = len(f'{indent}    {inner}') <= _WIDTH and not line.startswith('def ')
    parts = [inner] if is_whole else [f'{each}{separator}' for each in splits]
    return [f'{start}(', *(f'{indent}    {each}' for each in parts), f'{indent}){end}']
