"""Margins of the formulas of a group."""

from __future__ import annotations

from itertools import accumulate
from math import inf, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from margin_reference import ended, margin
from reasoning_reference import COMPARISONS, begun, formulas, with_history

from dyknow_common import Margin, Verdict
from dyknow_reasoning import FormulaGroup, FormulaLimits, ReasoningError
from dyknow_reasoning.language.formula import And, Comparison, Formula
from dyknow_reasoning.language.terms import Feature, Number
from dyknow_reasoning.margins.building import check_margin

S = 1_000_000_000
OBJECTS = ('a', 'b', 'c')

values = st.integers(-3, 3).map(float)
leaves = st.builds(
    Comparison, st.sampled_from(sorted(COMPARISONS)), st.just(Feature('x')), values.map(Number)
)
states = st.lists(st.tuples(st.integers(1, 3), values), min_size=1, max_size=12)


def group_of(text: str, domains: Any = None) -> tuple[FormulaGroup, int]:
    return begun(text, domains, margin=True)


def margins(text: str, *states: dict[str, Any]) -> list[Margin | None]:
    """The margin at the states of each second."""
    group, formula_id = group_of(text, {'S': OBJECTS})
    found = []
    for time, state in enumerate(states):
        group.progress(time * S, state)
        found.append(group.margin(formula_id))
    return found


def test_the_margin_of_an_invariant_falls() -> None:
    found = margins('always x < 5', {'x': 2.0}, {'x': 4.0}, {'x': 3.0}, {'x': 6.5})
    assert [each and each.upper for each in found] == [3.0, 1.0, 1.0, -1.5]
    assert {each and each.lower for each in found} == {-inf}
    assert found[-1] == Margin(-inf, -1.5, atom='x < 5')


def test_a_decided_margin_has_equal_bounds() -> None:
    found = margins('eventually[0 s, 2 s] x > 1', *[{'x': x} for x in (0.0, 3.5, 2.0)])
    assert found[0] == Margin(-1.0, inf, atom='x > 1')
    # The group ends with the formula at its verdict: a later state may have a greater margin.
    assert found[1] == found[2] == Margin(2.5, inf, atom='x > 1')
    assert margins('eventually[0 s, 1 s] x > 1', {'x': 0.0}, {'x': 0.5})[-1] == Margin(
        -0.5, -0.5, atom='x > 1'
    )


def test_the_limiting_atom_of_many_objects() -> None:
    state = {'x[a]': 9.0, 'x[b]': 7.5, 'x[c]': 11.0}
    [found] = margins('forall o in S: always x[o] > 5', state)
    assert found == Margin(-inf, 2.5, atom='x[b] > 5')
    [found] = margins('exists o in S: x[o] > 10', state)
    assert found == Margin(1.0, 1.0, atom='x[c] > 10')


def test_comparisons_of_other_values() -> None:
    assert margins('m = "on" and x > 1', {'m': 'on', 'x': 3.0}) == [Margin(2.0, 2.0, atom='x > 1')]
    assert margins('m = "on" and x > 1', {'m': 'off', 'x': 3.0}) == [Margin(-inf, -inf)]
    assert margins('p or x > 1', {'p': True, 'x': 3.0}) == [Margin(inf, inf)]
    assert margins('x + 2 * y != z', {'x': 1, 'y': 2, 'z': 9}) == [
        Margin(4.0, 4.0, atom='(x + (2 * y)) != z')
    ]
    assert margins('not x = 4', {'x': 1.0}) == [Margin(3.0, 3.0, atom='x = 4')]
    assert margins('x > 0', {'x': 10**400}) == [Margin(inf, inf, atom='x > 0')]


def test_unusable_values_make_the_margin_unknown() -> None:
    group, formula_id = group_of('(always x > 1) or eventually y > 5')
    group.progress(0, {'x': 3.0, 'y': 0.0})
    [result] = group.progress(S, {'x': nan, 'y': 0.0})
    assert result.error is not None
    assert result.margin == Margin(-5.0, inf, atom='y > 5')
    assert group.margin(formula_id) == result.margin


