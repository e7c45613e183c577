"""Look-up of field paths among the fields of a message or a stream.

A list of fields has all elements of an array as one entry, `covariance[0..35]`, or `ranges[0..]`
if the length of the array differs between messages. Paths and functions of paths (see
`fields`) are listed as the entry of the values that they are made of: `covariance[7]`,
`max(covariance)` and `covariance[0..35]` are one entry; `covariance[36]` is absent.

Messages about an absent path suggest similar ones:

    near_fields(fields, 'twist.linaer.x')   ['twist.twist.linear.x']
    overview(fields, 'twist.twist.up')      'twist.twist has: angular, linear'
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from difflib import SequenceMatcher
from functools import cached_property, lru_cache
from typing import Final, NamedTuple

from dyknow_common.errors import shortened
from dyknow_common.fields import (
    AGGREGATES,
    CONDITIONED,
    INDEX,
    NUMERIC,
    TEXTUAL,
    WKT,
    ArrayElements,
    ArraySlice,
    ComputedField,
    ElementKey,
    IndexField,
    MessagePath,
    UnnestedArray,
    parse_field,
)
from dyknow_common.values import Value, ValueType, with_article

FieldTypes = Mapping[str, ValueType | None]
"""Fields with the types of their values; None for a type that is not known."""

_INDEX = re.compile(r'\[(?P<first>\d+)(\.\.\d*)?\]', re.ASCII)
_MAX_SUGGESTIONS: Final = 4
_OF_MANY: Final = frozenset({*AGGREGATES, WKT})
_NUMBERS: Final = frozenset({ValueType.INT, ValueType.FLOAT})
_STEP_OF_ENTRY: Final = re.compile(r'(?<!\.)\.(?!\.)')
_ENTRY: Final = re.compile(r"[\w']+(\[0\.\.\d*\])?(\.[\w']+(\[0\.\.\d*\])?)*", re.ASCII)

_MAX_MEANT: Final = 3
"""The number of fields that are suggested; if more are as near, none is."""

_MAX_LISTED: Final = 5
_MAX_STEPS: Final = 12
_MAX_COMPARED: Final = 200
"""The length of a path that is compared; the time grows with the product of the lengths."""

_SIMILARITY: Final = 0.6
_FUNCTION: Final = re.compile(r'\s*\w+\s*\(([^)]*)\)?')
_OTHER: Final = re.compile(r'\[[^\]]*\]|[^\w.]', re.ASCII)


class ListedArray(NamedTuple):
    """The entry of a path through arrays.

    Args:
        entry: the entry as it is listed.
        lasts: for each step, the last index of its array; None if it is not an array.
    """

    entry: str
    lasts: tuple[float | None, ...]


class ListedKeys(NamedTuple):
    """The entry of the keys of an array.

    Args:
        entry: as it is listed.
        are_members: True for members of the elements, False for elements of a parallel array.
    """

    entry: str
    are_members: bool


ListedArrays = Mapping[tuple[str, ...], ListedArray]


class _AbsenceError(Exception):
    """The reason why a path is not among some fields; it may be empty."""


def all_elements(array: str, size: int | None) -> str:
    """Return the entry for the elements of an array.

    Args:
        array: the path to the array.
        size: the maximal number of elements; `None` if there is no bound.
    """
    return f'{array}[0..{"" if size is None else size - 1}]'


def listed_as(fields: Collection[str] | FieldTypes, path: str) -> str | None:
    """Return the entry of a path among the fields of a stream; `None` if there is none.

    If the types of the fields are given, there is none for a path that does not fit them either.
    """
    try:
        return _Lookup(fields).entry(path)
    except _AbsenceError:
        return None


def field_type(fields: FieldTypes, path: str) -> ValueType | None:
    """Return the type of the value at a path that is listed; None if it is not known."""
    if path in fields:
        return fields[path]
    field, found = parse_field(path), fields[_Lookup(fields).entry(path)]
    if isinstance(field, UnnestedArray):
        return None
    return _result_type(field.function, found) if isinstance(field, ComputedField) else found


def arrays_of(fields: Collection[str]) -> ListedArrays:
    """Return the listed paths through arrays, by the names of their steps."""
    return dict(_parsed_entry(each) for each in fields if '..' in each and _ENTRY.fullmatch(each))


def key_array(
    arrays: ListedArrays, names: tuple[str, ...], number: int, field: str
) -> ListedKeys | None:
    """Return the keys of an array; None if there are none.

    Args:
        arrays: the listed arrays.
        names: the names of the steps of a path.
        number: the number of the step of the array.
        field: the name of the key.
    """
    key = tuple(field.split('.'))
    member = arrays.get((*names[: number + 1], *key))
    if member is not None and not _has_arrays(member.lasts[number + 1 :]):
        return ListedKeys(member.entry, are_members=True)
    beside = arrays.get((*names[:number], *key))
    if beside is None or beside.lasts[-1] is None or _has_arrays(beside.lasts[number:-1]):
        return None
    return ListedKeys(beside.entry, are_members=False)


def element_fields(fields: FieldTypes, elements: ArrayElements) -> FieldTypes | str:
    """Return the fields of a sample that is made of an element of an array.

    They are the element's, its number, and the message's.

    Args:
        fields: the fields of the message, with their types.
        elements: the array whose elements become samples.

    Returns:
        The fields; or the reason why there are no such elements.
    """
    array, name = parse_field(elements.array), elements.variable
    if any(re.split(r'[.\[]', each)[0] == name for each in fields):
        return f"the message has a field '{name}', too; give the element another name"
    try:
        inside = _Lookup(fields).elements(array) if isinstance(array, MessagePath) else {}
    except _AbsenceError as error:
        return str(error)
    if not inside:
        arrays = sorted({'.'.join(names[:-1] or names) for names in arrays_of(fields)})
        return f"'{elements.array}' is not an array (arrays are in: {', '.join(arrays) or 'none'})"
    found = {f'{name}.{rest}' if rest else name: kind for rest, kind in inside.items()}
    return {**fields, **found, elements.index: ValueType.INT}


def absence(owner: str, fields: Collection[str] | FieldTypes, path: str) -> str:
    """Return the message that a path is not among the fields of a stream or message.

    It suggests what may be meant, or else lists a few fields.

    Args:
        owner: the owner of the fields, `stream 'a'`.
        fields: all fields of the owner.
        path: the path that is not listed.
    """
    lack = f"{owner} has no field '{path}'"
    try:
        _Lookup(fields).entry(path)
    except _AbsenceError as error:
        if str(error):
            return f'{lack}: {error}'
    shape = _shape_of_path(path)
    inside = [each for each in fields if _shape(each).startswith((f'{shape}.', f'{shape}['))]
    if inside:
        return f'{lack}: it is not a single value; ask for {_suggestion(path, shape, inside)}'
    meant = dict.fromkeys(_in_place_of(path, each, fields) for each in near_fields(fields, path))
    if meant:
        return f'{lack}; did you mean {" or ".join(map(repr, meant))}?'
    return f'{lack} ({overview(fields, path)})'


class _Lookup:
    """Looks up paths among some fields; each method raises `_AbsenceError` with the reason."""

    def __init__(self, fields: Collection[str] | FieldTypes) -> None:
        self._fields = fields
        self._types: FieldTypes = fields if isinstance(fields, Mapping) else {}

    @cached_property
    def _arrays(self) -> ListedArrays:
        return arrays_of(self._fields)

    def entry(self, path: str) -> str:
        """Return the entry of a path."""
        if path in self._fields:
            return path
        field = parse_field(path)
        if field is None:
            raise _AbsenceError
        if isinstance(field, MessagePath):
            return self._of_array(field, '')
        if isinstance(field, UnnestedArray):
            return self._of_elements(field)
        if field.function == INDEX:
            raise _AbsenceError(f'{INDEX} takes the element of: each ... as {field.path} in ...')
        entries = [self._argument(each) for each in field.parts]
        for each, found in zip(field.parts, entries, strict=True):
            _check_type(each, found, self._types.get(found))
        if field.others:
            self._check_joined([each.path for each in field.parts])
        return entries[0]

    def _check_joined(self, paths: Sequence[MessagePath]) -> None:
        """Check that values belong together: of members of one array, or of parallel arrays."""
        arrays = []
        for path in paths:
            lasts = self._arrays[path.names].lasts
            many = [each for each in range(len(path.names)) if self._are_many(path, each, lasts)]
            place = many[-1]
            is_last = place == len(path.names) - 1
            # The names of parallel arrays differ.
            name = '' if is_last else path.names[place]
            arrays.append((path.steps[:place], name, path.steps[place].selector))
            if len(many) > 1:
                raise _AbsenceError(f"'{path}' leads through two arrays; ask for a single one")
        if len(set(arrays)) > 1:
            message = f"'{paths[0]}' and '{paths[-1]}' do not belong to the same elements"
            raise _AbsenceError(f'{message}; name members of one array, or parallel arrays')

    def elements(self, array: MessagePath) -> FieldTypes:
        """Return the fields of the elements of an array, by the paths within them."""
        names, many = array.names, False
        found: dict[str, ValueType | None] = {}
        for key, listed in self._arrays.items():
            if key[: len(names)] != names:
                continue
            opened = [self._are_many(array, place, listed.lasts) for place in range(len(names))]
            many = any(opened)
            rest = '.'.join(_STEP_OF_ENTRY.split(listed.entry)[len(names) :])
            found[rest] = self._types.get(listed.entry)
        if found and not many:
            raise _AbsenceError(f"'{array}' is a single element of its array")
        return found

    def _of_elements(self, field: UnnestedArray) -> str:
        inside = element_fields(self._types, field.elements)
        if isinstance(inside, str):
            raise _AbsenceError(inside)
        for each in field.fields:
            if not listed_as(inside, each):
                raise _AbsenceError(absence('a sample of each element', inside, each))
        return next(iter(self._types))

    def _argument(self, field: ComputedField) -> str:
        """Return the entry of the values that a function is given."""
        path = str(field.path)
        if path not in self._fields:
            return self._of_array(field.path, field.function)
        if field.function in _OF_MANY:
            raise _AbsenceError(f"'{path}' is a single value, and {field.function} takes an array")
        return path

    def _of_array(self, path: MessagePath, function: str) -> str:
        names = path.names
        found = self._points(path) if function == WKT else self._arrays.get(names)
        if found is None and function == 'count':
            # Structs can be counted, too.
            inside = (each for key, each in self._arrays.items() if key[: len(names)] == names)
            found = next(inside, None)
        if found is None:
            raise _AbsenceError
        opened = [self._are_many(path, number, found.lasts) for number in range(len(names))]
        if any(opened) is (function in _OF_MANY):
            return found.entry
        if function in _OF_MANY:
            raise _AbsenceError(f"'{path}' is a single value, and {function} takes an array")
        if any(isinstance(step.selector, ArraySlice) for step in path.steps):
            raise _AbsenceError(f'a slice is many values; aggregate them, such as max({path})')
        raise _AbsenceError

    def _points(self, path: MessagePath) -> ListedArray:
        """Return the entry of the first coordinate of an array of points, or of stamped poses."""
        of_points = [(*path.names, axis) for axis in 'xy']
        of_poses = [(*path.names, 'pose', 'position', axis) for axis in 'xy']
        of_poses.append((*path.names, 'header', 'stamp', 'sec'))
        wanted = of_points if of_points[0] in self._arrays else of_poses
        found = [self._arrays[each] for each in wanted if each in self._arrays]
        kinds = {self._types.get(each.entry) for each in found}
        if len(found) < len(wanted) or not kinds <= {None, *_NUMBERS}:
            raise _AbsenceError(f"'{path}' is no array of points or poses, which {WKT} takes")
        return found[0]

    def _are_many(self, path: MessagePath, number: int, lasts: tuple[float | None, ...]) -> bool:
        """Check the selector of a step; return True if it leads to several elements of an array."""
        selector, last, array = path.steps[number].selector, lasts[number], path.before(number)
        if last is None and selector is not None:
            raise _AbsenceError(f"'{array}' is not an array")
        match selector:
            case int(index):
                _check_bound(array, index, last)
            case ElementKey():
                self._check_key(path, number, selector)
            case IndexField(field):
                self._check_field_index(path, number, field)
            case ArraySlice(start, stop):
                if stop is not None and stop <= start:
                    raise _AbsenceError(f'the slice [{selector}] is empty; end it after its start')
                _check_bound(array, start if stop is None else stop - 1, last)
        return last is not None and (selector is None or isinstance(selector, ArraySlice))

    def _check_key(self, path: MessagePath, number: int, key: ElementKey) -> None:
        keys = key_array(self._arrays, path.names, number, key.field)
        if keys is None:
            array, name = path.before(number), key.field
            message = f"the elements of '{array}' have no '{name}', and no array '{name}' is "
            raise _AbsenceError(f'{message}beside it')
        _check_comparable(keys.entry, self._types.get(keys.entry), key.value)

    def _check_field_index(self, path: MessagePath, number: int, field: str) -> None:
        """Check that there is such a field beside an array, and that it is a whole number."""
        names = (*path.names[:number], *field.split('.'))
        entry, array = '.'.join(names), path.before(number)
        if found := self._arrays.get(names):
            entry = '' if _has_arrays(found.lasts[number:]) else found.entry
        if entry not in self._fields:
            near = [each for each in near_fields(self._fields, entry) if '[' not in each]
            hint = f'; did you mean {" or ".join(map(repr, near))}?' if near else ''
            raise _AbsenceError(f"no single '{field}' beside '{array}' gives the number{hint}")
        kind = self._types.get(entry)
        if kind is not None and kind is not ValueType.INT:
            message = f"'{entry}' is {with_article(kind)}, and the number of an element is an int"
            raise _AbsenceError(message)


def _has_arrays(lasts: Iterable[float | None]) -> bool:
    return any(last is not None for last in lasts)


def _check_bound(array: str, index: int, last: float | None) -> None:
    if last is not None and (index if index >= 0 else -index - 1) > last:
        raise _AbsenceError(f"the last element of '{array}' is [{last:.0f}]")


def _check_type(field: ComputedField, entry: str, found: ValueType | None) -> None:
    """Check that a function fits the type of its values."""
    if found is None:
        return
    function, condition, kind = field.function, field.condition, with_article(found)
    # Texts in structs that are found by keys stand for numbers where these are wanted.
    is_text = found is ValueType.STRING and (field.path.is_keyed or function == 'number')
    if function in NUMERIC and found not in _NUMBERS and not is_text:
        raise _AbsenceError(f"'{entry}' is {kind}, and {function} takes numbers")
    if condition is not None and not (is_text and ValueType.of(condition.value) in _NUMBERS):
        _check_comparable(entry, found, condition.value)
    if function in {'any', 'all'} and condition is None and found is not ValueType.BOOLEAN:
        message = f"'{entry}' is {kind}; give a condition, such as {function}({field.path}"
        raise _AbsenceError(f'{message} > 1)')
    if function == 'text' and found not in {ValueType.STRING, ValueType.INT}:
        raise _AbsenceError(f"'{entry}' is {kind}, and text takes an int or a string")


def _check_comparable(entry: str, found: ValueType | None, value: Value) -> None:
    wanted = ValueType.of(value)
    if found is None or found is wanted or {found, wanted} <= _NUMBERS:
        return
    message = f"'{entry}' is {with_article(found)}, which cannot be compared with "
    raise _AbsenceError(f'{message}{with_article(wanted)}')


def _result_type(function: str, found: ValueType | None) -> ValueType | None:
    if function == 'count':
        return ValueType.INT
    if function in TEXTUAL:
        return ValueType.STRING
    if function in CONDITIONED:
        return ValueType.BOOLEAN
    is_text = found is ValueType.STRING
    return ValueType.FLOAT if function == 'mean' or is_text else found


def _parsed_entry(entry: str) -> tuple[tuple[str, ...], ListedArray]:
    steps = [each.partition('[0:') for each in entry.replace('..', ':').split('.')]
    lasts = tuple(
        float(last.rstrip(']') or math.inf) if bracket else None for _, bracket, last in steps
    )
    return tuple(name for name, _, _ in steps), ListedArray(entry, lasts)


def _in_place_of(path: str, entry: str, fields: Collection[str]) -> str:
    """Return a listed path of the entry's names, with the selectors and the function of `path`."""
    field, names = parse_field(path), entry_names(entry)
    if isinstance(field, MessagePath | ComputedField):
        written = field.path if isinstance(field, ComputedField) else field
        if len(names) == len(written.steps):
            pairs = zip(written.steps, names, strict=True)
            renamed = MessagePath(tuple(replace(step, name=name) for step, name in pairs))
            moved = replace(field, path=renamed) if isinstance(field, ComputedField) else renamed
            if listed_as(fields, str(moved)):
                return str(moved)
    return _INDEX.sub(lambda index: f'[{index["first"]}]', entry)


