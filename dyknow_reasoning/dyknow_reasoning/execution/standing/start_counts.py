"""The numbers of states from which a formula has each verdict."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class StartCounts:
    """The numbers of start states, by their verdicts.

    Args:
        holds: from which the formula is true.
        fails: from which it is false.
        undecided: from which it is undecided yet.
        unknown: from which its verdict depends on states that are missing in a gap.
    """

    holds: int = 0
    fails: int = 0
    undecided: int = 0
    unknown: int = 0
