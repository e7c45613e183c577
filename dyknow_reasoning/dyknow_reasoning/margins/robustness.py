"""Margins of one object or of many, and their order.

A *margin* is a number that is above zero only if a formula is true, and below zero only if it is
false: `x > 5` has the margin x - 5, `and` and `always` the least margin of their parts.

Margins of many objects are an array of complex numbers: the margin, and the number of its
comparison as the imaginary part. Numpy orders such numbers as Python orders tuples of both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from operator import gt, lt
from typing import Any, TypeAlias

import numpy as np

Robustness: TypeAlias = tuple[float, int]
"""A margin, and the number of the comparison with this margin; -1 if there is none."""

HIGHEST: Robustness = inf, -1
LOWEST: Robustness = -inf, -1


@dataclass(frozen=True, slots=True)
class Extremum:
    """Choice of the least or of the greatest margin.

    Attributes:
        better: returns the margin of two that counts.
        worse: returns the other one.
        is_worse: returns True if the first margin of two for one object is the worse one.
        neutral: the margin of an empty choice.
        decisive: the margin that decides, whatever the other ones are.
    """

    better: Callable[[Any, Any], Any]
    worse: Callable[[Any, Any], Any]
    is_worse: Callable[[Robustness, Robustness], bool]
    neutral: Any
    decisive: Robustness


def extremum(*, universal: bool, width: int = 1) -> Extremum:
    """Return the choice of the least margin if universal, else of the greatest one.

    Args:
        universal: True for operators such as `always`.
        width: the number of objects.
    """
    least, greatest = (min, max) if width == 1 else (np.minimum, np.maximum)
    if universal:
        return Extremum(least, greatest, gt, of_all(HIGHEST, width), LOWEST)
    return Extremum(greatest, least, lt, of_all(LOWEST, width), HIGHEST)


def of_all(margin: Robustness, width: int) -> Any:
    """Return one margin for all objects."""
    return margin if width == 1 else np.full(width, _complex(margin))


def vector(margins: Sequence[Robustness]) -> Any:
    """Return the margins of many objects as one array."""
    return np.array([_complex(each) for each in margins])


def scalar(margin: Any) -> Robustness:
    """Return the margin of one object of an array."""
    return float(margin.real), int(margin.imag)


class MarginThreshold:
    """A limit of margins, with the direction in which they may be inexact.

    Margins *reach* the limit if they are at it or beyond it, in the direction of `unknown`.

    Args:
        limit: the limit.
        unknown: the margin of all that is unknown: `LOWEST` for lower bounds, else `HIGHEST`.

    Attributes:
        guards: conditions on the margins of the comparisons at each later state; while they hold,
            the result stays true.
    """

    def __init__(self, limit: Robustness, unknown: Robustness) -> None:
        self.limit = limit
        self.unknown = unknown
        self.guards: list[Callable[[Sequence[Any]], bool]] = []

    def reached_by(self, margin: Any) -> bool:
        """Return True if the margin of each object reaches the limit."""
        limit, is_upper = self.limit, self.unknown is HIGHEST
        if isinstance(margin, tuple):
            return margin >= limit if is_upper else margin <= limit
        reached = margin >= _complex(limit) if is_upper else margin <= _complex(limit)
        return bool(reached.all())


def as_float(value: float) -> float:
    """Return a number as a float, never as -0.0; integers may be too large for one."""
    try:
        return float(value) + 0.0
    except OverflowError:
        return inf if value > 0 else -inf


def at_least(number: int, count: int, width: int) -> Callable[[Any], Any]:
    """Return a function of margins that returns the margin of "at least a number of them hold".

    Args:
        number: the number, at least 1.
        count: the number of margins, not less than `number`; they are given as one sequence.
        width: the number of objects of each margin.
    """
    if width > 1 and count == 2:  # noqa: PLR2004 - faster than to reduce them
        choose = np.maximum if number == 1 else np.minimum
        return lambda margins: choose(*margins)
    if number in {1, count}:
        least, greatest = (min, max) if width == 1 else (np.minimum.reduce, np.maximum.reduce)
        return greatest if number == 1 else least
    if width == 1:
        return lambda margins: sorted(margins)[-number]
    return lambda margins: np.sort(margins, axis=0)[-number]


def _complex(margin: Robustness) -> complex:
    return complex(as_float(margin[0]), margin[1])
