"""Aggregates of arrays, and conversions between texts and numbers.

Arrays are numpy arrays, `array.array` or lists. Arrays of numbers are read by numpy, without a loop
over their elements. NaN is ignored. Comparisons and sums of integers are exact.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import (
    COMPARISONS,
    SECOND_NS,
    ComputedField,
    ElementCondition,
    Value,
    ValueType,
    shortened,
)
from dyknow_space import MAX_VERTICES
from dyknow_stream_processing.sample import AbsentElement

_WIDE: Final = 8
"""The bytes of integers whose sum numpy may not hold."""

_LINE: Final = 'LINESTRING M'

_MAX_INT64: Final = (1 << 63) - 1
_MAX_EXACT: Final = 1 << 53
"""The integers up to this are floats, too."""

MAX_SAMPLES: Final = 10_000
"""The most numbers in the text of `samples`."""


class NoValueError(Exception):
    """The reason why a message has no value at a path."""

    @property
    def reason(self) -> str:
        """Why there is no value."""
        return str(self)


class NoElementError(NoValueError):
    """A message has no element with a key."""

    @property
    def reason(self) -> str:
        """Why there is no value."""
        return AbsentElement(str(self))


def aggregate(field: ComputedField, kind: ValueType | None) -> Callable[[Any], Value]:
    """Return the function of an array that a field without a condition is computed with.

    It raises NoValueError for an array that has no such value.

    Args:
        field: a field with an aggregate.
        kind: the type of the elements; None for structs.
    """
    if field.function == 'count':
        return _count if kind is ValueType.FLOAT else len
    reduce = _REDUCTIONS[field.function]
    return lambda elements: reduce(_vector(elements, kind))


def conditioned(
    field: ComputedField, kinds: Sequence[ValueType | None]
) -> Callable[[Sequence[Any]], Value]:
    """Return the function of arrays, one for each condition, that a field is computed with.

    Their elements belong together by their places. An element is ignored if a value of it is NaN.
    The function raises NoValueError for arrays of different lengths.

    Args:
        field: a field with conditions, or `any` or `all` of booleans.
        kinds: the type of the elements of each array.
    """
    parts, result = field.parts, _RESULTS[field.function]
    conditions = [each.condition or ElementCondition('=', value=True) for each in parts]
    words = ['or', *(each.word for each in field.others)]

    def test(arrays: Sequence[Any]) -> Value:
        count = len(arrays[0])
        for part, elements in zip(parts, arrays, strict=True):
            if len(elements) != count:
                raise NoValueError(
                    f"'{parts[0].path}' has {count} elements and '{part.path}' {len(elements)}, "
                    'so they do not belong together'
                )
        known, found = np.ones(count, np.bool_), np.zeros(count, np.bool_)
        term = found
        for word, condition, kind, elements in zip(words, conditions, kinds, arrays, strict=True):
            truths, usable = _truths(condition, kind, elements)
            known &= usable
            if word == 'or':
                found, term = found | term, truths
            else:
                term = term & truths
        found = (found | term) & known
        return result(int(np.count_nonzero(found)), int(np.count_nonzero(known)))

    return test


def _truths(
    condition: ElementCondition, kind: ValueType | None, elements: Any
) -> tuple[NDArray[Any], NDArray[Any] | bool]:
    """Return for each element the truth of a condition, and True unless it is NaN."""
    compare, wanted = COMPARISONS[condition.operator], condition.value
    if isinstance(wanted, str):
        return np.array([compare(each, wanted) for each in elements], np.bool_), True
    numbers = _vector(elements, kind)
    known = ~np.isnan(numbers) if numbers.dtype.kind == 'f' else True
    return _compared(numbers, compare, wanted), known


def plain(value: Any) -> Any:
    """Convert a value of a message to a value of a sample; a byte is an int."""
    if isinstance(value, bytes):
        return value[0]
    return value.item() if isinstance(value, np.generic) else value


def number(value: Any) -> int | float:
    """Return a number, also of a text; raise NoValueError for a text that is none."""
    value = plain(value)
    if not isinstance(value, str):
        return value  # type: ignore[no-any-return]
    try:
        found = float(value) if value.isascii() and '_' not in value else math.nan
    except ValueError:
        found = math.nan
    if math.isnan(found) or (math.isinf(found) and any(each.isdigit() for each in value)):
        raise NoValueError(f'{shortened(value)!r} is no number')
    return found


def text(value: Any) -> str:
    """Return a text, also of an int."""
    return str(plain(value))


def outline(points: Sequence[Any]) -> str:
    """Return the polygon with some vertices, in well-known text; nothing is repaired.

    Args:
        points: points with x and y, in the order of the boundary; the last may equal the first.

    Raises:
        NoValueError: if they are too many.
    """
    if len(points) > MAX_VERTICES:
        raise NoValueError(f'the polygon has {len(points)} vertices, more than {MAX_VERTICES}')
    ring = [f'{float(each.x)!r} {float(each.y)!r}' for each in points]
    if ring and ring[0] != ring[-1]:
        ring.append(ring[0])
    return f'POLYGON (({", ".join(ring)}))' if ring else 'POLYGON EMPTY'


def line(poses: Sequence[Any]) -> str:
    """Return the line through stamped poses, in well-known text: x, y, the stamp in nanoseconds.

    Raises:
        NoValueError: if they are too many.
    """
    if len(poses) > MAX_VERTICES:
        raise NoValueError(f'the path has {len(poses)} poses, more than {MAX_VERTICES}')
    vertices = []
    for each in poses:
        position, stamp = each.pose.position, each.header.stamp
        time = stamp.sec * SECOND_NS + stamp.nanosec
        vertices.append(f'{float(position.x)!r} {float(position.y)!r} {time}')
    return f'{_LINE} ({", ".join(vertices)})' if vertices else f'{_LINE} EMPTY'


def poses_of_line(text: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the positions of poses, of shape (n, 2), and their stamps; the inverse of `line`.

    Raises:
        ValueError: if the text is no such line.
    """
    name, _, rest = text.partition('(')
    vertices = [each.split() for each in rest.removesuffix(')').split(',') if each]
    if name.split() != f'{_LINE}{"" if vertices else " EMPTY"}'.split():
        raise ValueError(f"'{shortened(text)}' is no path; write wkt(poses) of a nav_msgs/Path")
    points = np.array([(float(x), float(y)) for x, y, _ in vertices], np.float64)
    return points.reshape(-1, 2), np.array([int(time) for *_, time in vertices], np.int64)


