"""Python code that converts messages to the fields of samples and back (paper, section VI).

`generate_conversions` writes the code to a file and `message_conversion` compiles it at run time,
so both behave alike. For a type `my_msgs/msg/Scan` with `string name` and `float32[] ranges`, the
code is, without docstrings:

    def scan_to_fields(message: my_msgs.msg.Scan) -> dict[str, Value]:
        fields: dict[str, Value] = {
            'name': message.name,
        }
        for i, ranges_i in enumerate(message.ranges.tolist()):
            fields[f'ranges[{i}]'] = ranges_i
        return fields

    def scan_from_fields(fields: Mapping[str, Value]) -> my_msgs.msg.Scan:
        writer = MessageWriter(my_msgs.msg.Scan)
        return writer.paths(fields)

Fields that are not given keep their defaults, and an array grows to the highest index given. An
element at the end of an array that holds no value itself, such as an empty `LaserEcho`, leaves no
field and is lost on the way back.

If only certain paths are requested, the first function reads these and omits elements that the
message lacks; the second sets any. Fields that are found by keys or computed from arrays are read
by `with_value`, and cannot be set.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

from rosidl_parser.definition import (
    AbstractGenericString,
    AbstractNestedType,
    AbstractType,
    Array,
    NamespacedType,
)

from dyknow_common import MessagePath, Value, absence, parse_field
from dyknow_common.ros import snake_case
from dyknow_stream_processing.aggregates import NoValueError
from dyknow_stream_processing.language.required_fields import ALL
from dyknow_stream_processing.path_values import value_reader
from dyknow_stream_processing.ros.messages.message_types import (
    check_fields,
    field_types,
    fields_to_read,
    nested_class,
    scalar_fields,
    type_name_of,
)
from dyknow_stream_processing.sample import PartialFields

_LINE_WIDTH: Final = 100
_LIST_ELEMENTS: Final = ('boolean', 'octet', 'char', 'wchar', 'long double')
"""Arrays of these types are lists; arrays of other numbers are `numpy.ndarray` or `array.array`."""

_HELPERS: Final = ('MessageWriter', 'with_value')
_COMMA: Final = re.compile(r', (?![^\[]*\])')
_STEP: Final = re.compile(r'(?P<name>\w+)(\[(?P<index>\d+)\])?', re.ASCII)


def module_text(classes: Iterable[Any], fields: Collection[str] | None, written_by: str) -> str:
    """Return the text of a module with the conversions of several message classes.

    Args:
        classes: message classes with distinct names.
        fields: paths of the fields to convert; None for all.
        written_by: the command that writes the module.

    Raises:
        StreamError: NOT_FOUND, if a message type lacks a field.
    """
    functions = '\n'.join(
        conversion_text(each, fields) for each in sorted(classes, key=type_name_of)
    )
    docstring = f'"""Between messages and the fields of samples.\n\nWritten by: {written_by}\n"""\n'
    return f'{docstring}\n{with_imports(functions)}'


def conversion_text(class_: Any, fields: Collection[str] | None) -> str:
    """Return the text of the two functions of a message class.

    Raises:
        StreamError: NOT_FOUND, if the message type lacks a field.
    """
    if fields is not None:
        check_fields(class_, fields)
    name, type_name = snake_case(class_.__name__), type_name_of(class_)
    annotation = type_name.replace('/', '.')
    reading = _read_all(class_) if fields is None else _read(class_, sorted(fields))
    lines = [
        '',
        f'def {name}_to_fields(message: {annotation}) -> dict[str, Value]:',
        f'    """Return the fields of a {type_name}."""',
        *_indented(reading),
        '',
        '',
        f'def {name}_from_fields(fields: Mapping[str, Value]) -> {annotation}:',
        '    """Return a message with some fields; the others keep their defaults."""',
        f'    writer = MessageWriter({annotation})',
        '    return writer.paths(fields)',
        '',
    ]
    return '\n'.join(each for line in lines for each in _wrapped(line))


def with_imports(functions: str) -> str:
    """Return the text of functions after the imports that they need."""
    # Message types begin with a capital letter, fields do not.
    packages = sorted(set(re.findall(r'(?<![.\w])(\w+)\.msg\.[A-Z]', functions)))
    helpers = [name for name in _HELPERS if f'{name}(' in functions]
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
    """A position in a message: its path `points[{i}]` and its expression `points_i` in Python."""

    path: str
    expression: str

    @property
    def literal(self) -> str:
        return f"{'f' * ('{' in self.path)}'{self.path}'"

    def member(self, name: str) -> _CodePosition:
        path = f'{self.path}.{name}' if self.path else name
        return _CodePosition(path, f'{self.expression}.{name}')

    @property
    def index(self) -> str:
        """The loop variable for the array here."""
        return 'ijkmnopqrstuvwxyz'[self.path.count('{')]

    @property
    def element(self) -> _CodePosition:
        """The position of an element of the array here, in a loop over it."""
        variable = f'{self.expression.rpartition(".")[2]}_{self.index}'
        return _CodePosition(f'{self.path}[{{{self.index}}}]', variable)


_MESSAGE: Final = _CodePosition('', 'message')


def _members(class_: Any, position: _CodePosition) -> Iterator[tuple[_CodePosition, AbstractType]]:
    """Yield the single values and the arrays in a message, in their order."""
    for name, field_type in field_types(class_).items():
        member = position.member(name)
        if isinstance(field_type, NamespacedType):
            yield from _members(nested_class(field_type), member)
        else:
            yield member, field_type


def _read_all(class_: Any) -> list[str]:
    values, loops = _read_members(class_, _MESSAGE)
    if not loops:
        return _dictionary('return', values)
    return [*_dictionary('fields: dict[str, Value] =', values), *loops, 'return fields']


def _read_members(class_: Any, position: _CodePosition) -> tuple[list[tuple[str, str]], list[str]]:
    """Return the single values of a message as dictionary items, and loops over its arrays."""
    values: list[tuple[str, str]] = []
    loops: list[str] = []
    for member, field_type in _members(class_, position):
        if isinstance(field_type, AbstractNestedType):
            loops += _read_array(member, field_type)
        else:
            values.append((member.literal, f'{member.expression}{_octet_index(field_type)}'))
    return values, loops


def _read_array(array: _CodePosition, array_type: AbstractType) -> list[str]:
    element, element_type = array.element, array_type.value_type
    if isinstance(element_type, NamespacedType):
        values, loops = _read_members(nested_class(element_type), element)
        body = [*(_dictionary('fields |=', values) if values else []), *loops]
    else:
        body = [f'fields[{element.literal}] = {element.expression}{_octet_index(element_type)}']
    elements = f'{array.expression}{".tolist()" * _is_compact(element_type)}'
    head = f'for {array.index}, {element.expression} in enumerate({elements}):'
    return [head, *_indented(body)] if body else []


def _read(class_: Any, paths: Iterable[str]) -> list[str]:
    """Return code that reads certain fields; an element may be beyond the end of its array."""
    certain: list[tuple[str, str]] = []
    lines: list[str] = []
    for path in paths:
        if not _is_direct(path):
            lines.append(f'fields = with_value(fields, message, {path!r})')
            continue
        expression, is_certain = _expression(class_, path)
        if is_certain:
            certain.append((f"'{path}'", expression))
            continue
        lines += [
            'try:',
            f"    fields['{path}'] = {expression}",
            'except IndexError:',
            f"    fields = with_value(fields, message, '{path}')",
        ]
    if not lines:
        return _dictionary('return', certain)
    return [*_dictionary('fields: dict[str, Value] =', certain), *lines, 'return fields']


def _is_direct(path: str) -> bool:
    field = parse_field(path)
    return isinstance(field, MessagePath) and field.is_direct


def _expression(class_: Any, path: str) -> tuple[str, bool]:
    """Return the Python expression for a path, and whether every message has the path."""
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
    return f'{expression}{_octet_index(field_type)}', is_certain


def _dictionary(head: str, items: Iterable[tuple[str, str]]) -> list[str]:
    lines = [f'    {path}: {value},' for path, value in items]
    return [f'{head} {{', *lines, '}'] if lines else [f'{head} {{}}']


def _is_compact(element_type: AbstractType) -> bool:
    nested = isinstance(element_type, NamespacedType | AbstractGenericString)
    return not nested and element_type.typename not in _LIST_ELEMENTS


def _octet_index(field_type: AbstractType) -> str:
    """Return the index that makes an int of an octet, which is a `bytes` of length 1."""
    return '[0]' if getattr(field_type, 'typename', '') == 'octet' else ''


def _indented(lines: Iterable[str]) -> list[str]:
    return [f'    {line}' for line in lines]


def _wrapped(line: str) -> list[str]:
    """Return a line as formatters break it if it is too long: within brackets, not in texts."""
    text = line.lstrip()
    if len(line) <= _LINE_WIDTH or text.startswith(("'", "f'", '"', 'fields = with_value(')):
        return [line]
    indent = ' ' * (len(line) - len(line.lstrip()))
    if '(' in line:
        start, _, rest = line.partition('(')
        inner, _, end = rest.rpartition(')')
        separator, splits = ',', _COMMA.split(inner)
    else:
        start, _, inner = line.partition('= ')
        start, end, separator, splits = f'{start}= ', '', '', [inner]
    is_whole = len(f'{indent}    {inner}') <= _LINE_WIDTH and not line.startswith('def ')
    parts = [inner] if is_whole else [f'{each}{separator}' for each in splits]
    return [f'{start}(', *(f'{indent}    {each}' for each in parts), f'{indent}){end}']


@dataclass(frozen=True, slots=True)
class Conversion:
    """The two functions of a message type.

    Args:
        to_fields: returns the fields of a message.
        from_fields: returns a message; raises StreamError for a value that does not fit.
    """

    to_fields: Callable[[Any], dict[str, Value]]
    from_fields: Callable[[Mapping[str, Value]], Any]


def message_conversion(class_: Any, fields: Collection[str] | None = None) -> Conversion:
    """Return the conversion of a message class, for the named fields or for all.

    Raises:
        StreamError: NOT_FOUND, if the message type lacks a field.
    """
    text = with_imports(conversion_text(class_, fields))
    namespace: dict[str, Any] = {}
    exec(compile(text, f'<{type_name_of(class_)}>', 'exec'), namespace)  # noqa: S102
    name = snake_case(class_.__name__)
    return Conversion(namespace[f'{name}_to_fields'], namespace[f'{name}_from_fields'])


def extractor(class_: Any, fields: Collection[str]) -> Callable[[Any], dict[str, Value]]:
    """Return a function that reads the named fields of a message.

    `ALL` among them stands for all but the elements of arrays. A field that the message type lacks
    and an element that a message lacks are left out and explained, see `PartialFields`.
    """
    present = fields_to_read(class_, fields)
    extract = message_conversion(class_, present).to_fields
    absent = set(fields) - {ALL, *present}
    if not absent:
        return extract
    known, name = scalar_fields(class_), type_name_of(class_)
    reasons = {each: absence(name, known, each) for each in absent}

    def extract_and_explain(message: Any) -> PartialFields:
        return PartialFields(extract(message), reasons)

    return extract_and_explain


def with_value(fields: dict[str, Value], message: Any, path: str) -> dict[str, Value]:
    """Return the fields of a sample with one more, or with the reason why the message lacks it."""
    try:
        value = _reader(message.__class__, path)(message)
    except NoValueError as error:
        return PartialFields(fields, {path: error.reason})
    if isinstance(value, list):
        return PartialFields(fields, {}, {path: value})
    fields[path] = value
    return fields


@lru_cache(maxsize=1000)
def _reader(class_: Any, path: str) -> Callable[[Any], Any]:
    return value_reader(scalar_fields(class_), path)
