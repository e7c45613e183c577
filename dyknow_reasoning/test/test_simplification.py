"""Formulas decided without a state, and thresholds on one term."""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from reasoning_reference import begun, deeper, holds

from dyknow_common import Verdict
from dyknow_reasoning.language.formula import (
    And,
    Comparison,
    Equivalent,
    Formula,
    Implies,
    Not,
    Or,
)
from dyknow_reasoning.language.parsing import parse_formula
from dyknow_reasoning.language.terms import Feature, Number


def at_once(text: str) -> str:
    """The verdict without a state, or what remains."""
    group, number = begun(text, {'S': ['a', 'b']})
    results = group.decided_at_once()
    if results:
        return results[0].verdict.name
    return ' '.join(map(str, group.symbols())) or group.residual(number)


@pytest.mark.parametrize(
    ('text', 'expected'),
    [
        ('eventually true', 'TRUE'),
        ('eventually[0 s, 5 s] true', 'TRUE'),
        ('always false', 'FALSE'),
        ('always[0, 0] false', 'FALSE'),
        ('p until[0 s, 3 s] true', 'TRUE'),
        ('p until false', 'FALSE'),
        ('eventually[1 s, 2 s] false', 'FALSE'),
        ('always[1 s, 2 s] true', 'TRUE'),
        ('always eventually (p or not p)', 'TRUE'),
        ('not eventually[0, 5] (p until true)', 'FALSE'),
        ('q and always[0, 9] false', 'FALSE'),
        # Whether there is a state in these windows is not known.
        ('eventually[5 s, 6 s] true', 'eventually[5 s, 6 s] true'),
        ('always(0 s, 6 s] false', 'always(0 s, 6 s] false'),
        ('p until[1 ns, 6 s] true', 'p'),
        ('x > 10 -> x > 5', 'TRUE'),
        ('always (x < 1 and x > 1)', 'FALSE'),
        ('x <= 5 or x > 5', 'TRUE'),
        ('x < 5 or x > 5', 'x'),
        ('x < 5 or 5 < x or x = 5', 'TRUE'),
        ('x >= 5 and x <= 5 and x != 5', 'FALSE'),
        ('x >= 5 and x <= 5', 'x'),
        ('x = 1 and x = 1.5', 'FALSE'),
        ('x != 1 or x != 2', 'TRUE'),
        ('x = 3 and (x < 5 -> p)', 'x p'),
        ('x = 3 and (x > 5 -> p)', 'x'),
        ('x > 10 and (x > 5 or p)', 'x'),
        ('x > 10 and (x < 5 or p)', 'x p'),
        ('x > 10 and (x < 5 or x = 7)', 'FALSE'),
        ('x < 5 or (x >= 5 and p)', 'x p'),
        ('m = "a" and m = "b"', 'FALSE'),
        ('m != "a" or m != "b"', 'TRUE'),
        ('x * 2 > 10 and x * 2 < 9', 'FALSE'),
        ('x > 10 and y < 9', 'x y'),
        ('x > 1 and x < 2', 'x'),
        ('forall u in S: exists v in S: P[v] > 3 or P[v] < 5', 'TRUE'),
        ('x > 9007199254740993 and x < 9007199254740992.0', 'FALSE'),
        # One state after another, if one interval is within the other.
        ('(always x > 10) and eventually x < 5', 'FALSE'),
        ('(always[0, 3 s] x > 10) and eventually[1 s, 3 s] x < 5', 'FALSE'),
        ('(always[0, 3 s] x > 10) and (p until[1 s, 3 s] x < 5)', 'FALSE'),
        ('(eventually x > 5) or always[1 s, 3 s] x <= 5', 'TRUE'),
        ('(always x > 10) -> (always[1 s, 2 s] x > 5)', 'TRUE'),
        ('p and (always x > 10) and eventually x < 5', 'FALSE'),
        ('always (p -> (always x > 10) and eventually x < 5)', 'p'),
        ('(always x > 10) and always (p -> eventually x < 5)', 'x p'),
        # Not known: other intervals, other bodies, two of `until`, other terms.
        ('(always[0, 3 s] x > 10) and eventually[1 s, 4 s] x < 5', 'x'),
        ('(always x > 10) and eventually (x < 5 and p)', 'x p'),
        ('(always x > 10) and x < 5', 'x'),
        ('(always x > 10) and always x < 5', 'x'),
        ('(x > 10 until p) and eventually x < 5', 'x p'),
        ('x > y and x < y', 'x y'),
        ('x * 2 > 10 and x < 5', 'x'),
    ],
)
def test_without_a_state(text: str, expected: str) -> None:
    assert at_once(text) == expected


def test_a_dropped_atom_does_not_matter() -> None:
    group, _ = begun('always (x > 10 and x > 5 and x != 7 and x > 10.0)')
    (instance,) = group._instances[1]
    assert instance.node.mask.bit_count() == 1


