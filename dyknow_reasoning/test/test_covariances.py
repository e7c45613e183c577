"""Probabilities of numbers with covariances against multivariate normal distributions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import exp, sqrt
from statistics import NormalDist
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import COMPARISONS, DyKnowError, ProbabilityInterval
from dyknow_reasoning import parse_formula
from dyknow_reasoning.execution import probability_of
from dyknow_reasoning.execution.probability.distributions import StateDistribution

STANDARD = NormalDist()
NAMES = 'xyz'
PAIRS = ('x', 'y'), ('x', 'z'), ('y', 'z')
SEEDS = st.integers(0, 10**6)


def normal(name: str, time: str = '', objects: str = '') -> str:
    """A number with the covariances that a state gives it, from the first one of each pair on."""
    covariances = ''.join(
        f', covariance({b}{objects}, c{a}{b}{objects})' for a, b in PAIRS if a == name
    )
    return f'normal({name}{objects}, s{name}{objects}{time}{covariances})'


def state(mean: Sequence[float], matrix: Any, objects: str = '') -> dict[str, float]:
    found = {}
    for index, name in enumerate(NAMES):
        found[f'{name}{objects}'] = float(mean[index])
        found[f's{name}{objects}'] = sqrt(matrix[index][index])
    for a, b in PAIRS:
        found[f'c{a}{b}{objects}'] = float(matrix[NAMES.index(a)][NAMES.index(b)])
    return found


def random_matrix(generator: np.random.Generator) -> Any:
    """The covariances of three numbers, of a smaller rank at times."""
    factors = generator.normal(size=(3, int(generator.integers(1, 4))))
    return factors @ factors.T


def interval(text: str, *states: Mapping[str, Any]) -> ProbabilityInterval:
    probability = probability_of(f'P({text}) >= 0', {})
    for second, each in enumerate(states):
        probability.step(second * 10**9, each)
    return probability.interval()


@given(SEEDS, st.sampled_from(['', ', 0 s', ', 2 s']))
def test_a_sum_is_exact(seed: int, time: str) -> None:
    generator = np.random.default_rng(seed)
    matrix, mean = random_matrix(generator), generator.normal(size=3)
    factors, limit = generator.normal(size=3).round(2), float(generator.normal())
    terms = [
        f'{factor} * {normal(name, time)}' for factor, name in zip(factors, NAMES, strict=True)
    ]
    found = interval(f'{" + ".join(terms)} > limit', {**state(mean, matrix), 'limit': limit})
    deviation = sqrt(factors @ matrix @ factors)
    truth = STANDARD.cdf((factors @ mean - limit) / deviation)
    assert found.lower == pytest.approx(truth, abs=1e-6)
    assert found.upper == pytest.approx(truth, abs=1e-6)
    assert found.assumption.endswith('but for the covariances')


@given(SEEDS)
def test_two_groups_have_bounds_for_any_dependence(seed: int) -> None:
    """The errors of two robots, whose sums have any correlation."""
    generator = np.random.default_rng(seed)
    matrices = [random_matrix(generator) for _ in range(2)]
    means = [generator.normal(size=3) for _ in range(2)]
    values: dict[str, float] = {'limit': float(generator.normal())}
    for name, mean, matrix in zip('ab', means, matrices, strict=True):
        values |= state(mean, matrix, f'[{name}]')
    terms = [normal(each, '', f'[{robot}]') for robot in 'ab' for each in NAMES]
    found = interval(f'{" + ".join(terms)} > limit', values)
    first, second = (sqrt(np.sum(each)) for each in matrices)
    for correlation in (-1.0, -0.4, 0.0, 0.7, 1.0):
        deviation = sqrt(first**2 + second**2 + 2 * correlation * first * second) or 1e-12
        truth = STANDARD.cdf((float(np.sum(means)) - values['limit']) / deviation)
        assert found.lower - 1e-9 <= truth <= found.upper + 1e-9


@given(SEEDS)
def test_bounds_of_several_sums_hold(seed: int) -> None:
    generator = np.random.default_rng(seed)
    matrix, mean = random_matrix(generator), generator.normal(0.5, 1, size=3)
    x, y, z = map(normal, NAMES)
    found = interval(f'({x} > 0 or {y} > {z}) and {x} + {y} > 0', state(mean, matrix))
    a, b, c = generator.multivariate_normal(mean, matrix, 4000).T
    share = (((a > 0) | (b > c)) & (a + b > 0)).mean()
    assert found.lower - 0.04 <= share <= found.upper + 0.04


def distances(seed: int) -> tuple[ProbabilityInterval, float]:
    """The interval of the distance of a point in the plane, and the probability."""
    generator = np.random.default_rng(seed)
    matrix, mean = random_matrix(generator), generator.normal(size=3)
    limit = float(generator.uniform(0.3, 3))
    # Several atoms are simulated; each formula draws other errors.
    text = f'hypot({normal("x")}, {normal("y")}) < {limit} and abs({normal("x")}) < 1000'
    return interval(text, state(mean, matrix)), chance_within(mean[:2], matrix[:2, :2], limit)


def chance_within(mean: Any, matrix: Any, radius: float) -> float:
    """Integrate over one axis of the distribution."""
    scales, axes = np.linalg.eigh(matrix)
    near, far = sqrt(max(scales[0], 0)), sqrt(scales[1])
    at = axes.T @ mean
    edges = np.linspace(-8, 8, 1601)
    total = 0.0
    for middle in (edges[1:] + edges[:-1]) / 2:
        height = radius**2 - (at[1] + far * middle) ** 2
        if height <= 0:
            continue
        side = sqrt(height)
        inside = float(abs(at[0]) < side)
        if near > 1e-7:
            inside = STANDARD.cdf((side - at[0]) / near) - STANDARD.cdf((-side - at[0]) / near)
        total += inside * exp(-middle * middle / 2) * 0.01 / sqrt(2 * np.pi)
    return total


@given(SEEDS, st.sampled_from(['<', '<=', '>', '>=', '=', '!=']))
def test_a_distance_has_certain_bounds(seed: int, operator: str) -> None:
    generator = np.random.default_rng(seed)
    # Of any scales, also where the error is along a line.
    scales = 10.0 ** generator.uniform(-1.5, 1, size=(3, 1))
    factors = scales * generator.normal(size=(3, int(generator.integers(1, 4))))
    matrix, mean = factors @ factors.T, generator.uniform(0, 3) * generator.normal(size=3)
    values = {**state(mean, matrix), 'limit': float(generator.uniform(0.05, 4))}
    found = interval(f'limit {operator} hypot({normal("x")} - 1, {normal("y")})', values)
    points = generator.multivariate_normal(mean, matrix, 10_000)
    distances = np.hypot(points[:, 0] - 1, points[:, 1])
    share = COMPARISONS[operator](values['limit'], distances).mean()
    slack = 6 * sqrt(max(share * (1 - share), 1e-4) / 10_000)
    assert found.lower - slack <= share <= found.upper + slack
    assert found.upper - found.lower < 0.005
    assert found.assumption == 'assuming nothing about correlation but for the covariances'


@given(SEEDS, st.sampled_from([(1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (1.0, 1.0, 1.0)]))
def test_a_distance_in_space_has_certain_bounds(seed: int, spread: Sequence[float]) -> None:
    """Of any scales, also where the error is along a line or in a plane."""
    generator = np.random.default_rng(seed)
    scales = 10.0 ** generator.uniform(-1.5, 1, size=3) * spread
    factors = np.linalg.qr(generator.normal(size=(3, 3)))[0] * scales
    matrix, mean = factors @ factors.T, generator.uniform(0, 3) * generator.normal(size=3)
    values = {**state(mean, matrix), 'limit': float(generator.uniform(0.05, 4))}
    found = interval(f'hypot({", ".join(map(normal, NAMES))}) < limit', values)
    points = mean + generator.normal(size=(10_000, 3)) @ factors.T
    share = float((np.linalg.norm(points, axis=1) < values['limit']).mean())
    slack = 6 * sqrt(max(share * (1 - share), 1e-4) / 10_000)
    assert found.lower - slack <= share <= found.upper + slack
    assert found.upper - found.lower < 0.04
    assert found.assumption == 'assuming nothing about correlation but for the covariances'


@pytest.mark.parametrize('radius', [0.1, 1.0, 2.0, 4.0])
def test_a_distance_in_space_from_the_center(radius: float) -> None:
    """Its square has a chi-square distribution with three degrees of freedom."""
    found = interval(
        f'hypot({", ".join(map(normal, NAMES))}) < {radius}', state([0.0, 0.0, 0.0], np.eye(3))
    )
    truth = 2 * STANDARD.cdf(radius) - 1 - sqrt(2 / np.pi) * radius * exp(-(radius**2) / 2)
    assert found.lower <= truth <= found.upper
    assert found.upper - found.lower < 0.04


@given(st.floats(-3, 3), st.just(0.0) | st.floats(1e-6, 2), st.floats(-1, 3))
def test_a_size_is_exact(mean: float, deviation: float, limit: float) -> None:
    found = interval('abs(normal(x, s)) <= limit', {'x': mean, 's': deviation, 'limit': limit})
    truth = float(abs(mean) <= limit)
    if deviation:
        error = NormalDist(mean, deviation)
        truth = max(0.0, error.cdf(limit) - error.cdf(-limit))
    assert (found.lower, found.upper) == pytest.approx((truth, truth), abs=1e-9)


@pytest.mark.parametrize('distance', [1.0, 1 + 1e-9, 1 - 1e-9, 1e-3])
def test_bounds_of_a_distance_hold_where_a_line_of_errors_touches_the_circle(
    distance: float,
) -> None:
    """The error is along a line that has a distance of 1 from zero; rounding hides that."""
    angle = 0.3
    along = np.array([-np.sin(angle), np.cos(angle), 0.0])
    mean = np.array([np.cos(angle), np.sin(angle), 0.0])
    found = interval(
        f'hypot({normal("x")}, {normal("y")}) < {distance}', state(mean, np.outer(along, along))
    )
    half = sqrt(max(distance**2 - 1, 0))
    truth = 2 * STANDARD.cdf(half) - 1
    assert found.lower <= truth + 1e-12
    assert truth <= found.upper
    assert found.upper < 0.01


def test_distances_over_time_have_bounds_without_a_time_constant() -> None:
    values = state([2.0, 0.0, 0.0], 0.25 * np.eye(3))
    text = f'hypot({normal("x")}, {normal("y")}) > 0.5'
    single = interval(text, values)
    found = interval(f'always[0, 1 s] {text}', values, values)
    assert found.lower == pytest.approx(2 * single.lower - 1, abs=1e-9)
    assert found.upper == pytest.approx(single.upper, abs=1e-9)


def test_the_interval_of_a_distance_has_its_confidence() -> None:
    """All of 200 models; 95 % of them are 190, with a deviation of 3."""
    covered = sum(
        found.lower - 1e-3 <= truth <= found.upper + 1e-3
        for found, truth in map(distances, range(200))
    )
    assert covered >= 178


def test_simulated_numbers_have_their_covariances() -> None:
    """Also over time: the errors of a long time constant stay."""
    matrix = np.array([[1.0, -0.9, 0.3], [-0.9, 2.0, 0.1], [0.3, 0.1, 0.5]])
    x, y = normal('x', ', 1 h'), normal('y', ', 1 h')
    values = state([0.0, 0.0, 0.0], matrix)
    found = interval(f'always[0, 2 s] abs({x} + {y}) < 1', values, values, values)
    truth = 2 * STANDARD.cdf(1 / sqrt(1 + 2 - 1.8)) - 1
    assert found.lower < truth < found.upper
    assert found.upper - found.lower < 0.1


def test_functions_at_one_state_need_all_covariances_or_time_constants() -> None:
    values = state([1.0, 1.0, 1.0], np.eye(3))
    assert 'simulated' in interval('max(normal(x, sx), 0) < 1', values).assumption
    for text in ('hypot(normal(x, sx), normal(y, sy)) < 1', f'always max({normal("x")}, 0) < 1'):
        with pytest.raises(DyKnowError, match='covariances, then runs are'):
            interval(text, values)


# Each of three numbers goes with one of the others, and against the third.
THREE = (
    'normal(x, 1, covariance(y, 0.9), covariance(z, 0.9))',
    'normal(y, 1, covariance(z, -0.9))',
)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('normal(x, 1, covariance(y, 0)) + normal(y, 1, 1 s) > 0', 'last equally long'),
        ('normal(x, 1, covariance(y, 0)) + within(y, 1) > 0', 'last equally long'),
        (
            'normal(x, 1, covariance(y, 0)) + normal(y, 1, covariance(x, 0)) > 0',
            'two covariances',
        ),
        (
            'normal(x, 1, covariance(y, 0), covariance(z, 0)) + normal(y, 1) > normal(z, 1)',
            "'[yz]' and '[yz]' have covariances with one number",
        ),
        ('normal(x, 1, covariance(y, 2)) + normal(y, 1) > 0', 'more than the product'),
        ('normal(x, 1, covariance(y, 0 / 0)) + normal(y, 1) > 0', 'zero'),
        (f'{THREE[0]} > {THREE[1]} + normal(z, 1)', 'those of no distribution'),
        (f'abs({THREE[0]}) > {THREE[1]} + normal(z, 1)', 'those of no distribution'),
        ('normal(x, 1, 1 s, 2 s) > 0', 'second time constant'),
        ('normal(x, 1, covariance(y, 2 m)) > 0', 'a plain number; remove its unit'),
        ('covariance(x, y) > 0', r'stands in normal\(...\) only'),
    ],
)
def test_covariances_that_are_errors(text: str, message: str) -> None:
    with pytest.raises(DyKnowError, match=message):
        interval(text, {'x': 0.0, 'y': 0.0, 'z': 0.0})


def test_stated_covariances_are_those_with_features_of_the_probability() -> None:
    stated = 'let x ~ normal(x, sx, covariance(y, cxy)), y ~ normal(y, sy) in forall r in R: '
    one = parse_formula(f'{stated}P(x[r] > 1) > 0.5 and y[r] > 1')
    assert str(one) == str(
        parse_formula('forall r in R: P(normal(x[r], sx[r]) > 1) > 0.5 and y[r] > 1')
    )
    both = str(parse_formula(f'{stated}P(x[r] > y[r]) > 0.5'))
    assert 'normal(x[r], sx[r], covariance(y[r], cxy[r])) > normal(y[r], sy[r])' in both
    assert str(parse_formula(both)) == both


def test_numbers_without_covariances_are_groups_of_one() -> None:
    atoms = [parse_formula(f'P(normal({each}, 1) > 0) > 0') for each in NAMES]
    distribution = StateDistribution([each.left.body for each in atoms], {}, 0b111)
    assert not distribution.has_covariances
    assert not distribution.is_joint
    assert not list(distribution.covariance_matrices({}, []))
