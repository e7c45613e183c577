"""Progression against a slow, obvious reading of the semantics."""

from __future__ import annotations

import os
from itertools import accumulate
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dyknow_reasoning import FormulaGroup, Verdict
from dyknow_reasoning.formula import (
    Always,
    And,
    Equivalent,
    Eventually,
    Feature,
    Formula,
    Implies,
    Interval,
    Not,
    Or,
    Truth,
    Until,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

NAMES = ('p', 'q')
EXAMPLES = 20_000 if os.environ.get('DYKNOW_LONG_TESTS') else 400

Trace = list[tuple[int, dict[str, bool]]]


def disjunction(values: Iterable[bool | None]) -> bool | None:
    """Or of what may be unknown."""
    seen = set(values)
    if True in seen:
        return True
    return None if None in seen else False


def negation(value: bool | None) -> bool | None:
    return None if value is None else not value


def conjunction(values: Iterable[bool | None]) -> bool | None:
    return negation(disjunction(negation(value) for value in values))


def holds(formula: Formula, trace: Trace, i: int) -> bool | None:
    """The truth of a formula at a state of a trace that may go on; None while unknown."""
    match formula:
        case Truth(value):
            return value
        case Feature(name):
            return trace[i][1][name]
        case Not(body):
            return negation(holds(body, trace, i))
        case And(left, right):
            return conjunction([holds(left, trace, i), holds(right, trace, i)])
        case Or(left, right):
            return disjunction([holds(left, trace, i), holds(right, trace, i)])
        case Implies(left, right):
            return disjunction([negation(holds(left, trace, i)), holds(right, trace, i)])
        case Equivalent(left, right):
            sides = [holds(left, trace, i), holds(right, trace, i)]
            return None if None in sides else sides[0] == sides[1]
        case Eventually(body, interval):
            return holds(Until(Truth(True), body, interval), trace, i)
        case Always(body, interval):
            return negation(holds(Eventually(Not(body), interval), trace, i))
        case Until(left, right, interval):
            return until(left, right, interval, trace, i)
    raise AssertionError(formula)


def until(left: Formula, right: Formula, interval: Interval, trace: Trace, i: int) -> bool | None:
    begin = trace[i][0]
    end = float('inf') if interval.end is None else begin + interval.end
    cases = [
        conjunction([holds(right, trace, j), *(holds(left, trace, k) for k in range(i + 1, j))])
        for j in range(i, len(trace))
        if begin + interval.start <= trace[j][0] <= end
    ]
    if trace[-1][0] < end:
        cases.append(
            conjunction([None, *(holds(left, trace, k) for k in range(i + 1, len(trace)))])
        )
    return disjunction(cases)


def verdicts(formula: Formula, trace: Trace) -> list[bool | None]:
    """What progression knows after each state."""
    group = FormulaGroup()
    group.add_formula('it', str(formula))
    group.begin({})
    known: bool | None = None
    found = []
    for time, values in trace:
        for result in group.progress(time, values):
            assert result.error is None
            assert result.decided_at == time
            assert result.explanation
            known = result.verdict is Verdict.TRUE
        found.append(known)
    return found


def intervals() -> st.SearchStrategy[Interval]:
    bounds = st.integers(0, 8)
    bounded = st.tuples(bounds, bounds).map(lambda pair: Interval(min(pair), max(pair)))
    return st.one_of(bounded, bounds.map(Interval), st.just(Interval()))


def deeper(inner: st.SearchStrategy[Formula]) -> st.SearchStrategy[Formula]:
    connectives = [st.builds(kind, inner, inner) for kind in (And, Or, Implies, Equivalent)]
    temporal = [st.builds(kind, inner, intervals()) for kind in (Always, Eventually)]
    return st.one_of(
        st.builds(Not, inner), *connectives, *temporal, st.builds(Until, inner, inner, intervals())
    )


def formulas(depth: int = 4) -> st.SearchStrategy[Formula]:
    found: st.SearchStrategy[Formula] = st.one_of(
        st.sampled_from(NAMES).map(Feature),
        st.sampled_from(NAMES).map(Feature),
        st.booleans().map(Truth),
    )
    leaves = found
    for _ in range(depth):
        found = st.one_of(leaves, deeper(found))
    return found


def traces(steps: st.SearchStrategy[int], *, most: int = 14) -> st.SearchStrategy[Trace]:
    states = st.fixed_dictionaries({name: st.booleans() for name in NAMES})
    return st.lists(st.tuples(steps, states), min_size=1, max_size=most).map(timed)


def timed(steps: Sequence[tuple[int, dict[str, bool]]]) -> Trace:
    times = accumulate(step for step, _ in steps)
    return [(time, values) for time, (_, values) in zip(times, steps, strict=True)]


@pytest.mark.parametrize('steps', [st.just(1), st.just(2), st.integers(1, 5)], ids=str)
def test_verdicts_are_right_and_not_late(steps: st.SearchStrategy[int]) -> None:
    @settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck))
    @given(formulas(), traces(steps))
    def check(formula: Formula, trace: Trace) -> None:
        found = verdicts(formula, trace)
        for length in range(1, len(trace) + 1):
            expected = holds(formula, trace[:length], 0)
            if expected is not None:
                assert found[length - 1] is expected, (str(formula), trace[:length])

    check()
