"""A verdict is one for all that unknown values may be, and comes as early as that is so."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import accumulate, product
from typing import cast

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from reasoning_reference import COMPARISONS, NAMES, Trace, formulas, holds, random_cases

from dyknow_common import Value, Verdict
from dyknow_reasoning import FormulaGroup, FormulaLimits, UnknownFeatures
from dyknow_reasoning.language.formula import Comparison, Formula, Interval
from dyknow_reasoning.language.terms import Arithmetic, Feature, Number, StateCount, ValueBefore

ANY = UnknownFeatures(all_may_be=True)
State = Mapping[str, Value | None]
PartialTrace = list[tuple[int, State]]


def started(text: str, objects: Iterable[str] = (), unknown: UnknownFeatures = ANY) -> FormulaGroup:
    group = FormulaGroup(FormulaLimits(possibility_limit=100_000))
    group.add_formula('f', text)
    group.begin({'S': tuple(objects)}, unknown)
    return group


def decided(group: FormulaGroup, states: Iterable[tuple[int, State]]) -> tuple[int, Verdict] | None:
    """The number of the deciding state, and the verdict."""
    for number, (time, values) in enumerate(states):
        for result in group.progress(time, values):
            assert result.error is None, result.error
            return number, result.verdict
    return None


def verdict(text: str, *states: State, **ranges: tuple[float, float]) -> Verdict | None:
    """The verdict over states a second apart."""
    group = started(text, ('a', 'b'), UnknownFeatures(ranges, all_may_be=True))
    found = decided(group, ((number * 10**9, each) for number, each in enumerate(states)))
    return found and found[1]


@st.composite
def partial_traces(
    draw: st.DrawFn, values: Sequence[Value], names: Sequence[str], most: int
) -> PartialTrace:
    """Up to six states, a third of whose values are unknown, but not too many of them."""
    steps = draw(st.lists(st.integers(1, 4), min_size=1, max_size=6))
    trace: PartialTrace = []
    for time in accumulate(steps):
        state: dict[str, Value | None] = {}
        for name in names:
            is_unknown = most > 0 and draw(st.integers(0, 2)) == 0
            most -= is_unknown
            state[name] = None if is_unknown else draw(st.sampled_from(values))
        trace.append((time, state))
    return trace


def completions(trace: PartialTrace, values: Sequence[Value]) -> Iterable[Trace]:
    """The traces that a partial trace may be."""
    unknown = [
        (i, name) for i, (_, state) in enumerate(trace) for name in state if state[name] is None
    ]
    for chosen in product(values, repeat=len(unknown)):
        completed = [dict(state) for _, state in trace]
        for (i, name), value in zip(unknown, chosen, strict=True):
            completed[i][name] = value
        times = (time for time, _ in trace)
        yield [(t, cast('dict[str, Value]', s)) for t, s in zip(times, completed, strict=True)]


@pytest.mark.timeout(3600)
@settings(max_examples=random_cases(60), deadline=None, suppress_health_check=list(HealthCheck))
@given(formulas(), partial_traces((False, True), NAMES, 7))
def test_verdicts_are_those_of_all_completions(formula: Formula, trace: PartialTrace) -> None:
    found = decided(started(str(formula)), trace)
    alone = [decided(started(str(formula)), each) for each in completions(trace, (False, True))]
    first = alone[0]
    expected = None
    if first and all(each and each[1] is first[1] for each in alone):
        expected = max(each[0] for each in alone if each), first[1]
    assert found == expected, (str(formula), trace)


X, Y = Feature('x'), Feature('y')
ORDERS = tuple(COMPARISONS)
EXACT = st.one_of(
    st.builds(
        Comparison,
        st.sampled_from(ORDERS),
        st.sampled_from((X, Y)),
        numbers := st.sampled_from((Number(1), Number(2))),
    ),
    st.builds(Comparison, st.sampled_from(ORDERS), st.just(X), st.just(Y)),
    st.builds(Comparison, st.sampled_from(ORDERS), st.just(ValueBefore(X)), numbers),
    st.builds(
        lambda operator, body, end, number: Comparison(
            operator, StateCount(body, Interval(0, end)), number
        ),
        st.sampled_from(ORDERS),
        st.builds(Comparison, st.sampled_from(ORDERS), st.just(X), numbers),
        st.integers(1, 6),
        numbers,
    ),
)
SOUND = st.builds(
    Comparison,
    st.sampled_from(ORDERS),
    st.sampled_from((Arithmetic('-', X, Y), Arithmetic('-', X, ValueBefore(X)), ValueBefore(Y))),
    st.sampled_from((X, Number(1))),
)
GRID = tuple(number / 4 for number in range(13))
"""Numbers from 0 to 3, with as many between constants as there are unknown values."""
RANGES = UnknownFeatures({'x': (0.0, 3.0), 'y': (0.0, 3.0)})


def told(formula: Formula, traces: Sequence[Trace], length: int) -> Verdict | None:
    """The verdict that all completions have after some states."""
    found = {holds(formula, trace[:length], 0) for trace in traces}
    return {(True,): Verdict.TRUE, (False,): Verdict.FALSE}.get(tuple(found))


@pytest.mark.timeout(3600)
@settings(max_examples=random_cases(40), deadline=None, suppress_health_check=list(HealthCheck))
@given(formulas(2, EXACT), partial_traces((0, 1, 1.5, 2, 3), ('x', 'y'), 2))
def test_orders_of_numbers_are_exact(formula: Formula, trace: PartialTrace) -> None:
    found = decided(started(str(formula), (), RANGES), trace)
    traces = list(completions(trace, GRID))
    for length in range(1, len(trace) + 1):
        if expected := told(formula, traces, length):
            assert found, (str(formula), trace)
            assert found[0] < length, (str(formula), trace)
            assert found[1] is expected, (str(formula), trace)
            return
    told_apart = {holds(formula, each, 0) for each in traces}
    assert found is None or told_apart <= {found[1] is Verdict.TRUE, None}, (str(formula), trace)


@pytest.mark.timeout(3600)
@settings(max_examples=random_cases(40), deadline=None, suppress_health_check=list(HealthCheck))
@given(
    formulas(2, st.one_of(EXACT, SOUND)),
    partial_traces((0, 1, 1.5, 2, 3), ('x', 'y'), 2),
)
def test_calculations_are_sound(formula: Formula, trace: PartialTrace) -> None:
    found = decided(started(str(formula), (), RANGES), trace)
    if found:
        truths = {holds(formula, each, 0) for each in completions(trace, GRID)}
        assert truths <= {found[1] is Verdict.TRUE, None}, (str(formula), trace)
