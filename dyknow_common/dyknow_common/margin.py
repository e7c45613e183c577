"""Margins of formulas."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf


@dataclass(frozen=True, slots=True)
class Margin:
    """How far a formula is from the change of its verdict (its robustness).

    Above zero the formula is true, below zero false. The bounds are equal once no further state
    changes them.

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
