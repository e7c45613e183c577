"""Verdicts on formulas, and their margins."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from math import ceil, floor, inf, isfinite
from typing import Any, Final

_SHOWN: Final = 1_000_000
"""Bounds of probabilities are shown in multiples of its inverse."""

_SAME: Final = 1e-9

_BAR: Final = 10
"""The number of characters of the bar of a probability."""


class Verdict(IntEnum):
    """The verdict on a formula; numbers as in dyknow_interfaces/msg/FormulaResult."""

    UNDECIDED = 0
    TRUE = 1
    FALSE = 2


@dataclass(frozen=True, slots=True)
class Margin:
    """Distance of a formula from the change of its verdict (its robustness).

    Above zero the formula is true, below zero false. The bounds are equal once no further state
    changes them. `str` is for people: `2.5 W (Power[uav1] > 150)`, `at most 3 m (...)`.

    Args:
        lower: the least margin that is still possible.
        upper: the greatest one.
        unit: of the comparison; empty for a number without a unit.
        atom: the comparison that limits the margin; empty if none does.
    """

    lower: float = -inf
    upper: float = inf
    unit: str = ''
    atom: str = ''

    @property
    def document(self) -> dict[str, Any]:
        """The margin for JSON, which has no infinite numbers: these are texts."""
        bounds = {'lower': self.lower, 'upper': self.upper}
        finite = {name: each if isfinite(each) else str(each) for name, each in bounds.items()}
        return {**finite, 'unit': self.unit, 'atom': self.atom}

    def __str__(self) -> str:
        unit = f' {self.unit}' if self.unit else ''
        atom = f' ({self.atom})' if self.atom else ''
        if self.lower == self.upper:
            return f'{self.lower:.6g}{unit}{atom}'
        if self.lower == -inf:
            return 'unknown' if self.upper == inf else f'at most {self.upper:.6g}{unit}{atom}'
        if self.upper == inf:
            return f'at least {self.lower:.6g}{unit}{atom}'
        return f'{self.lower:.6g} to {self.upper:.6g}{unit}{atom}'


@dataclass(frozen=True, slots=True)
class ProbabilityInterval:
    """Bounds of the probability of a formula, with what they assume.

    `str` is for people: `at least 0.987, assuming nothing about correlation`.

    Args:
        lower: the least probability that is possible.
        upper: the greatest one.
        assumption: of the bounds, in words.
    """

    lower: float
    upper: float
    assumption: str

    @property
    def document(self) -> dict[str, Any]:
        """The interval for JSON."""
        return {'lower': self.lower, 'upper': self.upper, 'assumption': self.assumption}

    def __str__(self) -> str:
        return f'{self.bounds}, {self.assumption}'

    @property
    def bar(self) -> str:
        """The interval as a bar: full up to the lower bound, half full up to the upper one."""
        # Bounds are rounded outwards here, too.
        full, end = floor(self.lower * _BAR + _SAME), ceil(self.upper * _BAR - _SAME)
        return '█' * full + '▒' * (end - full) + '░' * (_BAR - end)

    @property
    def bounds(self) -> str:
        """The bounds for people, without the assumption."""
        # Bounds are rounded outwards: 0.9999996 is not 1.
        if self.upper - self.lower < _SAME:
            shown = f'{self.lower:.6g}'
            return f'{self.lower:.10g}' if shown == '1' else shown
        lower, upper = floor(self.lower * _SHOWN) / _SHOWN, ceil(self.upper * _SHOWN) / _SHOWN
        if lower <= 0:
            return 'unknown' if upper >= 1 else f'at most {upper:g}'
        return f'at least {lower:g}' if upper >= 1 else f'{lower:g} to {upper:g}'
