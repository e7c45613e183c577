"""Probabilities of formulas against enumeration, linear programs and simulated truths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import accumulate, pairwise, product
from math import exp, isclose, sqrt
from statistics import NormalDist
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reasoning_reference import begun, holds, intervals, started
from reasoning_reference import progressed as progressed_over

from dyknow_common import DyKnowError, ProbabilityInterval, Verdict
from dyknow_reasoning import (
    FormulaGroup,
    ReasoningError,
    TrialFormula,
    parse_constants,
    parse_formula,
)
from dyknow_reasoning.execution import FormulaProbability, probability_of
from dyknow_reasoning.execution.probability.distributions import at_least
from dyknow_reasoning.language.formula import (
    Always,
    And,
    CountBound,
    CountOf,
    Eventually,
    Formula,
    Not,
    Or,
    Until,
    walk,
)
from dyknow_reasoning.language.terms import Feature

STANDARD = NormalDist()
ROUNDING = 1e-9


def formulas(names: Sequence[str], depth: int = 3) -> st.SearchStrategy[Formula]:
    leaves = st.sampled_from(names).map(Feature)
    found: st.SearchStrategy[Formula] = leaves
    for _ in range(depth):
        members = st.lists(found, min_size=1, max_size=3).map(tuple)
        found = st.one_of(
            leaves,
            st.builds(Not, found),
            *(st.builds(kind, found, found) for kind in (And, Or)),
            *(st.builds(kind, found, intervals()) for kind in (Always, Eventually)),
            st.builds(Until, found, found, intervals()),
            st.builds(CountOf, st.sampled_from(CountBound), st.integers(0, 3), members),
        )
    return found


def over(formula: Formula, atoms: Mapping[str, str]) -> FormulaProbability:
    """The probability of a formula whose features stand for comparisons."""
    text = str(formula)
    for name, atom in atoms.items():
        text = text.replace(name, f'({atom})')
    return probability_of(f'P({text}) >= 0', {})


def taken(
    probability: FormulaProbability, trace: Sequence[tuple[int, Mapping[str, Any]]]
) -> list[ProbabilityInterval]:
    found = []
    for time, values in trace:
        probability.step(time, values)
        found.append(probability.interval())
    return found


def times(steps: Sequence[int]) -> list[int]:
    return list(accumulate(steps))


def traced(
    states: Sequence[tuple[int, float, float]],
) -> tuple[list[int], list[tuple[int, Mapping[str, Any]]]]:
    """The times of states, given as steps with x and y, and these states."""
    at = times([step for step, _, _ in states])
    return at, [(time, {'x': x, 'y': y}) for time, (_, x, y) in zip(at, states, strict=True)]


# Three atoms: two share a number, so that their truths depend on each other.
SHARED = {
    'aa': 'normal(x, 1, 0 s) > 0',
    'bb': 'normal(x, 1, 0 s) <= 1',
    'cc': 'normal(y, 2, 0 s) < 0',
}
MEANS = st.floats(-2, 3).map(lambda value: round(value, 3))


def truths(x: float, y: float) -> list[tuple[dict[str, bool], float]]:
    """The truths of these at a state, and their probabilities."""
    low, high = STANDARD.cdf(-x), STANDARD.cdf(1 - x)
    below = STANDARD.cdf(-y / 2)
    cells = [(False, True, low), (True, True, high - low), (True, False, 1 - high)]
    return [
        ({'aa': a, 'bb': b, 'cc': c}, of_x * of_y)
        for a, b, of_x in cells
        for c, of_y in ((True, below), (False, 1 - below))
    ]


@given(
    formulas(list(SHARED)),
    st.lists(st.tuples(st.integers(1, 5), MEANS, MEANS), min_size=1, max_size=3),
)
def test_independent_errors_are_exact(
    formula: Formula, states: Sequence[tuple[int, float, float]]
) -> None:
    at, trace = traced(states)
    found = taken(over(formula, SHARED), trace)
    true = false = 0.0
    for path in product(*(truths(x, y) for _, x, y in states)):
        chance = np.prod([each for _, each in path])
        known = holds(formula, list(zip(at, [values for values, _ in path], strict=True)), 0)
        true += chance if known is True else 0.0
        false += chance if known is False else 0.0
    # Progression knows some verdicts earlier than the reference.
    assert true - ROUNDING <= found[-1].lower <= found[-1].upper <= 1 - false + ROUNDING
    if isclose(true + false, 1):
        assert isclose(found[-1].lower, found[-1].upper, abs_tol=ROUNDING)
    check_nested(found)


def check_nested(found: Sequence[ProbabilityInterval]) -> None:
    """Later states only narrow an interval."""
    for before, after in pairwise(found):
        assert before.lower - ROUNDING <= after.lower <= after.upper <= before.upper + ROUNDING


# The same with nothing known, each atom about a number of its own.
UNKNOWN = {
    'aa': 'normal(x, 1) > 0',
    'bb': 'normal(y, 2) > 0',
    'cc': 'normal(z, 1) > 0',
}


@given(
    formulas(list(UNKNOWN)),
    st.lists(st.integers(1, 5), min_size=1, max_size=7),
    st.integers(0, 10**6),
)
def test_bounds_hold_for_any_dependence(formula: Formula, steps: Sequence[int], seed: int) -> None:
    generator = np.random.default_rng(seed)
    at = times(steps)
    runs = int(generator.integers(2, 8))
    weights = generator.dirichlet(np.full(runs, 0.5))
    likely = generator.choice([0.1, 0.5, 0.9])
    paths = generator.random((runs, len(at), 3)) < likely
    # A joint distribution of all truths, of which only the marginals are told.
    marginals = np.clip(np.tensordot(weights, paths, 1), 1e-12, 1 - 1e-12)
    deviations = dict(zip('xyz', (1, 2, 1), strict=True))
    trace = [
        (
            time,
            {
                name: deviation * STANDARD.inv_cdf(chance)
                for (name, deviation), chance in zip(deviations.items(), row, strict=True)
            },
        )
        for time, row in zip(at, marginals.tolist(), strict=True)
    ]
    probability = over(formula, UNKNOWN)
    found = taken(probability, trace)
    true = possible = at_end = 0.0
    for weight, path in zip(weights, paths.tolist(), strict=True):
        states = [dict(zip(UNKNOWN, row, strict=True)) for row in path]
        known = holds(formula, list(zip(at, states, strict=True)), 0)
        true += weight if known is True else 0.0
        possible += weight if known is not False else 0.0
        at_end += weight if held_at_end(formula, at, states) else 0.0
    assert found[-1].lower <= possible + ROUNDING
    assert found[-1].upper >= true - ROUNDING
    ended = probability.interval_at_end()
    assert ended.lower - ROUNDING <= at_end <= ended.upper + ROUNDING
    check_nested(found)
    if probability.is_final:
        assert ended == found[-1]


def held_at_end(formula: Formula, at: Sequence[int], states: Sequence[Any]) -> bool:
    """The verdict of a group if no further state came."""
    group, formula_id = begun(str(formula))
    results = group.decided_at_once()
    for time, values in zip(at, states, strict=True):
        results += group.progress(time, values)
    if results:
        return results[0].verdict is Verdict.TRUE
    return not group.presumably_false(formula_id)


@given(
    st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=4), st.integers(0, 5)
)
def test_counts_have_the_bounds_of_a_linear_program(
    pairs: Sequence[tuple[float, float]], count: int
) -> None:
    from scipy.optimize import linprog  # noqa: PLC0415 - half a second, here alone

    chances = [(min(pair), max(pair)) for pair in pairs]
    outcomes = list(product((0, 1), repeat=len(chances)))
    goal = np.array([sum(outcome) >= count for outcome in outcomes], float)
    rows = np.array(outcomes, float).T
    limits = np.vstack([rows, -rows])
    bounds = [upper for _, upper in chances] + [-lower for lower, _ in chances]
    found = []
    for sign in (1, -1):
        best = linprog(
            sign * goal, limits, bounds, np.ones((1, len(outcomes))), [1.0], method='highs'
        )
        assert best.success
        found.append(sign * best.fun)
    assert at_least(count, chances) == pytest.approx(found, abs=1e-7)


@pytest.mark.parametrize('correlation', [-1.0, -0.5, 0.0, 0.7, 1.0])
@pytest.mark.parametrize('limit', [-3.0, 0.2, 1.0, 4.0])
def test_a_sum_of_numbers_has_bounds_for_any_dependence(correlation: float, limit: float) -> None:
    probability = probability_of('P(normal(x, 1) - 2 * normal(y, 0.5) <= c) >= 0', {})
    probability.step(0, {'x': 1.0, 'y': 0.3, 'c': limit})
    # Of jointly normal numbers.
    deviation = sqrt(max(2 - 2 * correlation, 0))
    mean = 1.0 - 0.6
    truth = STANDARD.cdf((limit - mean) / deviation) if deviation else float(limit >= mean)
    found = probability.interval()
    assert found.lower <= truth <= found.upper
    assert probability.is_final


def test_independent_sums_and_functions() -> None:
    exact = probability_of('P(normal(x, 3, 0 s) + normal(y, 4, 0 s) > 5) >= 0', {})
    exact.step(0, {'x': 3.0, 'y': 4.0})
    assert exact.interval().lower == pytest.approx(STANDARD.cdf(0.4))
    distance = 'hypot(normal(x, 1, 0 s), normal(y, 1, 0 s)) < 1'
    for text, width in ((distance, 0.005), (f'always[0, 1 ms] {distance}', 0.1)):
        asked = probability_of(f'P({text}) >= 0', {})
        asked.step(0, {'x': 0.0, 'y': 0.0})
        asked.step(2_000_000, {'x': 0.0, 'y': 0.0})
        found = asked.interval()
        assert found.lower < 1 - exp(-0.5) < found.upper
        assert found.upper - found.lower < width


BOUNDED = {
    'aa': 'within(x, 1) > 0',
    'bb': 'within(x, 1) <= 1',
    'cc': 'within(x, 1) = 1',
    'dd': 'within(y, 2) - within(x, 1) < 0.5',
}
ESTIMATES = st.sampled_from((-2, -1, 0, 0.5, 1, 2, 3))


def bounded_truths(x: float, y: float) -> list[dict[str, bool]]:
    """The truths of these at a state, for all errors that make a difference."""
    return [
        {'aa': a > 0, 'bb': a <= 1, 'cc': a == 1, 'dd': b - a < 0.5}
        for a in (x + quarter / 4 for quarter in range(-4, 5))
        for b in (y - 2, y + 2)
    ]


@given(
    formulas(list(BOUNDED), 2),
    st.lists(st.tuples(st.integers(1, 5), ESTIMATES, ESTIMATES), min_size=1, max_size=2),
)
def test_bounded_errors_are_certain_or_unknown(
    formula: Formula, states: Sequence[tuple[int, float, float]]
) -> None:
    at, trace = traced(states)
    found = taken(over(formula, BOUNDED), trace)
    check_nested(found)
    known = {
        holds(formula, list(zip(at, values, strict=True)), 0)
        for values in product(*(bounded_truths(x, y) for _, x, y in states))
    }
    assert found[-1].lower in {0, 1}
    assert found[-1].upper in {0, 1}
    # It is what it is for all errors; of one number at one state, also exactly then.
    if found[-1].lower == 1:
        assert False not in known
    if found[-1].upper == 0:
        assert True not in known
    is_of_state = not any(isinstance(each, Always | Eventually | Until) for each in walk(formula))
    if is_of_state and 'dd' not in str(formula):
        assert known == {
            each for each in (False, True) if found[-1].lower <= each <= found[-1].upper
        }


@pytest.mark.parametrize(
    ('text', 'lower', 'upper'),
    [
        ('normal(x, 1) + within(y, 1) < 2', STANDARD.cdf(-1), STANDARD.cdf(1)),
        ('normal(x, 1) - 2 * within(y, 1) >= 0', STANDARD.cdf(-3), STANDARD.cdf(1)),
        ('normal(x, 1, 0 s) > 0 and within(y, 1) > -0.5', STANDARD.cdf(1), STANDARD.cdf(1)),
        ('normal(x, 1, 0 s) > 0 and within(y, 1) > 0.5', 0, STANDARD.cdf(1)),
        ('normal(x, 1) + within(y, 1) = 2', 0, 1),
        ('normal(x, 1) + within(y, 0) = 2', 0, 0),
        ('within(x, 1) + within(y, 1) <= 4', 1, 1),
        ('within(x, 1) + within(y, 1) < 4', 0, 1),
        ('within(x, 0) = 1', 1, 1),
    ],
)
def test_bounded_errors_beside_normal_ones(text: str, lower: float, upper: float) -> None:
    """Of all that the error of y may be, also if it depends on that of x."""
    probability = probability_of(f'P({text}) >= 0', {})
    probability.step(0, {'x': 1.0, 'y': 1.0})
    found = probability.interval()
    assert (found.lower, found.upper) == (pytest.approx(lower), pytest.approx(upper))


def test_a_comparison_within_bounds_is_an_error_that_gives_them() -> None:
    text = 'P(within(x, 0.5) > 1) >= 0.9'
    assert progressed(f'always[0, 1 s] {text}', [{'x': 2.0}, {'x': 1.6}])[0] == Verdict.TRUE
    assert progressed(text, [{'x': 0.5}])[0] == Verdict.FALSE
    verdict, _, error = progressed(text, [{'x': 1.2}])
    assert verdict == Verdict.UNDECIDED
    assert 'is unknown, assuming errors within their bounds' in str(error)
    assert 'time constant' not in str(error)


def test_simulated_errors_are_correlated_over_time() -> None:
    """With a long time constant, one state tells of the next; with a short one, it does not."""
    found = {}
    for constant in ('1 h', '1 ms'):
        probability = probability_of(f'P(always[0, 2 s] normal(x, 1, {constant}) > 0) >= 0', {})
        for second in range(3):
            probability.step(second * 10**9, {'x': 0.0})
        found[constant] = probability.interval()
    assert found['1 ms'].lower < 0.125 < found['1 ms'].upper
    assert found['1 h'].lower < 0.49 < found['1 h'].upper


@pytest.mark.parametrize('constant', ['0 s', '2 s'])
def test_intervals_cover_the_truth(constant: str) -> None:
    """A short run of `benchmarks/probability.py`: the share of true runs is in the interval."""
    generator = np.random.default_rng(7)
    number = f'normal(x, 1, {constant})'
    text = f'always[0, 5 s] ({number} > -1 or eventually[0, 2 s] {number} > 1)'
    probability = probability_of(f'P({text}) >= 0', {})
    estimates = generator.normal(0.5, 0.5, 9)
    for second, estimate in enumerate(estimates):
        probability.step(second * 10**9, {'x': float(estimate)})
    errors = simulated_errors(generator, 20_000, 9, 0.0 if constant == '0 s' else exp(-0.5))
    numbers = estimates + errors
    above = np.lib.stride_tricks.sliding_window_view(numbers > 1, 3, axis=1).any(axis=2)
    share = ((numbers[:, :6] > -1) | above[:, :6]).all(axis=1).mean()
    found = probability.interval()
    slack = 4 * sqrt(share * (1 - share) / 20_000)
    assert found.lower - slack <= share <= found.upper + slack
    assert probability.is_final


def simulated_errors(
    generator: np.random.Generator, runs: int, states: int, correlation: float
) -> Any:
    errors = generator.standard_normal((runs, states))
    for each in range(1, states):
        errors[:, each] *= sqrt(1 - correlation**2)
        errors[:, each] += correlation * errors[:, each - 1]
    return errors


def test_a_formula_asks_for_a_probability_at_each_state() -> None:
    group, _ = begun('always (busy -> P(normal(x, s) > 0) >= 0.95)')
    assert [str(each) for each in group.symbols()] == ['busy', 'x', 's']
    assert not group.progress(0, {'busy': False, 'x': 0.0, 's': 1.0})
    assert not group.progress(1, {'busy': True, 'x': 2.0, 's': 1.0})
    (result,) = group.progress(2, {'busy': True, 'x': 2.0, 's': 2.0})
    assert result.verdict is Verdict.FALSE
    assert 'is not >= 0.95' in result.explanation
    assert '0.841345' in result.explanation


@pytest.mark.parametrize(('asked', 'fact'), [('>= 0.5', 'is >= 0.5'), ('< 0.5', 'is not < 0.5')])
def test_a_probability_is_explained_once(asked: str, fact: str) -> None:
    group, _ = begun(f'P(always[0 s, 1 s] normal(x, 0.1, 0 s) > 0) {asked}')
    assert not group.progress(0, {'x': 1.0})
    (result,) = group.progress(10**9, {'x': 1.0})
    assert result.explanation.endswith(f' at 1.000 s {fact}')
    assert ';' not in result.explanation


def progressed(text: str, states: Sequence[Mapping[str, Any]]) -> tuple[Verdict, int | None, str]:
    """The verdict, the state that decides, and the error."""
    group, _ = begun(text, {'UAV': ('u1', 'u2')})
    for index, values in enumerate(states):
        for result in group.progress(index * 10**9, values):
            return result.verdict, index, str(result.error or '')
    return Verdict.UNDECIDED, None, ''


NEAR = [{'x': value, 's': 1.0} for value in (3.0, 2.5, 2.0, 1.5, 1.0)]


def test_a_formula_waits_for_the_probability_of_later_states() -> None:
    bounded = 'P(always[0, 2 s] normal(x, s) > 0)'
    assert progressed(f'{bounded} >= 0.9', NEAR) == (Verdict.TRUE, 2, '')
    assert progressed(f'not {bounded} >= 0.9', NEAR) == (Verdict.FALSE, 2, '')
    assert progressed(f'{bounded} < 0.9', NEAR) == (Verdict.FALSE, 2, '')
    assert progressed('P(always normal(x, s) > 0) >= 0.98', NEAR) == (Verdict.FALSE, 2, '')
    assert progressed('P(always normal(x, s) > 0) >= 0.5', NEAR) == (Verdict.UNDECIDED, None, '')
    each = 'forall u in UAV: P(always[0, 1 s] normal(Height[u], 1) > 0) > 0.9'
    states = [{'Height[u1]': 3.0, 'Height[u2]': 4.0}] * 3
    assert progressed(each, states) == (Verdict.TRUE, 1, '')


def test_a_probability_that_will_not_be_known_is_an_error() -> None:
    verdict, state, error = progressed('P(always[0, 2 s] normal(x, s) > 0) >= 0.97', NEAR)
    assert (verdict, state) == (Verdict.UNDECIDED, 2)
    assert 'is 0.96969 to 0.97725, assuming nothing about correlation' in error
    assert 'give the errors a time constant' in error
    # Until it matters, it is none.
    assert progressed('true or P(always[0, 2 s] normal(x, s) > 0) >= 0.97', NEAR)[2] == ''


def test_missing_states_leave_a_probability_unknown() -> None:
    texts = 'P(always[0, 2 s] normal(x, s) > 0) >= 0.9', 'always P(normal(x, s) > 0) >= 0.9'
    group = started(*texts)
    group.progress(0, NEAR[0])
    group.gap()
    results = [each for n in (5, 6, 7) for each in group.progress(n * 10**9, NEAR[0])]
    assert [each.verdict for each in results] == [Verdict.UNDECIDED]
    assert 'depends on states that are missing' in str(results[0].error)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('P(x > 1) > 0.5', 'nothing in'),
        ('normal(x, s) > 1', 'not known exactly'),
        ('P(x > 1) and p', "'P(x > 1)' is a number, not a formula"),
        ('always P(eventually[0, 1 s] x > 1) > 0.5', 'asked of the first state alone'),
        ('P(x > 1) = 0.5', 'not equal to a number'),
        ('P(x > 1) + 1 > 0.5', 'calculates with a probability'),
        ('P(prev(x) > 1) > 0.5', "'prev(x)' has no probability"),
        ('P(once x > 1) > 0.5', 'has no probability'),
        (
            (
                'forall r in R: P(over (near[a, b] for a, b in R) from r to s: '
                'somewhere[0, 2 hops] normal(x[s], 1) > 1) > 0.5'
            ),
            'has no probability',
        ),
        ('P(normal(x) > 1) > 0.5', "'normal' has a mean, a standard deviation"),
        ('P(normal(x, s, 2) > 1) > 0.5', "the time 2 of 'normal' has no unit"),
        ('P(normal(x, s) * normal(y, s) > 1) > 0.5', 'no sum of uncertain numbers'),
    ],
)
def test_formulas_without_a_probability(text: str, message: str) -> None:
    group = FormulaGroup()

    def begin() -> None:
        group.add_formula('it', text)
        group.begin({})

    with pytest.raises(DyKnowError) as caught:
        begin()
    assert message in caught.value.message


@pytest.mark.parametrize(
    'values',
    [{'x': 1.0, 's': -1.0}, {'x': float('inf'), 's': 1.0}, {'x': 'far', 's': 1.0}, {'x': 1.0}],
)
@pytest.mark.parametrize('constant', ['', ', 0 s', ', 1 s'])
def test_unusable_values_are_errors(values: Mapping[str, Any], constant: str) -> None:
    text = f'P(always[0, 1 s] normal(x, s{constant}) > 0) > 0.5'
    verdict, state, error = progressed(text, [NEAR[0], values, NEAR[0]])
    assert (verdict, state) == (Verdict.UNDECIDED, 1)
    assert error


def test_the_canonical_text_parses_to_the_same() -> None:
    text = 'P(always (normal(x, 2 * s, 1 s) > 3)) >= 0.5 or P(normal(x, s) < 1) < 0.1'
    formula = parse_formula(text)
    assert parse_formula(str(formula)) == formula


def test_units_of_uncertain_numbers() -> None:
    formula = parse_formula('let x: m in P(normal(x, 20 cm) > 1 km) > 0.9')
    assert str(formula) == 'P(normal(x, 0.2) > 1000.0) > 0.9'


@pytest.mark.parametrize(
    ('interval', 'text'),
    [
        (ProbabilityInterval(0.9871234, 1.0, 'so'), 'at least 0.987123, so'),
        (ProbabilityInterval(0.0, 0.25, 'so'), 'at most 0.25, so'),
        (ProbabilityInterval(0.0, 1.0, 'so'), 'unknown, so'),
        (ProbabilityInterval(0.25, 0.5, 'so'), '0.25 to 0.5, so'),
        (ProbabilityInterval(0.9999999, 0.9999999, 'so'), '0.9999999, so'),
    ],
)
def test_text_of_an_interval(interval: ProbabilityInterval, text: str) -> None:
    assert str(interval) == text


@pytest.mark.parametrize(
    ('lower', 'upper', 'bar'),
    [
        (0.99, 1.0, '█████████▒'),
        (0.3, 0.41, '███▒▒░░░░░'),
        (1.0, 1.0, '██████████'),
        (0.0, 0.0, '░░░░░░░░░░'),
    ],
)
def test_the_bar_of_an_interval_contains_it(lower: float, upper: float, bar: str) -> None:
    assert ProbabilityInterval(lower, upper, 'so').bar == bar


def test_a_group_gives_the_interval_of_all_probabilities_of_a_formula() -> None:
    group = FormulaGroup()
    each = group.add_formula('each', 'forall r in R: always P(normal(x[r], 1) > 0) >= 0.1')
    ahead = group.add_formula('ahead', 'P(always[0, 2 s] normal(y, 1, 0 s) > 0) >= 0.9')
    certain = group.add_formula('certain', 'always y > 0')
    asked = group.add_formula('asked', 'always P(normal(y, 1) > 0) >= 0.1', every_state=True)
    assert group.probability(each) is None
    group.begin({'R': ['a', 'b']})
    group.progress(0, {'x[a]': 1.0, 'x[b]': -1.0, 'y': 2.0})
    of_each, of_asked = group.probability(each), group.probability(asked)
    assert of_each is not None
    assert of_asked is not None
    assert isclose(of_each.lower, STANDARD.cdf(-1), abs_tol=ROUNDING)
    assert isclose(of_each.upper, STANDARD.cdf(1), abs_tol=ROUNDING)
    assert isclose(of_asked.lower, STANDARD.cdf(2), abs_tol=ROUNDING)
    assert str(group.probability(ahead)) == 'at most 0.97725, assuming independent errors'
    assert group.probability(certain) is None
    group.progress(1, {'x[a]': float('nan'), 'x[b]': 0.0, 'y': -9.0})
    assert group.probability(each) is None
    assert group.probability(ahead) is None


def test_features_whose_errors_are_stated() -> None:
    stated = 'let Height ~ normal(Height, sqrt(Variance), 2 s) in '
    formula = parse_formula(
        f'{stated}forall u in UAV: P(always Height[u] > 3) > 0.9 and Height[u] > 1'
    )
    assert str(formula) == (
        'forall u in UAV: ((P(always (normal(Height[u], sqrt(Variance[u]), 2 s) > 3)) > 0.9) '
        'and (Height[u] > 1))'
    )
    metres = 'let Height: m, Variance: m^2, '
    formula = parse_formula(f'{metres}{stated[4:]}P(Height > 30 cm) > 0.9')
    assert str(formula) == 'P(normal(Height, sqrt(Variance), 2 s) > 0.3) > 0.9'
    with pytest.raises(DyKnowError, match='normal\\(Height, DEVIATION\\)'):
        parse_formula('let Height ~ 3 in P(Height > 3) > 0.9')


@pytest.mark.parametrize(
    ('stated', 'found'),
    [
        ('let d = 2, x ~ normal(x, d)', 'normal(x, 2)'),
        ('let x ~ normal(x, d), d = 2', 'normal(x, 2)'),
        ('let d = 2 in let x ~ normal(x, d, 2 s)', 'normal(x, 2, 2 s)'),
        ('let d = 2, x ~ within(x, d + 1)', 'within(x, 2 + 1)'),
        ('let x ~ within(x, deviation)', 'within(x, 0.5)'),
        ('let x ~ normal(x, d) in let d = 2', "'d' is a feature here and a constant at 1:29"),
        ('let x = 3, x ~ normal(y, 1)', "'x' is a feature here and a constant at 1:5"),
        ('let d = y, x ~ normal(x, d)', "'d' is a kept value, which tells nothing of the errors"),
        ('let x ~ normal(x, 1), x ~ normal(x, 2)', "'x' is uncertain in two ways; state one"),
    ],
)
def test_errors_that_are_stated_with_constants(stated: str, found: str) -> None:
    constants = parse_constants({'deviation': '0.5'})
    if found.startswith("'"):
        with pytest.raises(DyKnowError, match=found):
            parse_formula(f'{stated} in P(x > 3) > 0.9', constants)
    else:
        formula = parse_formula(f'{stated} in P(x > 3) > 0.9', constants)
        assert str(formula) == f'P({found} > 3) > 0.9'


def test_the_probability_of_all_objects() -> None:
    each = 'forall u in UAV: normal(Height[u], 1, 0 s) > 0'
    probability = probability_of(f'P(always {each}) >= 0', {'UAV': ('u1', 'u2')})
    probability.step(0, {'Height[u1]': 1.0, 'Height[u2]': 2.0})
    expected = STANDARD.cdf(1) * STANDARD.cdf(2)
    assert probability.interval().upper == pytest.approx(expected)
    assert probability.interval_at_end().lower == pytest.approx(expected)


def test_a_probability_has_no_margin() -> None:
    with pytest.raises(DyKnowError, match='no margin is defined'):
        FormulaGroup().add_formula('it', 'always P(normal(x, s) > 0) > 0.5', margin=True)


def test_a_probability_of_later_states_is_asked_once() -> None:
    group = FormulaGroup()
    text = 'P(always normal(x, s) > 0) > 0.5'
    with pytest.raises(DyKnowError, match='asked of the first state alone'):
        group.add_formula('it', text, every_state=True)
    group.begin({})
    with pytest.raises(DyKnowError, match='asked of the first state alone'):
        group.keep_history(text)
    group.keep_history('P(normal(x, s) > 0) > 0.5')
    group.add_formula('it', 'always P(normal(x, s) > 0) > 0.5', every_state=True)
    for index, values in enumerate(NEAR):
        assert not group.progress(index, values)


@pytest.mark.parametrize(
    ('text', 'presumably_false'),
    [
        ('P(always normal(x, s) > 0) > 0.5', False),
        ('P(eventually normal(x, s) > 9) > 0.5', True),
        ('P(eventually normal(x, s) > 9) < 0.5', False),
        ('0.5 > P(eventually normal(x, s) > 9)', False),
        ('not P(always normal(x, s) > 0) > 0.5', True),
    ],
)
def test_an_open_probability_counts_as_its_formula_at_the_end(
    text: str,
    presumably_false: bool,  # noqa: FBT001
) -> None:
    group, formula_id = begun(text)
    for index, values in enumerate(NEAR[:2]):
        assert not group.progress(index, values)
    assert group.presumably_false(formula_id) is presumably_false
    assert group.residual(formula_id).startswith(('P(', '0.5 '))


@pytest.mark.parametrize('constant', ['', ', 0 s', ', 1 s'])
def test_a_guard_tries_a_probability_at_each_command(constant: str) -> None:
    text = f'Stopped or P(normal(Ahead, 0.5{constant}) > Speed) >= 0.95'
    trial = TrialFormula(f'always ({text})', {})
    found = []
    for time, speed in enumerate([0.1, 0.9, 3.0]):
        state = {'Stopped': False, 'Ahead': 1.5, 'Speed': speed}
        found.append(trial.holds(time, state))
        assert trial.holds(time, state | {'Stopped': True})
        trial.accept()
    # 2.8, 1.2 and -3 deviations.
    assert found == [True, False, False]


def test_a_guard_does_not_pass_what_is_not_known() -> None:
    trial = TrialFormula('P(normal(x, 1) > 0 and normal(y, 1) > 0) >= 0.8', {})
    assert trial.holds(0, {'x': 3.0, 'y': 3.0})
    assert not trial.holds(0, {'x': -3.0, 'y': 3.0})
    with pytest.raises(ReasoningError, match=r'not known to be on one side of 0\.8'):
        trial.holds(0, {'x': 1.0, 'y': 1.0})


def test_states_as_columns_give_the_same_verdicts() -> None:
    texts = [
        'always (busy -> P(normal(x, s) > 0) >= 0.9995)',
        'P(always[0, 3 s] normal(x, s, 1 s) > 0) >= 0.9',
        'P(always[0, 3 s] normal(x, s, 0 s) > 1) >= 0.9',
    ]
    generator = np.random.default_rng(5)
    columns = {
        'x': generator.normal(2.5, 0.4, 30),
        's': generator.uniform(0.5, 1, 30),
        'busy': generator.random(30) < 0.3,
    }
    at = np.arange(30) * 10**9
    found = []
    for many in (True, False):
        if many:
            results = started(*texts).progress_many(at, columns)
        else:
            rows = zip(*(each.tolist() for each in columns.values()), strict=True)
            states = [dict(zip(columns, row, strict=True)) for row in rows]
            results = progressed_over(started(*texts), list(zip(at.tolist(), states, strict=True)))
        found.append(sorted((each.formula_id, each.verdict, each.decided_at) for each in results))
    assert found[0] == found[1]
    assert len(found[0]) == 3


def test_uncertain_features_of_all_objects_in_one_number() -> None:
    text = (
        'let Height ~ normal(Height, 1, 0 s) in P(max(Height[u] for u in UAV) < 3 '
        'and exactly 0 u in UAV: Height[u] > 2) >= 0'
    )
    assert 'max(normal(Height[u], 1, 0 s) for u in UAV)' in str(parse_formula(text))
    probability = probability_of(text, {'UAV': ('u1', 'u2')})
    probability.step(0, {'Height[u1]': 1.0, 'Height[u2]': 1.0})
    found = probability.interval()
    assert found.lower < STANDARD.cdf(1) ** 2 < found.upper


def test_a_number_that_needs_no_state() -> None:
    assert progressed('P(normal(5, 1) > 3) >= 0.97 and x > 0', NEAR) == (Verdict.TRUE, 0, '')


def test_certain_numbers_have_a_certain_probability() -> None:
    states = [{'x': 2.0, 's': 0.0}] * 3
    assert progressed('P(always[0, 1 s] normal(x, s, 0 s) >= 2) >= 1', states)[0] is Verdict.TRUE
    assert progressed('P(always[0, 1 s] normal(x, s) >= 2) >= 1', states)[0] is Verdict.TRUE
    assert progressed('P(always[0, 1 s] normal(x, s, 0 s) > 2) > 0', states)[0] is Verdict.FALSE
    # What is equal up to rounding is not known to be less.
    half = [{'x': 2.0, 's': 1.0}] * 3
    assert 'not known' in progressed('P(normal(x, s) > 2) >= 0.5', half)[2]


@pytest.mark.parametrize('constant', ['', ', 0 s', ', 2 s'])
@pytest.mark.parametrize(
    ('atom', 'asked'),
    [
        ('X[a] - X[b] < 2', '>= 0.99'),
        ('X[b] - X[a] > c', '<= 0.01'),
        ('abs(X[a] - X[b]) < 1', '>= 0.99'),
        ('hypot(X[a] - X[b], Y[a] - Y[b]) > 0', '<= 0.01'),
        ('hypot(0 * X[a], Y[a] - Y[b], 0) <= 0', '>= 0.99'),
    ],
)
def test_errors_that_cancel_out_leave_a_certain_comparison(
    constant: str, atom: str, asked: str
) -> None:
    """As of an object with itself, among all pairs."""
    declared = f'let X ~ normal(X, 1{constant}), Y ~ normal(Y, 1{constant}) in '
    pairs = 'forall a in Robot: forall b in Robot: '
    bodies = (atom, f'always[0 s, 1 s] {atom}')
    texts = (f'{declared}{pairs}P({body}) {asked}' for body in bodies)
    group = started(*texts, domains={'Robot': ('r1',)})
    state = {'X[r1]': 0.3, 'Y[r1]': 2.0, 'c': 0.0}
    found = [each for second in range(3) for each in group.progress(second * 10**9, state)]
    assert [(each.verdict, each.error) for each in found] == [(Verdict.TRUE, None)] * 2


@pytest.mark.parametrize(
    ('number', 'other'),
    [
        ('normal(x, 1, 0 s)', 'normal(x, 1.0, 0 s)'),
        ('normal(x, 1 m, 0 s)', 'normal(x, 100 cm, 0 ms)'),
        ('normal(x, 0.35 m, 0 s)', 'normal(x, 35 cm, 0 s)'),
        ('within(x, 1 m)', 'within(x, 100 cm)'),
    ],
)
def test_equal_numbers_are_one_however_they_are_written(number: str, other: str) -> None:
    """They had independent errors: the chance that x is positive, and is not, was 0.25."""
    unit = ' m' if ' m' in number else ''
    begin = 'let x: m in ' if unit else ''
    comparisons = f'{number} > 0{unit} and {other} <= 0{unit}'
    assert progressed(f'{begin}P({comparisons}) > 0.0001', [{'x': 0.0}])[0] is Verdict.FALSE
