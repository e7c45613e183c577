"""Margins of many objects, which are computed as arrays, against those of each object."""

from __future__ import annotations

from itertools import accumulate
from math import inf, nan
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from reasoning_reference import COMPARISONS, begun, formulas

from dyknow_reasoning.language.formula import (
    Comparison,
    Count,
    CountBound,
    Exists,
    Forall,
    Formula,
)
from dyknow_reasoning.language.terms import Feature, Number, Variable
from dyknow_reasoning.margins import building

OBJECTS = ('a', 'b', 'c')

values = st.integers(-3, 3).map(float)
odd_numbers = st.sampled_from([inf, -inf, 1 << 53, (1 << 60) + 1])
numbers = st.one_of(values, st.integers(-3, 3), odd_numbers)
leaves = st.builds(
    Comparison,
    st.sampled_from(sorted(COMPARISONS)),
    st.sampled_from([Feature('x', (Variable('o'),)), Feature('z')]),
    values.map(Number),
)
bodies = formulas(2, leaves)
quantified = st.one_of(
    st.builds(Forall, st.just('o'), st.just('S'), bodies),
    st.builds(Exists, st.just('o'), st.just('S'), bodies),
    st.builds(
        Count,
        st.just('o'),
        st.just('S'),
        bodies,
        bound=st.sampled_from(CountBound),
        number=st.integers(0, 4),
    ),
)
pairs = st.builds(
    Comparison,
    st.sampled_from('<>'),
    st.just(Feature('x', (Variable('o'),))),
    st.just(Feature('y', (Variable('p'),))),
)
nested = st.builds(
    lambda outer, inner, body: outer('o', 'S', inner('p', 'S', body)),
    st.sampled_from([Forall, Exists]),
    st.sampled_from([Forall, Exists]),
    formulas(2, st.one_of(leaves, pairs)),
)
names = ('z', *(f'{feature}[{name}]' for feature in 'xy' for name in OBJECTS))
states = st.fixed_dictionaries(dict.fromkeys(names, numbers))
traces = st.lists(st.tuples(st.integers(1, 3), states), min_size=1, max_size=10)


def margins(
    formula: Formula, trace: list[tuple[int, dict[str, Any]]], gap: int, *, every_state: bool
) -> list[tuple[float, float, bool]]:
    """The bounds at each state, with a gap before one, and whether they have an atom."""
    group, formula_id = begun(str(formula), {'S': OBJECTS}, margin=True, every_state=every_state)
    found = []
    for index, (time, (_, state)) in enumerate(
        zip(accumulate(step for step, _ in trace), trace, strict=True)
    ):
        if index == gap:
            group.gap()
        group.progress(time, state)
        margin = group.margin(formula_id)
        assert margin is not None
        # Of atoms with equal margins, either one may be named.
        found.append((margin.lower, margin.upper, bool(margin.atom)))
    return found


@given(
    formulas(2, st.one_of(quantified, nested)),
    traces,
    st.integers(1, 12),
    st.integers(0, 12),
    st.sampled_from([nan, 1, True, 'one']),
    st.booleans(),
)
def test_many_objects_have_the_margins_of_each(
    formula: Formula,
    trace: list,
    gap: int,
    odd: int,
    value: object,
    every_state: bool,  # noqa: FBT001
) -> None:
    """One value at one state may be unusable, or of another type."""
    if odd < len(trace):
        trace[odd][1]['x[b]'] = value
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(building, '_LEAST_OBJECTS', 100)
        alone = margins(formula, trace, gap, every_state=every_state)
        patch.setattr(building, '_LEAST_OBJECTS', 2)
        together = margins(formula, trace, gap, every_state=every_state)
    assert together == alone


def test_the_limiting_object_of_many() -> None:
    objects = [f'u{number}' for number in range(40)]
    group, formula_id = begun('forall u in S: always h[u] > 5', {'S': objects}, margin=True)
    heights = {f'h[{name}]': 10.0 + number for number, name in enumerate(objects)}
    group.progress(0, {**heights, 'h[u31]': 7.5, 'h[u9]': 8})
    assert str(group.margin(formula_id)) == 'at most 2.5 (h[u31] > 5)'
