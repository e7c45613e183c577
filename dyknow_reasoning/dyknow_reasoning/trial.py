"""Formulas that are tried at a state, which becomes part of their history only if it is accepted.

A formula without operators of the future is true or false at each state. `holds` says which for a
proposed state, and `accept` adds that state to the history. A state that is not accepted leaves no
trace. Example, `speed < 1 or previous speed > 0.5`:

    proposed      holds               then
    speed = 0.6   yes, it is slow     accepted
    speed = 1.5   yes, it was 0.6     accepted
    speed = 0.2   yes                 not accepted: the history ends with 1.5
    speed = 1.4   yes, it was 1.5     accepted
    speed = 0.3   yes                 accepted
    speed = 1.2   no, it was 0.3

A group (`FormulaGroup`) progresses formulas over states that have happened; it cannot go back.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias, cast

from dyknow_common import PositionedError, shortened
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.language.constants import NO_CONSTANTS, Constants
from dyknow_reasoning.language.formula import (
    Always,
    And,
    CountBound,
    CountOf,
    Equivalent,
    Forall,
    Formula,
    FutureFormula,
    Implies,
    Not,
    Or,
    PastFormula,
    parts,
    walk,
)
from dyknow_reasoning.language.grammar import LANGUAGE
from dyknow_reasoning.language.interval import ALL_FUTURE
from dyknow_reasoning.language.parsing import parse_formula
from dyknow_reasoning.language.quantities import check_units_are_known
from dyknow_reasoning.language.terms import Truth
from dyknow_reasoning.language.type_checking import Kinds, check_types
from dyknow_reasoning.progression.atoms import Values, predicate
from dyknow_reasoning.progression.instances import Domains, ground
from dyknow_reasoning.progression.past_operators import ALL_ROWS, PastMemory, is_dual, memory_of
from dyknow_reasoning.progression.sizes import (
    FormulaLimits,
    check_size,
    formula_size,
    object_counts,
)

_Truth: TypeAlias = Callable[[Sequence[PastMemory], int, Values], bool]
"""The truth of a formula at a state; moves the memories of its past operators to the state."""

_CONNECTIVES: Mapping[type, Callable[[bool, bool], bool]] = {
    And: lambda left, right: left and right,
    Or: lambda left, right: left or right,
    Implies: lambda left, right: not left or right,
    Equivalent: lambda left, right: left is right,
}
_COUNTS: Mapping[CountBound, Callable[[int, int], bool]] = {
    CountBound.AT_LEAST: lambda count, number: count >= number,
    CountBound.AT_MOST: lambda count, number: count <= number,
    CountBound.EXACTLY: lambda count, number: count == number,
}


def asked_of_each_state(formula: Formula) -> Formula:
    """Return a formula without `always` at the outside, or below the outermost `forall`.

    It is what the formula asks of each state: `always p`, asked at every state, would stay violated
    after one state without p, as no later state makes it true.
    """
    match formula:
        case Always(body, interval) if interval == ALL_FUTURE:
            return asked_of_each_state(body)
        case Forall(body=body):
            return replace(formula, body=asked_of_each_state(body))
        case _:
            return formula


def check_trial(text: str, constants: Constants = NO_CONSTANTS) -> Formula:
    """Return the formula of a text, which can be tried at single states.

    Raises:
        LanguageError: with the position, for a text that is not a formula, is badly typed, or looks
            into the future.
    """
    formula = parse_formula(text, constants)
    check_types(formula, text)
    with LANGUAGE.errors_in(text):
        for each in walk(asked_of_each_state(formula)):
            if isinstance(each, FutureFormula):
                raise PositionedError(
                    f"'{shortened(each)}' looks into the future, so no single state decides it; "
                    'use operators of the past, and always only at the outside, without an '
                    'interval',
                    each.position,
                )
    return formula


class TrialFormula:
    """A formula that is tried at proposed states, and the history of those that were accepted.

    Args:
        text: the formula.
        domains: the objects of each sort.
        limits: of its size.

    Raises:
        DyKnowError: for a text that is no such formula, a sort without a domain, or a formula that
            is too large for the domains.
    """

    def __init__(self, text: str, domains: Domains, limits: FormulaLimits | None = None) -> None:
        limits = limits or FormulaLimits()
        formula = check_trial(text)
        check_units_are_known(formula)
        check_size(formula_size(formula, object_counts(domains, limits)), limits)
        self._kinds: Kinds = check_types(formula, text)
        self._memories: list[PastMemory] = []
        self._truth = self._compiled(ground(asked_of_each_state(formula), {}, domains))
        self._proposed: list[PastMemory] = self._memories
        self._latest: int | None = None
        self._time = 0

    def holds(self, time: int, values: Values) -> bool:
        """Return True if the formula holds at a proposed state.

        Args:
            time: of the state, after the latest accepted one; nanoseconds.
            values: a value for each feature of objects, by the text of its `Symbol`.

        Raises:
            ReasoningError: for a state that is not later, lacks a field, or has an unusable value.
        """
        if self._latest is not None and time <= self._latest:
            raise ReasoningError(f'the state at {time} ns is not later than the one before')
        # Until it ends without an error, there is nothing to accept.
        memories = [each.of_row(0) for each in self._memories]
        found = self._truth(memories, time, values)
        self._proposed, self._time = memories, time
        return found

    def accept(self) -> None:
        """Add the state of the latest call of `holds` to the history."""
        self._memories, self._latest = self._proposed, self._time

    def _compiled(self, formula: Formula) -> _Truth:
        """Return the function of a ground formula; all of its parts are read at each state."""
        match formula:
            case Truth(value):
                return lambda _memories, _time, _values: value
            case Not(body):
                inner = self._compiled(body)
                return lambda *state: not inner(*state)
            case And() | Or() | Implies() | Equivalent():
                join = _CONNECTIVES[type(formula)]
                left, right = self._compiled(formula.left), self._compiled(formula.right)
                return lambda *state: join(left(*state), right(*state))
            case CountOf(bound, number, members):
                compare, each = _COUNTS[bound], [self._compiled(member) for member in members]
                return lambda *state: compare(sum([part(*state) for part in each]), number)
            case _ if isinstance(formula, PastFormula):
                return self._remembered(formula)
            case _:
                read = predicate(cast('Any', formula), self._kinds)
                return lambda _memories, _time, values: read(values)

    def _remembered(self, formula: PastFormula) -> _Truth:
        """Return the function of a past operator; its memory follows its operands' memories."""
        sides = [self._compiled(cast('Formula', part)) for part in parts(formula)]
        place, is_negated = len(self._memories), is_dual(formula)
        self._memories.append(memory_of(formula))

        def truth(memories: Sequence[PastMemory], time: int, values: Values) -> bool:
            *lefts, right = [side(memories, time, values) for side in sides]
            lasts = ALL_ROWS if all(lefts) else 0
            return memories[place].step(time, lasts, int(right != is_negated)) != is_negated

        return truth
