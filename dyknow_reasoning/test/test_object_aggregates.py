"""Aggregates over the objects of a sort: `max(Speed[r] for r in Robot)`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reasoning_reference import begun, random_cases
from test_functions import NAMES, results_on_all_paths

from dyknow_common import LanguageError, Verdict
from dyknow_reasoning import (
    FormulaGroup,
    FormulaLimits,
    FormulaResult,
    ReasoningError,
    parse_formula,
    symbols_of,
)

DOMAINS = {'Robot': ['a', 'b', 'c'], 'Base': ['home'], 'Nothing': []}
VALUES = {'P[a]': 1.5, 'P[b]': 2, 'P[c]': 7.0, 'P[home]': 4.0, 'On[a]': True, 'On[b]': False}


def decided(text: str, values: Mapping[str, Any] = VALUES, **asked: Any) -> FormulaResult:
    """The result of a formula at one state."""
    group, _ = begun(text, DOMAINS, **asked)
    (result,) = group.decided_at_once() or group.progress(0, values)
    return result


def total(values: Sequence[float]) -> float:
    found: float = 0
    for value in values:
        found += value
    return found


REFERENCES: Mapping[str, Callable[[Sequence[float]], float]] = {
    'max(A[x, y] for x in S)': max,
    'min(A[x, y] for x in S)': min,
    'sum(A[x, y] for x in S)': total,
    'max(A[x, y] * 2 for x in S)': lambda values: 2 * max(values),
    'count(A[x, y] > 0.5 for x in S)': lambda values: len([each for each in values if each > 0.5]),
    'sum(1 for x in S)': len,
    'count(x != x0 for x in S) + max(A[x, y] for x in S)': lambda values: (
        len(values) - 1 + max(values)
    ),
    '2 * count(A[x, y] != 3 for x in S) - min(A[x, y] for x in S)': lambda values: (
        2 * len([each for each in values if each != 3]) - min(values)
    ),
}
NUMBERS = st.sampled_from([0, 3, -2, 1 << 52, (1 << 53) - 1]) | st.integers(-9, 9)
# A column has values of one type.
ROWS = st.tuples(st.integers(1, 4), st.sampled_from([NUMBERS, st.floats(-9, 9)])).flatmap(
    lambda drawn: st.lists(
        st.lists(drawn[1], min_size=drawn[0], max_size=drawn[0]), min_size=1, max_size=4
    )
)


@settings(max_examples=random_cases(20))
@given(st.sampled_from([*REFERENCES]), ROWS, st.booleans())
def test_all_paths_agree_with_the_reference(
    term: str,
    rows: list[list[float]],
    wrong: bool,  # noqa: FBT001
) -> None:
    objects = [f'x{index}' for index in range(len(rows[0]))]
    columns: dict[str, list[Any]] = {}
    for index, name in enumerate(NAMES):
        turned = rows[index % len(rows) :] + rows[: index % len(rows)]
        for place, each in enumerate(objects):
            columns[f'A[{each}, {name}]'] = [row[place] for row in turned]
        columns[f'C[{name}]'] = [REFERENCES[term](row) + wrong for row in turned]
    domains = {'S': objects, 'Y': NAMES}
    text = f'forall y in Y: always {term} = C[y]'
    found = results_on_all_paths([text], columns, domains)
    assert all(each == found[0] for each in found)
    assert [each.verdict for each in found[0]] == [Verdict.FALSE] * wrong


@pytest.mark.parametrize(
    ('text', 'explanation'),
    [
        ('always max(P[r] for r in Robot) < 5', 'max(P[r] for r in Robot) = 7.0 {} not < 5'),
        ('min(P[r] for r in Robot) < 1', 'min(P[r] for r in Robot) = 1.5 {} not < 1'),
        ('sum(P[r] for r in Robot) > 10', 'sum(P[r] for r in Robot) = 10.5 {} > 10'),
        ('max(P[r] for r in Base) < 2', 'P[home] = 4.0 {} not < 2'),
        (
            'exists u in Base: always max(P[r] - P[u] for r in Robot) < 2',
            'P[r] - P[home] for r in Robot) = 3.0 {} not < 2',
        ),
        (
            'let P: kW in count(P[r] > 1800 W for r in Robot) = 2',
            'count(P[r] > 1800 W for r in Robot) = 2 {} equal to 2',
        ),
        ('count(On[r] for r in Robot) < 2', 'count(On[r] for r in Robot) = 2 {} not < 2'),
        ('once sum(P[r] for r in Robot) > 10.5', "'sum(P[r] for r in Robot) > 10.5' held at no"),
    ],
)
def test_explanations(text: str, explanation: str) -> None:
    result = decided(text, {**VALUES, 'On[c]': True})
    assert explanation.format('at 0.000 s is') in result.explanation


def test_no_objects() -> None:
    assert decided('sum(P[r] for r in Nothing) = 0').verdict is Verdict.TRUE
    assert decided('count(P[r] > 1 for r in Nothing) = 0').verdict is Verdict.TRUE
    assert decided('forall n in Nothing: P[n] < max(P[r] for r in Nothing)').verdict is Verdict.TRUE
    for function in ('max', 'min'):
        group = FormulaGroup()
        group.add_formula('it', f'always {function}(P[r] for r in Nothing) < 1')
        with pytest.raises(ReasoningError, match="no value, as 'Nothing' has no objects"):
            group.begin(DOMAINS)


def test_unusable_values_are_errors() -> None:
    assert "no field 'On[c]'" in str(decided('count(On[r] for r in Robot) < 9').error)
    values = {**VALUES, 'P[a]': math.inf, 'P[b]': -math.inf}
    error = str(decided('sum(P[r] for r in Robot) < 9', values).error)
    assert error.endswith("'sum(P[r] for r in Robot)' is sum(inf, -inf, 7.0): not a number")


def test_margins() -> None:
    margin = decided('always sum(P[r] for r in Robot) < 9', margin=True).margin
    assert margin is not None
    assert (margin.upper, margin.atom) == (-1.5, 'sum(P[r] for r in Robot) < 9')


@pytest.mark.parametrize(
    ('text', 'canonical'),
    [
        ('max(P[r] for r∈Robot)<5', 'max(P[r] for r in Robot) < 5'),
        ('min(P[r] + 1 for r) < 5', 'min(P[r] + 1 for r) < 5'),
        ('let most = 2 in count(P[r] > most for r in R) < 5', 'count(P[r] > 2 for r in R) < 5'),
        (
            'let P: W in sum(P[r] - 1 kW for r in R) < 2 kW',
            'sum(P[r] - 1000.0 for r in R) < 2000.0',
        ),
        ('let P: W in count(P[r] < 2 kW for r in R) < 5', 'count(P[r] < 2000.0 for r in R) < 5'),
        (
            'max(max(D[x, y] for y in R) for x in R) < 5',
            'max(max(D[x, y] for y in R) for x in R) < 5',
        ),
        ('for < 2', 'for < 2'),
    ],
)
def test_canonical_texts(text: str, canonical: str) -> None:
    assert str(parse_formula(text)) == canonical
    assert parse_formula(canonical) == parse_formula(text)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('let on = 5 in count(on for r in R) < 2', 'the constant .on. is 5, not a formula'),
        ('count(u for r in R) < 2 and P[u]', "'u' is an object elsewhere"),
        ('count(P[r] and On[r] for r in R) < 2', 'no comparison and no boolean feature'),
        ('max(P[r] < 2 for r in R) < 2', 'is a formula, not a value'),
        ('abs(P[r] for r in R) < 2', "'abs' takes no 'for'; max, min, sum, count do"),
        ('forall r in R: max(P[r] for r in R) < 2', "the variable 'r' is bound already"),
        ('count(P[r] for r in R) < max(P[r] for r in R)', "'P.r.' is a"),
        ('max(P[r] for r in R) = "x"', 'it must be a number'),
        ('max(2 for r) < 2', "the sort of 'r' is unknown"),
    ],
)
def test_wrong_aggregates(text: str, message: str) -> None:
    with pytest.raises(LanguageError, match=message):
        FormulaGroup().add_formula('it', text)


def test_symbols_and_sizes() -> None:
    formula = 'max(D[x, home] for x in Robot) < min(P[x] for x)'
    found = list(map(str, symbols_of(parse_formula(formula))))
    assert found == ['Robot', 'D[Robot, home]', 'home', '?x', 'P[?x]']
    group = FormulaGroup(FormulaLimits(instance_part_limit=10))
    group.add_formula('it', 'always max(P[r] for r in Robot) < 1')
    with pytest.raises(ReasoningError, match='parts for each choice'):
        group.begin({'Robot': [f'r{index}' for index in range(10)]})


@pytest.mark.parametrize(
    'formula',
    [
        (
            '(exists k in S: max(X[NAME] - X[k] for NAME in S) < 1) and max(X[NAME] - X[NAME] for '
            'NAME in S) < 1'
        ),
        (
            'always (prev(max(X[NAME] - X[NAME] for NAME in S)) >= sum(prev(max(X[NAME] - X[k] for '
            'NAME in S)) for k in S))'
        ),
    ],
)
def test_texts_tell_variables_from_objects(formula: str) -> None:
    """Comparisons with one text share their values."""
    for values in product((0, 1, 2), repeat=2):
        found = []
        for name in ('v', 'a', 'b'):
            text = formula.replace('NAME', name)
            group, number = begun(text, {'S': 'ab'}, margin='prev' not in formula)
            state = {f'X[{each}]': value for each, value in zip('ab', values, strict=True)}
            results = [*group.progress(0, state), *group.progress(1, state)]
            margin = group.margin(number)
            bounds = margin and (margin.lower, margin.upper)
            found.append(([(each.verdict, each.decided_at) for each in results], bounds))
        assert found == found[:1] * 3