def _vector(elements: Any, kind: ValueType | None) -> NDArray[Any]:
    if isinstance(elements, np.ndarray | array):
        return np.asarray(elements)
    if kind is ValueType.STRING:
        return np.array([number(each) for each in elements], np.float64)
    if elements and isinstance(elements[0], bytes):
        return np.frombuffer(b''.join(elements), np.uint8)
    if not len(elements):
        return np.zeros(0, np.int64 if kind is ValueType.INT else np.float64)
    if kind is not ValueType.INT:
        return np.asarray(elements)
    # By itself, numpy makes floats of integers if some need 64 bits without a sign.
    return np.array(elements, np.uint64 if max(elements) > _MAX_INT64 else np.int64)


def _count(elements: Any) -> int:
    numbers = _vector(elements, ValueType.FLOAT)
    return len(numbers) - int(np.count_nonzero(np.isnan(numbers)))


def _extreme(name: str, reduce: Callable[[NDArray[Any]], Any]) -> Callable[[NDArray[Any]], Value]:
    def extreme(numbers: NDArray[Any]) -> Value:
        found: Value = reduce(numbers).item() if len(numbers) else math.nan
        if found != found:  # noqa: PLR0124 - NaN differs from itself
            raise NoValueError(f'there is no number to take the {name} of')
        return found

    return extreme


def _sum(numbers: NDArray[Any]) -> int | float:
    if numbers.dtype.kind != 'f':
        if numbers.itemsize == _WIDE:
            return int(sum(numbers.tolist()))
        return int(np.add.reduce(numbers, dtype=np.int64))
    with np.errstate(all='ignore'):
        total = float(np.add.reduce(numbers, dtype=np.float64))
        if math.isnan(total):
            known = np.where(np.isnan(numbers), 0.0, numbers)
            total = float(np.add.reduce(known, dtype=np.float64))
    if math.isnan(total):
        raise NoValueError('inf and -inf have no sum')
    return total


def _mean(numbers: NDArray[Any]) -> float:
    total, count = _sum(numbers), len(numbers)
    if numbers.dtype.kind == 'f':
        count -= int(np.count_nonzero(np.isnan(numbers)))
    if not count:
        raise NoValueError('there is no number to take the mean of')
    if isinstance(total, float) and math.isinf(total) and not np.isinf(numbers).any():
        # The sum of finite numbers is too large for a float.
        return _sum(numbers / count)
    return total / count


def _samples(numbers: NDArray[Any]) -> str:
    if len(numbers) > MAX_SAMPLES:
        raise NoValueError(f'there are {len(numbers)} samples, more than {MAX_SAMPLES}')
    return ' '.join(map(repr, numbers.tolist()))


def _compared(
    numbers: NDArray[Any], compare: Callable[[Any, Any], Any], wanted: float
) -> NDArray[Any]:
    """Return the result of a comparison for each number; numpy alone would round some."""
    if isinstance(wanted, bool):
        return compare(numbers, wanted)  # type: ignore[no-any-return]
    if numbers.dtype.kind != 'f':
        is_whole = not isinstance(wanted, float) or wanted.is_integer()
        return compare(numbers, int(wanted) if is_whole else np.float64(wanted))  # type: ignore[no-any-return]
    if isinstance(wanted, int) and abs(wanted) > _MAX_EXACT:
        return np.array([compare(each, wanted) for each in numbers.tolist()], np.bool_)
    return compare(numbers, np.float64(wanted))  # type: ignore[no-any-return]


_REDUCTIONS: Final[Mapping[str, Callable[[NDArray[Any]], Value]]] = {
    'min': _extreme('minimum', np.fmin.reduce),
    'max': _extreme('maximum', np.fmax.reduce),
    'mean': _mean,
    'sum': _sum,
    'samples': _samples,
}
_RESULTS: Final[Mapping[str, Callable[[int, int], Value]]] = {
    'count': lambda found, _: found,
    'any': lambda found, _: found > 0,
    'all': lambda found, total: found == total,
}