VALUES = (-math.inf, 0, 0.5, 1, 1.5, 2, 2.5, math.inf)
ATOMS = st.builds(
    Comparison,
    st.sampled_from(['=', '!=', '<', '<=', '>', '>=']),
    st.sampled_from([Feature('x'), Feature('x'), Feature('y')]),
    st.sampled_from([0, 1, 1.0, 2, 2.0]).map(Number),
)
MIRRORED = ATOMS.map(
    lambda atom: Comparison(
        {'<': '>', '<=': '>=', '>': '<', '>=': '<='}.get(atom.operator, atom.operator),
        atom.right,
        atom.left,
    )
)
SEVERAL = [st.builds(kind, ATOMS | MIRRORED, ATOMS) for kind in (And, Or, Implies)]


def together(inner: st.SearchStrategy[Formula]) -> st.SearchStrategy[Formula]:
    return st.one_of(
        st.builds(Not, inner),
        *(st.builds(each, inner, inner) for each in (And, Or, Implies, Equivalent)),
    )


@given(st.recursive(st.one_of(ATOMS, MIRRORED), together, max_leaves=9))
def test_one_state_has_the_verdict_of_the_reference(formula: Formula) -> None:
    expected = {}
    for x, y in product(VALUES, repeat=2):
        state = {'x': x, 'y': y}
        group, _ = begun(str(formula))
        (result,) = group.decided_at_once() or group.progress(0, state)
        expected[x, y] = holds(formula, [(0, state)], 0)
        assert (result.verdict is Verdict.TRUE) == expected[x, y], (str(formula), state)


@given(st.lists(ATOMS | MIRRORED, min_size=1, max_size=5), st.booleans())
def test_a_junction_of_thresholds_is_decided_as_early_as_possible(
    atoms: list[Comparison],
    universal: bool,  # noqa: FBT001
) -> None:
    kind = And if universal else Or
    formula: Formula = atoms[0]
    for each in atoms[1:]:
        formula = kind(formula, each)
    found = {holds(formula, [(0, {'x': x, 'y': y})], 0) for x, y in product(VALUES, repeat=2)}
    verdict = at_once(str(formula))
    assert (verdict in {'TRUE', 'FALSE'}) == (len(found) == 1), str(formula)


LEAVES = st.one_of(ATOMS, MIRRORED, *SEVERAL)
STATES = st.fixed_dictionaries({name: st.sampled_from([-1, 0, 0.5, 1, 1.5, 2, 3]) for name in 'xy'})
INTERVALS = st.sampled_from(['', '[0, 2 ns]', '[1 ns, 2 ns]', '[1 ns, inf]', '[2 ns, 4 ns]'])
TRACES = st.lists(
    st.tuples(
        st.integers(1, 2),
        st.fixed_dictionaries({name: st.sampled_from([0, 0.5, 1, 1.5, 2]) for name in 'xy'}),
    ),
    min_size=1,
    max_size=6,
)


@given(
    st.sampled_from(['and', 'or', '->']),
    st.tuples(*[st.sampled_from(['always', 'eventually', 'true until', 'y < 1 until'])] * 2),
    st.tuples(INTERVALS, INTERVALS),
    st.tuples(ATOMS, ATOMS | MIRRORED),
    st.lists(TRACES, min_size=5, max_size=5),
)
def test_thresholds_in_two_windows(
    word: str,
    kinds: tuple[str, str],
    intervals: tuple[str, str],
    atoms: tuple[Comparison, Comparison],
    traces: list[Any],
) -> None:
    first, second = (f'({k}{i} {a})' for k, i, a in zip(kinds, intervals, atoms, strict=True))
    for trace in traces:
        check(parse_formula(f'{first} {word} {second}'), trace)


@given(
    st.one_of(deeper(LEAVES), deeper(deeper(LEAVES))),
    st.lists(st.tuples(st.integers(1, 3), STATES), min_size=1, max_size=8),
)
def test_traces_have_the_verdicts_of_the_reference(formula: Formula, steps: list[Any]) -> None:
    check(formula, steps)


def check(formula: Formula, steps: list[tuple[int, dict[str, Any]]]) -> None:
    """No verdict differs from the reference, which may know less, or comes later."""
    times = [sum(step for step, _ in steps[: index + 1]) for index in range(len(steps))]
    trace = [(time, state) for time, (_, state) in zip(times, steps, strict=True)]
    group, _ = begun(str(formula))
    known: bool | None = None
    for result in group.decided_at_once():
        known = result.verdict is Verdict.TRUE
    for index, (time, state) in enumerate(trace):
        for result in group.progress(time, state):
            assert result.error is None
            known = result.verdict is Verdict.TRUE
        expected = holds(formula, trace[: index + 1], 0)
        if expected is not None:
            assert known == expected, (str(formula), trace[: index + 1])
    final = holds(formula, trace, 0)
    if known is not None and final is not None:
        assert known == final
