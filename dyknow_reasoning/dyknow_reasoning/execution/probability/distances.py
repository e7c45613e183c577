"""The probability that a point with a normal error is within a distance: certain bounds.

In the axes of its covariances, the coordinates of a point are independent. All axes but the one
with the largest deviation are cut into intervals: a circle into strips, a ball into bars. A strip
has a known chance, and so has the last coordinate to be between the ends of a chord.
This chance grows with the chord, so the longest and the shortest chord of a strip bound it.
Example, with a radius of 1, a deviation of 1 in both axes around the centre, and four strips, where
the probability is 0.3935:

    strip                -1 to -0.5    -0.5 to 0    0 to 0.5    0.5 to 1    all
    its chance           0.150         0.191        0.191       0.150
    of the shorter chord 0             0.614        0.614       0           0.235
    of the longer chord  0.614         0.683        0.683       0.614       0.445
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from math import hypot, isfinite
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from dyknow_common import COMPARISONS, MIRRORED_COMPARISONS
from dyknow_reasoning.errors import ReasoningError, UnusableValueError
from dyknow_reasoning.execution.probability.sums import Sum, sum_of
from dyknow_reasoning.language.formula import Comparison, contains
from dyknow_reasoning.language.terms import Function, Uncertain
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.atoms import Values, term_reader

_Numbers: TypeAlias = npt.NDArray[np.float64]

TOLERANCE: Final = 1e-9
"""The greatest relative error of covariances that are calculated."""

_OPERANDS: Final = {'hypot': 3, 'abs': 1}
"""The functions that are distances from zero, with the most operands that have bounds."""

_EDGES: Final = {0: (0, 0), 1: (33, 300), 2: (17, 60)}
"""The edges in each axis that is cut; the first ones show where the chords change.

Most of the other edges are put there.
"""

_FARTHEST: Final = 9.0
"""Larger deviations are neglected: their chance is 1e-19, less than the rounding error."""


_ROUNDING: Final = 1e-6
"""The greatest effect of rounding in the covariances, as a part of the largest deviation.

