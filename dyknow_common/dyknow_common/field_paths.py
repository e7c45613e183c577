"""Paths to single values in a message: `pose.position.z`, `covariance[35]`, `points[2].x`.

A list of fields has all elements of an array as one entry, `covariance[0..35]`, or `ranges[0..]`
if the length of the array differs between messages. The path `covariance[7]` is listed as
`covariance[0..35]`; `covariance[36]` is absent.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Iterator
from typing import Final

_INDEX = re.compile(r'\[(?P<first>\d+)(?P<more>\.\.(?P<last>\d*))?\]', re.ASCII)
_MAX_INDEX_DIGITS: Final = 18
_MAX_SUGGESTIONS: Final = 4


def all_elements(array: str, size: int | None) -> str:
    """Return the entry for the elements of an array.

    Args:
        array: the path to the array.
        size: the maximal number of elements; `None` if there is no bound.
    """
    return f'{array}[0..{"" if size is None else size - 1}]'


def listed_as(fields: Collection[str], path: str) -> str | None:
    """Return the entry of a path among the fields of a stream; `None` if there is none."""
    if path in fields:
        return path
    return next((each for each in fields if _covers(each, path)), None)


def absence(owner: str, fields: Collection[str], path: str) -> str:
    """Return the message that a path is not among the fields of a stream or message.

    Args:
        owner: of the fields, `stream 'a'`.
        fields: all fields of the owner.
        path: the path that is not listed.
    """
    lack = f"{owner} has no field '{path}'"
    shape = _shape(path)
    for each in fields:
        if '..' in each and _shape(each) == shape and (beyond := _beyond(each, path)):
            return f'{lack}: {beyond}'
    inside = [each for each in fields if _shape(each).startswith((f'{shape}.', f'{shape}['))]
    if inside:
        return f'{lack}: it is not a single value; ask for {_suggestion(path, inside)}'
    return f'{lack} (it has: {", ".join(sorted(fields)) or "none"})'


def _shape(path: str) -> str:
    return _INDEX.sub('[]', path)


def _number(index: str) -> float:
    # No array is that long, and Python refuses to convert thousands of digits.
    return int(index) if len(index) <= _MAX_INDEX_DIGITS else math.inf


def _bounds(path: str) -> Iterator[tuple[float, float]]:
    for index in _INDEX.finditer(path):
        first = _number(index['first'])
        last = float(index['last'] or math.inf) if index['more'] else first
        yield first, last


def _covers(listed: str, path: str) -> bool:
    if '..' not in listed or _shape(listed) != _shape(path):
        return False
    pairs = zip(_bounds(listed), _bounds(path), strict=True)
    return all(first <= index <= last and index < math.inf for (first, last), (index, _) in pairs)


def _beyond(listed: str, path: str) -> str | None:
    for index, (_, last) in zip(_INDEX.finditer(path), _bounds(listed), strict=True):
        if _number(index['first']) > last:
            return f"the last element of '{path[: index.start()]}' is [{last:.0f}]"
    return None


def _suggestion(path: str, inside: Iterable[str]) -> str:
    known = len(list(_INDEX.finditer(path)))
    paths = []
    for each in inside:
        firsts = [first for first, _ in _bounds(each)][known:]
        tail = _shape(each)[len(_shape(path)) :].replace('[]', '[{}]')
        paths.append(path + tail.format(*firsts))
    if len(paths) > _MAX_SUGGESTIONS:
        return f'{", ".join(paths[:_MAX_SUGGESTIONS])}, ...'
    return ' or '.join(filter(None, [', '.join(paths[:-1]), paths[-1]]))
