"""The probability that a point with a normal error is within a distance: certain bounds.

In the axes of its covariances, the two coordinates of a point are independent. The circle is cut
into strips across the axis with the larger deviation. The chance of a strip is known, and so is the
chance of the other coordinate to be between the ends of a chord. It grows with the chord, so the
longest and the shortest chord of each strip bound the probability. Example, with a radius of 1, a
deviation of 1 in both axes around the centre, and four strips, where the probability is 0.3935:

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
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.probability.sums import Sum, sum_of
from dyknow_reasoning.language.formula import Comparison, walk
from dyknow_reasoning.language.terms import Function, Uncertain
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.atoms import Values, term_reader

_Numbers: TypeAlias = npt.NDArray[np.float64]

TOLERANCE: Final = 1e-9
"""The greatest relative error of covariances that are calculated."""

_OPERANDS: Final = {'hypot': 2, 'abs': 1}
"""The functions that are distances from zero."""

_STRIPS: Final = 400
_FIRST_STRIPS: Final = 64
"""They show where the chords change; most of the final strips are put there."""

_FARTHEST: Final = 9.0
"""The deviations beyond which nothing is: the chance is 1e-19, less than that of rounding."""


_ROUNDING: Final = 1e-6
"""What the rounding of the covariances may change, in the larger deviation.

It changes a small deviation by at most 1e-7, and there are no more than 9 of these.
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
        operator: of the comparison.
        mean: one or two coordinates of the point.
        covariances: of these.
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
    """A comparison of `hypot` of two sums, or of `abs` of one, with a certain number.

    Args:
        atom: the comparison.
        operator: of the function with the number.
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
            values: of the state.
            means: of the numbers.
            covariances: of each with each.

        Raises:
            ReasoningError: if a side is not finite.
        """
        rest = [sum(factor * read(values) for factor, read in each.rest) for each in self._sums]
        center = self._factors @ means + rest
        distance = float(self._distance(values))
        if not (np.isfinite(center).all() and isfinite(distance)):
            raise ReasoningError(
                f"the sides of '{self._atom}' are infinite; compare finite numbers"
            )
        matrix = self._factors @ covariances @ self._factors.T
        return chance_of_distance(self._operator, center, matrix, distance)


def distance_of(atom: Comparison, kinds: Kinds) -> DistanceAtom | None:
    """Return a comparison as that of a distance; None if it is none."""
    mirrored = MIRRORED_COMPARISONS.get(atom.operator, atom.operator)
    for function, other, operator in (
        (atom.left, atom.right, atom.operator),
        (atom.right, atom.left, mirrored),
    ):
        if not isinstance(function, Function) or any(isinstance(e, Uncertain) for e in walk(other)):
            continue
        sums = [found for each in function.arguments if (found := sum_of(each, kinds))]
        if len(sums) == len(function.arguments) == _OPERANDS.get(function.name):
            return DistanceAtom(atom, operator, sums, term_reader(other, kinds))
    return None


def _chance_within(mean: _Numbers, deviations: _Numbers, radius: float) -> tuple[float, float]:
    """Return bounds of the probability of a circle; the last axis has the largest deviation."""
    center, deviation = float(mean[-1]), float(deviations[-1])
    first, last = np.clip(
        [(-radius - center) / deviation, (radius - center) / deviation], -_FARTHEST, _FARTHEST
    )
    if len(mean) == 1:
        (found,) = _masses(np.array([first, last]))
        return float(found), float(found)
    slack = _ROUNDING * deviation

    def strips(edges: _Numbers) -> tuple[_Numbers, _Numbers, _Numbers]:
        """Return the chance of each strip, and of its shortest and its longest chord."""
        across = center + deviation * edges
        halves = np.sqrt(np.maximum(radius * radius - across * across, 0))
        longest = np.maximum(halves[1:], halves[:-1])
        longest[(across[1:] > 0) & (across[:-1] < 0)] = radius
        shortest = np.maximum(np.minimum(halves[1:], halves[:-1]) - slack, 0)
        axis = float(mean[0]), float(deviations[0])
        return _masses(edges), _chord(*axis, shortest), _chord(*axis, longest + slack)

    edges = np.linspace(first, last, _FIRST_STRIPS + 1)
    masses, shortest, longest = strips(edges)
    # The sum of the gaps is least if strips are as many as the roots of the gaps.
    weights = np.sqrt(masses * (longest - shortest)) + 1e-12
    places = np.concatenate([[0.0], np.cumsum(weights)]) / np.sum(weights)
    further = np.interp(np.linspace(0.0, 1.0, _STRIPS), places, edges)
    masses, shortest, longest = strips(np.sort(np.concatenate([edges, further])))
    return float(masses @ shortest), min(1.0, float(masses @ longest))


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
    if not deviation:
        return (abs(mean) <= halves).astype(np.float64)
    below = special_functions().ndtr
    with np.errstate(over='ignore'):
        found: _Numbers = below((halves - mean) / deviation) - below((-halves - mean) / deviation)
    return found