def test_a_gap_makes_the_margin_unknown() -> None:
    group, formula_id = group_of('always[0 s, 9 s] x > 1')
    group.progress(0, {'x': 3.0})
    group.gap()
    group.progress(5 * S, {'x': 4.0})
    assert group.margin(formula_id) == Margin(-inf, 2.0, atom='x > 1')
    [result] = group.progress(9 * S, {'x': 2.5})
    assert result.verdict is Verdict.UNDECIDED
    assert result.margin == Margin(-inf, 1.5, atom='x > 1')


def test_a_formula_that_is_added_later_begins_with_the_next_state() -> None:
    group, _ = group_of('always x < 9')
    group.progress(0, {'x': 8.0})
    second = group.add_formula('second', 'always x < 9', margin=True)
    third = group.add_formula('third', 'always x < 9')
    assert group.margin(second) == Margin()
    group.progress(S, {'x': 2.0})
    assert group.margin(second) == Margin(-inf, 7.0, atom='x < 9')
    assert group.margin(third) is None
    group.remove_formula(second)
    with pytest.raises(ReasoningError, match='has no formula 2'):
        group.margin(second)


@pytest.mark.parametrize('text', ['once[0, 5 ns] x > 3', 'once[0, 5 ns] eventually[0, 1 ns] x > 3'])
def test_a_kept_history_makes_the_margin_unknown(text: str) -> None:
    """The margins of the states that the formula looks back to are not kept."""
    group = with_history(text)
    group.progress(0, {'x': 10.0})
    formula_id = group.add_formula('it', text, margin=True)
    assert group.margin(formula_id) == Margin()
    (result,) = group.progress(1, {'x': 1.0})
    assert (result.verdict, result.margin) == (Verdict.TRUE, Margin())


def test_what_has_no_margin_is_refused() -> None:
    with pytest.raises(ReasoningError) as error:
        check_margin(And(Feature('p'), Number(1)))  # type: ignore[arg-type]
    assert str(error.value) == (
        "no margin is defined for '1'; leave out the margin, or this part of the formula"
    )


def test_too_many_operators_are_refused() -> None:
    text = 'x > 0'
    for _ in range(10):
        text = f'({text}) <-> (always {text})' if text == 'x > 0' else f'({text}) <-> y > 0'
    group = FormulaGroup(FormulaLimits(node_limit=1000))
    group.add_formula('it', text, margin=True)
    with pytest.raises(ReasoningError, match=r"has more than 1000 operators .*'node_limit'"):
        group.begin({})


@given(formulas(3, leaves), states)
def test_margins_agree_with_verdicts(formula: Formula, steps: list) -> None:
    times = list(accumulate(step for step, _ in steps))
    trace = [(t, t, {'x': x}) for t, (_, x) in zip(times, steps, strict=True)]
    group, _ = group_of(str(formula))
    results = group.decided_at_once()
    for time, _, state in trace:
        results += group.progress(time, state)
    low, high = margin(formula, ended(trace), 0)
    for result in results:
        assert result.margin is not None
        assert not (result.verdict is Verdict.TRUE and result.margin.upper < 0)
        assert not (result.verdict is Verdict.FALSE and result.margin.lower > 0)
    if low > 0 or high < 0:
        assert [result.verdict for result in results] == [
            Verdict.TRUE if low > 0 else Verdict.FALSE
        ]


@given(formulas(3, leaves), states, st.integers(0, 12))
def test_recordings_have_the_same_margins(formula: Formula, steps: list, first: int) -> None:
    times = list(accumulate(step for step, _ in steps))
    column = np.array([x for _, x in steps])
    group, formula_id = group_of(str(formula))
    results = group.decided_at_once()
    for time, x in zip(times, column.tolist(), strict=True):
        results += group.progress(time, {'x': x})
    many, many_id = group_of(str(formula))
    found = many.progress_many(times[:first], {'x': column[:first]})
    found += many.progress_many(times[first:], {'x': column[first:]})
    assert [each.margin for each in found] == [each.margin for each in results]
    assert many.margin(many_id) == group.margin(formula_id)


@pytest.mark.parametrize('is_recorded', [False, True])
def test_the_margin_of_a_formula_that_needs_no_state_is_not_known(*, is_recorded: bool) -> None:
    group, _ = group_of('forall x in S: x = x', {'S': OBJECTS})
    [result] = group.progress_many([1, 2], {}) if is_recorded else group.progress(1, {})
    assert (result.verdict, result.margin) == (Verdict.TRUE, Margin())