def _shape(path: str) -> str:
    return _INDEX.sub('[]', path)


def _shape_of_path(path: str) -> str:
    field = parse_field(path)
    if not isinstance(field, MessagePath):
        return _shape(path)
    return '.'.join(
        each.name if each.selector is None else f'{each.name}[]' for each in field.steps
    )


def _suggestion(path: str, shape: str, inside: Iterable[str]) -> str:
    known = shape.count('[]')
    paths = []
    for each in inside:
        firsts = [index['first'] for index in _INDEX.finditer(each)][known:]
        tail = _shape(each)[len(shape) :].replace('[]', '[{}]')
        paths.append(path + tail.format(*firsts))
    if len(paths) > _MAX_SUGGESTIONS:
        return f'{", ".join(paths[:_MAX_SUGGESTIONS])}, ...'
    return ' or '.join(filter(None, [', '.join(paths[:-1]), paths[-1]]))


def near_fields(fields: Collection[str], path: str) -> list[str]:
    """Return the fields with the steps most similar to the steps of a path.

    Fields that contain all steps of the path in order count as similar: people leave out steps.

    Args:
        fields: the listed fields.
        path: an absent path, with selectors and functions or without.

    Returns:
        Up to three; none if no field, or more of them, may be meant.
    """
    names = entry_names(path)
    if len(names) > _MAX_STEPS:
        return []
    fits = {each: _fit(names, entry_names(each)) for each in fields}
    best = max(fits.values(), default=0.0)
    meant = sorted(each for each, fit in fits.items() if fit == best)
    return meant if best and len(meant) <= _MAX_MEANT else []


