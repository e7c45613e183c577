"""What the verdict of a formula says of a part of its states.

always F, with F about the present and the future    false from a later state: false
the same formula asked at every state                the verdict from each state
eventually[0 s, 5 s] F, or F with past operators     unknown: the states before may decide it
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from dyknow_common import ExitCode
from dyknow_reasoning import (
    Always,
    And,
    Forall,
    Formula,
    Interval,
    PastFormula,
    PastTerm,
    parse_formula,
    parts,
    walk,
)
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.results import FormulaReport


def is_invariant(formula: Formula) -> bool:
    """Return True if the formula is false whenever it is false from a later state on."""
    match formula:
        case Forall():
            return is_invariant(formula.body)
        case And():
            return is_invariant(formula.left) and is_invariant(formula.right)
        case Always():
            return formula.interval == Interval()
    return False


def looks_back(formula: Any) -> bool:
    """Return True if a part of a formula is about the past."""
    return isinstance(formula, PastFormula | PastTerm) or any(map(looks_back, parts(formula)))


def lacking_states(formula: Formula, *, every_state: bool) -> str:
    """Return why a part of the states cannot decide a formula; empty if it can.

    Args:
        formula: the formula.
        every_state: True if it is asked at every state.
    """
    if looks_back(formula):
        return 'looks back to earlier states'
    return '' if every_state or is_invariant(formula) else 'depends on its first state'


def suffix_report(report: FormulaReport, *, every_state: bool) -> FormulaReport:
    """Return the results of a formula over a part of a recording, without unsound verdicts."""
    if report.error is not None:
        return report
    if not (reason := lacking_states(parse_formula(report.formula), every_state=every_state)):
        return report
    error = RecordingError(
        f'the recording is cut from another one, which has states before; the verdict {reason}: '
        'check the other one',
        ExitCode.NOT_FOUND,
    )
    return replace(report, episodes=(), error=error)


def horizon(formula: str) -> int:
    """Return the time that a verdict about one state looks ahead and back at most, nanoseconds.

    Operators without an end are left out.

    Raises:
        DyKnowError: if it is no formula.
    """
    return _horizon(_body(parse_formula(formula)))


def is_bounded(formula: Formula) -> bool:
    """Return True if each operator has an end in what an invariant says of one state."""
    if isinstance(formula, And):
        return is_bounded(formula.left) and is_bounded(formula.right)
    intervals = (getattr(each, 'interval', None) for each in walk(_body(formula)))
    return all(each.end is not None for each in intervals if isinstance(each, Interval))


def _body(formula: Formula) -> Formula:
    """Return what an invariant says of each state."""
    match formula:
        case Forall():
            return _body(formula.body)
        case Always() if formula.interval == Interval():
            return formula.body
    return formula


def _horizon(part: Any) -> int:
    end = interval.end if isinstance(interval := getattr(part, 'interval', None), Interval) else 0
    found = [_horizon(each) for each in parts(part)]
    if isinstance(part, And):
        return max(found)
    return (end or 0) + max(found, default=0)
