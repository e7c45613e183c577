"""Formulas that are tried at a state; only accepted states become part of their history.

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

from collections.abc import Sequence
from dataclasses import replace

from dyknow_common import Alternatives, PositionedError, choices, shortened
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution import Histories, quick_reader
from dyknow_reasoning.language.constants import NO_CONSTANTS, Constants
from dyknow_reasoning.language.formula import Always, Forall, Formula, Freeze, FutureFormula, walk
from dyknow_reasoning.language.grammar import LANGUAGE
from dyknow_reasoning.language.interval import ALL_FUTURE
from dyknow_reasoning.language.parsing import parse_formula
from dyknow_reasoning.language.type_checking import check_types
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.instances import Domains, instances_of, required_features
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import Chronology, holds_at
from dyknow_reasoning.progression.past_operators import PastMemory
from dyknow_reasoning.progression.sizes import (
    FormulaLimits,
    check_size,
    formula_size,
    object_counts,
)


def asked_of_each_state(formula: Formula) -> Formula:
    """Return a formula without `always` at the outside, or below the outermost `forall`.

    The result is what the formula asks of each state. `always p`, asked at every state, would stay
    violated after one state without p, as no later state makes it true.
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
            if isinstance(each, Freeze):
                raise PositionedError(
                    f"'let {each.name} = ...' keeps a value for states to come; compare with the "
                    'state before instead, prev(x)',
                    each.position,
                )
            if isinstance(each, FutureFormula):
                raise PositionedError(
                    f"'{shortened(each)}' looks into the future, so no single state decides it; "
                    'use operators of the past, and always only at the outside, without an '
                    'interval',
                    each.position,
                )
    return formula


class TrialFormula:
    """A formula that is tried at proposed states, and the history of accepted states.

    Args:
        text: the formula.
        domains: the objects of each sort.
        limits: the limits of its size.

    Raises:
        DyKnowError: for a text that is no such formula, a sort without a domain, or a formula that
            is too large for the domains.
    """

    def __init__(self, text: str, domains: Domains, limits: FormulaLimits | None = None) -> None:
        limits = limits or FormulaLimits()
        formula = check_trial(text)
        check_size(formula_size(formula, object_counts(domains, limits)), limits)
        kinds = check_types(formula, text)
        asked = asked_of_each_state(formula)
        self._histories = Histories(limits.node_limit)
        instances = instances_of(asked, domains, NodeStore(Chronology()), limits.node_limit)
        attached = self._histories.attach(0, asked, instances, kinds)
        self._instances = [
            (each.node, quick_reader(each.atoms, kinds, each.node.mask)) for each in attached
        ]
        self._names = {str(each) for each in required_features(attached)}
        self._memories: list[PastMemory] = []
        self._latest: int | None = None
        self._time = 0

    def holds(self, time: int, values: Values) -> bool:
        """Return True if the formula holds at a proposed state, for all `Alternatives` of values.

        Args:
            time: the time of the state in nanoseconds, after the latest accepted state.
            values: a value for each feature of objects, by the text of its `Symbol`.

        Raises:
            ReasoningError: for a state that is not later, lacks a field, or has an unusable value;
                for alternatives if the formula looks into the past.
        """
        if self._latest is not None and time <= self._latest:
            raise ReasoningError(f'the state at {time} ns is not later than the one before')
        if Alternatives.are_among(values.values()):
            return all(self._holds(time, each) for each in self._choices(values))
        return self._holds(time, values)

    def _choices(self, values: Values) -> Sequence[Values]:
        """Return all choices among the alternatives of values that it depends on."""
        own = {name: values[name] for name in self._names & values.keys()}
        reasons = [each.reason for each in own.values() if isinstance(each, Alternatives)]
        registers = self._histories.registers.values()
        if reasons and any(each.atom.depends_on_others for each in registers):
            raise ReasoningError(f'{reasons[0]}: too much for a formula that looks into the past')
        try:
            return choices(own)
        except ValueError as error:
            raise ReasoningError(f'{reasons[0]}: {error}') from None

    def _holds(self, time: int, values: Values) -> bool:
        state, memories = self._histories.tried(time, values)
        symbols = [(node, read(state)) for node, read in self._instances]
        # Until it ends without an error, there is nothing to accept.
        self._memories, self._time = memories, time
        return all(holds_at(*each) for each in symbols)

    def accept(self) -> None:
        """Add the state of the latest call of `holds` to the history."""
        self._histories.accept(self._memories)
        self._latest = self._time