def overview(fields: Collection[str], path: str) -> str:
    """Return what there is where a path leaves the fields: at most five names."""
    names = entry_names(path)
    known = {each: entry_names(each) for each in fields}
    depth = 0
    while depth < len(names) and any(
        len(each) > depth + 1 and each[: depth + 1] == names[: depth + 1] for each in known.values()
    ):
        depth += 1
    inside = {each: steps for each, steps in known.items() if steps[:depth] == names[:depth]}
    owner = '.'.join(names[:depth])
    shown = sorted(inside)
    if owner or len(shown) > _MAX_LISTED:
        steps = {each[depth] for each in inside.values() if len(each) > depth}
        shown = sorted(steps, key=lambda each: (each == 'header', each)) or shown
    more = len(shown) - _MAX_LISTED
    text = ', '.join(map(shortened, shown[:_MAX_LISTED])) or 'none'
    return f'{owner or "it"} has: {text}{f" and {more} more" if more > 0 else ""}'


def entry_names(path: str) -> tuple[str, ...]:
    """Return the names of the steps of a path, without selectors and functions."""
    if len(path) > _MAX_COMPARED:
        return ()
    call = _FUNCTION.fullmatch(path)
    inner = re.split('[<>=!]', call[1])[0] if call else path
    return tuple(filter(None, _OTHER.sub('', inner).split('.')))


def _fit(names: tuple[str, ...], steps: tuple[str, ...]) -> float:
    """Return how similar names are to steps in the same order; 0 if one is to none."""
    if not names:
        return 0.0
    # The best sums for the names so far, by the number of steps that they may be among.
    sums = [0.0] * (len(steps) + 1)
    for name in names:
        found = [float('-inf')]
        for number, step in enumerate(steps):
            found.append(max(found[-1], sums[number] + _similarity(name, step)))
        sums = found
    return max(0.0, sums[-1])


@lru_cache(maxsize=4096)
def _similarity(name: str, step: str) -> float:
    """Return how similar two names are, up to 1; minus infinity if they are not."""
    ratio = SequenceMatcher(None, name.casefold(), step.casefold()).ratio()
    return ratio if ratio >= _SIMILARITY else float('-inf')