Rounding changes a small deviation by at most 1e-7, and at most 9 small deviations count.
"""


@lru_cache(1)
def special_functions() -> Any:
    """Return the module of special functions; raise ReasoningError if it is not installed."""
    try:
        from scipy import special  # noqa: PLC0415 - an optional library
    except ImportError:
        raise ReasoningError(
            'correlated errors, distances and samples need scipy, which is not installed; install '
            'dyknow[probability], or python3-scipy'
        ) from None
    return special


def chance_of_distance(
    operator: str, mean: _Numbers, covariances: _Numbers, distance: float
) -> tuple[float, float] | None:
    """Return bounds of the probability that a distance from zero compares so with a number.

    Args:
        operator: the operator of the comparison.
        mean: up to three coordinates of the point.
        covariances: the covariances of these coordinates.
        distance: the number.

    Returns:
        the bounds; None if no distribution has these covariances.
    """
    scales, axes = np.linalg.eigh(covariances)
    if scales[0] < -TOLERANCE * abs(scales[-1]):
        return None
    deviations = np.sqrt(np.maximum(scales, 0))
    if not deviations[-1]:
        holds = float(COMPARISONS[operator](hypot(*mean), distance))
        return holds, holds
    if operator in {'=', '!='} or distance <= 0:  # A distance is no single number, and above zero.
        holds = float(operator in {'>', '>=', '!='})
        return holds, holds
    lower, upper = _chance_within(axes.T @ mean, deviations, distance)
    return (lower, upper) if operator in {'<', '<='} else (1 - upper, 1 - lower)


class DistanceAtom:
    """A comparison of `hypot` of two or three sums, or of `abs` of one, with a certain number.

    Args:
        atom: the comparison.
        operator: compares the function with the number.
        sums: the operands of the function.
        distance: reads the number.

    Attributes:
        numbers: the uncertain ones.
    """

    def __init__(
        self,
        atom: Comparison,
        operator: str,
        sums: Sequence[Sum],
        distance: Callable[[Values], Any],
    ) -> None:
        special_functions()
        self._atom, self._operator, self._sums, self._distance = atom, operator, sums, distance
        self.numbers = list(dict.fromkeys(each for one in sums for each in one.factors))
        self._factors = np.array(
            [[one.factors.get(each, 0.0) for each in self.numbers] for one in sums]
        )

    def chance(
        self, values: Values, means: Sequence[float], covariances: Sequence[Sequence[float]]
    ) -> tuple[float, float] | None:
        """Return bounds of its probability; None if no distribution has these covariances.

        Args:
            values: the values of the state.
            means: the means of the numbers.
            covariances: the covariance of each pair of numbers.

        Raises:
            ReasoningError: if a side is not finite.
        """
        rest = [sum(factor * read(values) for factor, read in each.rest) for each in self._sums]
        center = self._factors @ means + rest
        distance = float(self._distance(values))
        if not (np.isfinite(center).all() and isfinite(distance)):
            raise UnusableValueError(
                f"the sides of '{self._atom}' are infinite; compare finite numbers"
            )
        sizes = len(means), len(means)  # Numbers that cancel out leave none.
        matrix = self._factors @ np.reshape(covariances, sizes) @ self._factors.T
        return chance_of_distance(self._operator, center, matrix, distance)


def distance_of(atom: Comparison, kinds: Kinds) -> DistanceAtom | None:
    """Return a comparison as a comparison of a distance; None if it does not compare one."""
    mirrored = MIRRORED_COMPARISONS.get(atom.operator, atom.operator)
    for function, other, operator in (
        (atom.left, atom.right, atom.operator),
        (atom.right, atom.left, mirrored),
    ):
        if not isinstance(function, Function) or contains(other, Uncertain):
            continue
        sums = [found for each in function.arguments if (found := sum_of(each, kinds))]
        if len(sums) == len(function.arguments) <= _OPERANDS.get(function.name, 0):
            return DistanceAtom(atom, operator, sums, term_reader(other, kinds))
    return None


def _chance_within(mean: _Numbers, deviations: _Numbers, radius: float) -> tuple[float, float]:
    """Return bounds of the probability of a ball; the last axis has the largest deviation."""
    slack = _ROUNDING * float(deviations[-1])
    axes = list(zip(mean[:-1].tolist(), deviations[:-1].tolist(), strict=True))

    def cells(edges: Sequence[_Numbers]) -> tuple[_Numbers, _Numbers, _Numbers]:
        """Return the chance of each cell, and of its shortest and its longest chord."""
        chances, nearest, farthest = np.array(1.0), np.array(0.0), np.array(0.0)
        for (center, deviation), each in zip(axes, edges, strict=True):
            across = center + deviation * each
            near = np.maximum(np.maximum(across[:-1], -across[1:]) - slack, 0)
            far = np.maximum(across[1:], -across[:-1]) + slack
            chances = np.multiply.outer(chances, _masses(each))
            nearest = np.add.outer(nearest, near * near)
            farthest = np.add.outer(farthest, far * far)
        halves = (np.sqrt(np.maximum(radius * radius - each, 0)) for each in (farthest, nearest))
        shortest, longest = (_chord(mean[-1], deviations[-1], each) for each in halves)
        return chances, shortest, longest

    first, further = _EDGES[len(axes)]
    edges = [np.linspace(*_ends(*each, radius + slack), first) for each in axes]
    chances, shortest, longest = cells(edges)
    gaps = chances * (longest - shortest)
    for index, each in enumerate(edges):
        # The sum of the gaps is least if cells are as many as the roots of the gaps.
        weights = np.sqrt(gaps.sum(axis=tuple({*range(len(axes))} - {index}))) + 1e-12
        places = np.concatenate([[0.0], np.cumsum(weights)]) / np.sum(weights)
        added = np.interp(np.linspace(0.0, 1.0, further), places, each)
        edges[index] = np.sort(np.concatenate([each, added]))
    chances, shortest, longest = cells(edges)
    return float((chances * shortest).sum()), min(1.0, float((chances * longest).sum()))


def _ends(mean: float, deviation: float, radius: float) -> tuple[float, float]:
    """Return the ends of an axis of a ball, in deviations; the whole range without a deviation."""
    if not deviation:
        return -_FARTHEST, _FARTHEST
    ends = np.clip([-radius - mean, radius - mean], *(_FARTHEST * deviation * np.array([-1, 1])))
    return float(ends[0]) / deviation, float(ends[1]) / deviation


def _masses(edges: _Numbers) -> _Numbers:
    """Return the chances of a standard normal number between edges, precisely in the tails."""
    below = special_functions().ndtr
    is_right = edges[:-1] > 0
    first = np.where(is_right, -edges[1:], edges[:-1])
    last = np.where(is_right, -edges[:-1], edges[1:])
    found: _Numbers = below(last) - below(first)
    return found


def _chord(mean: float, deviation: float, halves: _Numbers) -> _Numbers:
    """Return the chances of a normal number to be within half chords around zero."""
    below = special_functions().ndtr
    found: _Numbers = below((halves - mean) / deviation) - below((-halves - mean) / deviation)
    return found
