"""Progression against SENTIL's offline evaluation, where that is installed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from reasoning_reference import NAMES, begun, formulas

from dyknow_common import Verdict
from dyknow_reasoning.language.formula import (
    Always,
    And,
    Equivalent,
    Eventually,
    Formula,
    Implies,
    Interval,
    Not,
    Or,
    Until,
)
from dyknow_reasoning.language.terms import Feature, Truth

SECOND = 1_000_000_000
SYMBOLS = {And: 'and', Or: 'or', Implies: '->'}


def theirs(formula: Formula) -> str:  # noqa: PLR0911
    """The formula as SENTIL writes it."""
    match formula:
        case Truth(value):
            return '(p > -9)' if value else '(p < -9)'
        case Feature(name):
            return f'({name} > 0.5)'
        case Not(body):
            return f'(not {theirs(body)})'
        case And(left, right) | Or(left, right) | Implies(left, right):
            return f'({theirs(left)} {SYMBOLS[type(formula)]} {theirs(right)})'
        case Equivalent(left, right):
            return theirs(And(Implies(left, right), Implies(right, left)))
        case Always(body, interval):
            return f'(always{bounds(interval)} {theirs(body)})'
        case Eventually(body, interval):
            return f'(eventually{bounds(interval)} {theirs(body)})'
        case Until(left, right, interval):
            return f'({theirs(left)} until{bounds(interval)} {theirs(right)})'
    raise AssertionError(formula)


def bounds(interval: Interval) -> str:
    return f'[{interval.start}, {interval.end}]'


def bounded(formula: Any) -> bool:
    """True if all windows have an end: a recording says nothing about the others."""
    if not hasattr(formula, '__dataclass_fields__'):
        return not isinstance(formula, Interval)
    if isinstance(formula, Interval):
        return formula.end is not None
    return all(
        bounded(getattr(formula, name))
        for name in ('left', 'right', 'body', 'interval')
        if hasattr(formula, name)
    )


def ours(formula: Formula) -> Formula:
    """SENTIL's reading: the left side of until must also hold at the present state."""
    match formula:
        case Truth() | Feature():
            return formula
        case Not(body):
            return Not(ours(body))
        case Always(body, interval) | Eventually(body, interval):
            return replace(formula, body=ours(body), interval=scaled(interval))
        case Until(left, right, interval):
            phi, psi = ours(left), ours(right)
            later = And(phi, Until(phi, psi, scaled(interval)))
            return Or(psi, later) if interval.start == 0 else later
        case And(left, right) | Or(left, right) | Implies(left, right) | Equivalent(left, right):
            return replace(formula, left=ours(left), right=ours(right))
    raise AssertionError(formula)


def scaled(interval: Interval) -> Interval:
    return Interval(interval.start * SECOND, (interval.end or 0) * SECOND)


def verdict(formula: Formula, times: Sequence[int], states: Sequence[dict[str, bool]]) -> Verdict:
    group, _ = begun(str(formula))
    for time, state in zip(times, states, strict=True):
        for result in group.progress(time * SECOND, state):
            return result.verdict
    return Verdict.UNDECIDED


@st.composite
def traces(draw: st.DrawFn, most_step: int) -> tuple[list[int], list[dict[str, bool]]]:
    state = st.fixed_dictionaries({name: st.booleans() for name in NAMES})
    states = draw(st.lists(state, min_size=1, max_size=24))
    steps = st.lists(st.integers(1, most_step), min_size=len(states), max_size=len(states))
    return list(accumulate(draw(steps))), states


@pytest.mark.parametrize('most_step', [1, 4])
def test_verdicts_are_those_of_sentil(most_step: int) -> None:
    sentil = pytest.importorskip('sentil')

    def check(formula: Formula, trace: tuple[list[int], list[dict[str, bool]]]) -> None:
        times, states = trace
        found = verdict(ours(formula), times, states)
        if found is not Verdict.UNDECIDED:
            signals = {name: [float(state[name]) for state in states] for name in NAMES}
            begun = [float(time - times[0]) for time in times]
            robustness = sentil.Formula.parse(theirs(formula)).robustness(
                sentil.Trace(begun, signals)
            )
            assert (robustness > 0) == (found is Verdict.TRUE), (theirs(formula), trace)

    given(formulas(3).filter(bounded), traces(most_step))(check)()
