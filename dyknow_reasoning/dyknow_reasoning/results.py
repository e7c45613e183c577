"""Formulas of a group, and their results."""

from __future__ import annotations

from dataclasses import dataclass, field

from dyknow_common import Margin, Verdict
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.language.formula import Formula
from dyknow_reasoning.language.type_checking import Kinds, check_asked_once


@dataclass(frozen=True, slots=True)
class NamedFormula:
    """A formula of a group; its `str` is the canonical text.

    Args:
        name: the name that the user gave it.
        formula: its abstract syntax.
        kinds: the kinds of its features.
        every_state: True if it is asked at every state.

    Raises:
        ReasoningError: for a formula that can be asked of one state alone.
    """

    name: str
    formula: Formula
    kinds: Kinds
    every_state: bool = False

    def __post_init__(self) -> None:
        if self.every_state:
            check_asked_once(self.formula)

    def __str__(self) -> str:
        return str(self.formula)


@dataclass(frozen=True, slots=True)
class FormulaResult:
    """The result of one formula.

    Args:
        formula_id: the id of the formula in its group.
        name: the name that the user gave it.
        verdict: undecided if the formula failed.
        decided_at: the valid time of the deciding state in nanoseconds; None if the formula failed
            or needs no state.
        explanation: the reasons, for the operators of the robot; empty if the formula failed.
        error: the reason why the formula failed.
        objects: the objects for which the formula is decided, `u = uav1`; empty if there is no
            choice of them.
        windows: the intervals of the obligations that the explanation names, in nanoseconds.
        ended_at: the valid time of the state with which the formula got its result, also by an
            error; None if it needs no state.
        margin: its margin at that state; None if it was not requested.
    """

    formula_id: int
    name: str
    verdict: Verdict
    decided_at: int | None
    explanation: str
    error: ReasoningError | None = None
    objects: str = ''
    windows: tuple[tuple[int, int], ...] = ()
    ended_at: int | None = field(default=None, compare=False)
    margin: Margin | None = None
