"""Functions of numbers, over single values and over vectors, with the same results to the bit.

Absolute values, extremes and square roots are exact or rounded correctly, by Python as by numpy.
Other functions differ between the two, so vectors apply the Python function to each element. Only
`hypot` of two operands is the numpy function for single values, too, as it computes the distances
of all pairs of many objects.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from typing import Any, Final, TypeAlias

import numpy as np

from dyknow_reasoning.errors import ReasoningError

EXACT: Final = 1 << 53
"""From this absolute value on, a float cannot hold every integer."""

_PAIR: Final = 2

_Array: TypeAlias = 'np.ndarray[Any, np.dtype[Any]]'
_Number: TypeAlias = int | float


def call_function(name: str, values: Sequence[_Number]) -> _Number:
    """Return the value of a function.

    Raises:
        ReasoningError: if the function has no value.
    """
    try:
        result = _FUNCTIONS[name](*values)
    except (ValueError, ArithmeticError) as error:
        reason = _REASONS.get(name) if isinstance(error, ValueError) else _RANGES.get(str(error))
        raise ReasoningError(reason or str(error)) from None
    if isinstance(result, float) and math.isnan(result):
        raise ReasoningError('not a number')
    return result


def call_function_on_vectors(name: str, vectors: Sequence[Any]) -> _Array:
    """Return the values of a function for vectors and single numbers; NaN where it has none.

    All integers must be smaller than `EXACT`, so that floats hold them exactly.
    """
    with np.errstate(all='ignore'):
        if name in _VECTOR_FUNCTIONS and not (name == 'hypot' and len(vectors) > _PAIR):
            found: _Array = _VECTOR_FUNCTIONS[name](vectors)
            return found
    operands = np.broadcast_arrays(*vectors)
    columns = (operand.ravel().tolist() for operand in operands)
    values = (_value_or_nan(name, each) for each in zip(*columns, strict=True))
    return np.fromiter(values, float, operands[0].size).reshape(operands[0].shape)


def _value_or_nan(name: str, values: Sequence[_Number]) -> _Number:
    try:
        found = _FUNCTIONS[name](*values)
    except (ValueError, ArithmeticError):
        return math.nan
    # The vector holds floats, which would round a larger integer.
    return math.nan if isinstance(found, int) and abs(found) >= EXACT else found


def hypotenuse(*values: _Number) -> float:
    """Return the square root of the sum of squares."""
    found = math.hypot(*values)
    if len(values) > _PAIR or not math.isfinite(found):
        return found
    # For two, the result is numpy's, which may differ in the last bit. It warns of an overflow.
    return float(np.hypot(float(values[0]), float(values[1])))


def _angle_difference(first: _Number, second: _Number) -> float:
    difference = math.remainder(first - second, math.tau)
    return math.pi if difference == -math.pi else difference


def _modulo(first: _Number, second: _Number) -> _Number:
    if not second:
        raise ValueError
    return first % second


def _bit(value: _Number, place: _Number) -> int:
    whole, number = int(value), int(place)
    if whole != value or number != place or whole < 0 or number < 0:
        raise ValueError
    return whole >> number & 1


def _extreme(choose: Callable[..., _Number]) -> Callable[..., _Number]:
    """Return an extreme that is a float if any operand is one, as results of arithmetic are.

    An integer that a float may not hold exactly remains one: rounded, it might be no extreme.
    """

    def chosen(*values: _Number) -> _Number:
        found = choose(values)
        is_mixed = any(isinstance(each, float) for each in values)
        return float(found) if is_mixed and abs(found) < EXACT else found

    return chosen


_FUNCTIONS: Final[Mapping[str, Callable[..., _Number]]] = {
    'abs': abs,
    'min': _extreme(min),
    'max': _extreme(max),
    'sum': lambda *values: reduce(operator.add, values),
    'count': lambda *truths: sum(truths),
    'sqrt': math.sqrt,
    'hypot': hypotenuse,
    'sin': math.sin,
    'cos': math.cos,
    'atan2': math.atan2,
    'angle_difference': _angle_difference,
    'mod': _modulo,
    'bit': _bit,
    'pow': math.pow,
}

_VECTOR_FUNCTIONS: Final[Mapping[str, Callable[[Sequence[Any]], _Array]]] = {
    'abs': lambda vectors: np.abs(vectors[0]),
    'min': lambda vectors: reduce(np.minimum, vectors),
    'max': lambda vectors: reduce(np.maximum, vectors),
    'hypot': lambda vectors: np.hypot(*vectors),
    'sqrt': lambda vectors: np.sqrt(vectors[0]),
}

_REASONS: Final = {
    'sqrt': 'a negative number has no square root',
    **dict.fromkeys(('sin', 'cos', 'angle_difference'), 'an infinite angle has no direction'),
    'mod': 'there is no remainder of a division by zero',
    'bit': 'only whole numbers that are not negative have bits, and places',
    'pow': 'zero has no negative power, and a negative number no power that is not whole',
}

_RANGES: Final = {'math range error': 'the result is too large'}
"""Errors of Python that name no reason."""
