"""Values in messages that are found by keys, or computed from arrays.

A message is any object with attributes: from rclpy, or decoded from a recording. A path is taken
apart once, into functions; each function reads the result of the previous one. The functions of
`max(status[name = "lidar"].values.x)` return

    the status whose name is "lidar" -> the `x` of each of its `values` -> the greatest
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from operator import attrgetter
from typing import Any

from dyknow_common import (
    AGGREGATES,
    WKT,
    ArraySlice,
    ComputedField,
    ElementKey,
    FieldTypes,
    IndexField,
    MessagePath,
    PathStep,
    UnnestedArray,
    Value,
    arrays_of,
    element_fields,
    key_array,
    listed,
    listed_as,
    parse_field,
)
from dyknow_stream_processing.aggregates import (
    NoElementError,
    NoValueError,
    aggregate,
    conditioned,
    line,
    number,
    outline,
    plain,
    text,
)
from dyknow_stream_processing.sample import ELEMENTS_OF_MESSAGE, PartialFields, Rows

MAX_ELEMENTS = 10_000
"""The number of samples that are made of one message."""

Reader = Callable[[Any], Any]


def value_reader(fields: FieldTypes, path: str) -> Callable[[Any], Value | Rows]:
    """Return a function that reads a value of a message, or fields of the elements of an array.

    Args:
        fields: the fields of the message type, with their types.
        path: the path of one of the fields.

    Returns:
        The function; it raises NoValueError for a message that has no such value.
    """
    field, entry = parse_field(path), listed_as(fields, path)
    if isinstance(field, UnnestedArray):
        return _rows_reader(fields, field)
    if field is None or entry is None:  # pragma: no cover - callers have looked it up
        raise NoValueError(f"there is no field '{path}'")
    if isinstance(field, MessagePath):
        return _chained(_path_reader(fields, field), plain)
    if field.condition is not None or field.function in {'any', 'all'}:
        return _condition_reader(fields, field)
    read = _path_reader(fields, field.path)
    if field.function == WKT:
        are_points = (*field.path.names, 'x') in arrays_of(fields)
        return _chained(read, outline if are_points else line)
    if field.function not in AGGREGATES:
        return _chained(read, number if field.function == 'number' else text)
    is_struct = field.function == 'count' and field.path.names not in arrays_of(fields)
    return _chained(read, aggregate(field, None if is_struct else fields[entry]))


def _condition_reader(fields: FieldTypes, field: ComputedField) -> Callable[[Any], Value]:
    readers = [_path_reader(fields, each.path) for each in field.parts]
    entries = [listed_as(fields, str(each)) for each in field.parts]
    test = conditioned(field, [fields[each] if each else None for each in entries])
    return lambda message: test([read(message) for read in readers])


def _rows_reader(fields: FieldTypes, unnested: UnnestedArray) -> Callable[[Any], Rows]:
    """Return a function that reads fields of each element of an array of a message.

    It raises NoValueError for a message that has no such array. A row lacks the values that its
    element lacks, with the reasons.

    Args:
        fields: the fields of the message type, with their types.
        unnested: the array and the fields, which the type has.
    """
    elements = unnested.elements
    inside, array = element_fields(fields, elements), parse_field(elements.array)
    if isinstance(inside, str) or not isinstance(array, MessagePath):  # pragma: no cover
        raise NoValueError(f"there are no elements '{elements.array}'")
    read = _path_reader(fields, array)
    readers: dict[str, Reader] = {
        path: attrgetter(path) if path == elements.index else value_reader(inside, path)
        for path in unnested.fields
    }

    def row(message: Any, index: int, element: Any) -> Mapping[str, Value]:
        view = _ElementView(message, {elements.variable: element, elements.index: index})
        found: dict[str, Value] = {}
        reasons: dict[str, str] = {}
        for path, read_value in readers.items():
            try:
                found[path] = read_value(view)
            except NoValueError as error:
                reasons[path] = error.reason
        return PartialFields(found, reasons) if reasons else found

    def rows(message: Any) -> Rows:
        found = read(message)
        if len(found) > MAX_ELEMENTS:
            raise NoValueError(
                f"'{elements.array}' has {len(found)} elements; at most {MAX_ELEMENTS} are samples"
            )
        return [row(message, *each) for each in enumerate(found)]

    return rows


class _ElementView:
    """A message with further attributes: an element of one of its arrays, and its number."""

    def __init__(self, message: Any, attributes: Mapping[str, Any]) -> None:
        self.__dict__.update(attributes)
        self._message = message

    def __getattr__(self, name: str) -> Any:
        return getattr(self._message, name)


def _chained(first: Reader, second: Reader) -> Reader:
    return first if second is _same else lambda message: second(first(message))


def _path_reader(fields: FieldTypes, path: MessagePath) -> Reader:
    """Return a function that reads a value, or the elements that a path leads to."""
    arrays, names = arrays_of(fields), path.names
    found = next((each for key, each in arrays.items() if key[: len(names)] == names), None)
    lasts = found.lasts if found else (None,) * len(names)
    read: Reader = _same
    is_open = False
    for place in reversed(range(len(names))):
        step = path.steps[place]
        if lasts[place] is None:
            read = _chained(attrgetter(step.name), read)
            continue
        match step.selector:
            case int(index):
                read = _chained(_element(step.name, index, path.before(place)), read)
            case IndexField(field):
                read = _chained(_numbered(step.name, field, path.before(place)), read)
            case ElementKey() as key:
                keys = key_array(arrays, names, place, key.field)
                are_members = keys is not None and keys.are_members
                read = _chained(_keyed(step.name, key, path.before(place), are_members), read)
            case _:
                read = _elements(step, path.before(place), read, nested=is_open)
                is_open = True
    return read


def _same(value: Any) -> Any:
    return value


def _element(name: str, index: int, place: str) -> Reader:
    def read(message: Any) -> Any:
        elements = getattr(message, name)
        if not -len(elements) <= index < len(elements):
            raise _missing(place, elements, index)
        return elements[index]

    return read


def _numbered(name: str, field: str, place: str) -> Reader:
    number_of = attrgetter(field)

    def read(message: Any) -> Any:
        elements, index = getattr(message, name), plain(number_of(message))
        if not 0 <= index < len(elements):
            raise _missing(place, elements, f'{field} = {index}')
        return elements[index]

    return read


def _keyed(name: str, key: ElementKey, place: str, are_members: bool) -> Reader:  # noqa: FBT001
    key_of = attrgetter(key.field)

    def read(message: Any) -> Any:
        elements = getattr(message, name)
        keys = [plain(key_of(each)) for each in elements if are_members]
        keys = keys if are_members else [plain(each) for each in key_of(message)]
        if key.value not in keys:
            known = listed(list(dict.fromkeys(map(str, keys)))) or 'none'
            raise NoElementError(f'no element of {place} with {key}{ELEMENTS_OF_MESSAGE}{known}')
        index = keys.index(key.value)
        if index >= len(elements):
            raise _missing(place, elements, index)
        return elements[index]

    return read


def _elements(step: PathStep, place: str, read: Reader, *, nested: bool) -> Reader:
    """Return a function that reads several elements; nested arrays become one list."""
    wanted = step.selector if isinstance(step.selector, ArraySlice) else ArraySlice(0, None)
    start, stop = wanted.start, wanted.stop

    def elements_of(message: Any) -> Any:
        elements = getattr(message, step.name)
        if not start and stop is None:
            return elements
        if len(elements) < (start if stop is None else stop):
            raise _missing(place, elements, (start if stop is None else stop) - 1)
        return elements[start:stop]

    if read is _same:
        return elements_of

    def read_each(message: Any) -> list[Any]:
        found = map(read, elements_of(message))
        return list(chain.from_iterable(found)) if nested else list(found)

    return read_each


def _missing(place: str, elements: Sequence[Any], index: int | str) -> NoValueError:
    count = f'{len(elements)} element{"s" * (len(elements) != 1)}'
    return NoValueError(f"'{place}' has {count}, not one at [{index}]")
