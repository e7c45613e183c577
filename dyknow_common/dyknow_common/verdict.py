"""Verdicts on formulas."""

from enum import IntEnum


class Verdict(IntEnum):
    """The verdict on a formula; the numbers are those of dyknow_interfaces/msg/FormulaResult."""

    UNDECIDED = 0
    TRUE = 1
    FALSE = 2
