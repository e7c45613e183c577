"""Probabilities of numbers with samples against counts."""

from __future__ import annotations

from collections.abc import Sequence
from math import erf
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reasoning_reference import begun
from scipy.stats import binomtest

from dyknow_common import DyKnowError, ProbabilityInterval
from dyknow_reasoning import parse_formula
from dyknow_reasoning.execution import probability_of

X, Y = 'sampled(x, xs)', 'sampled(y, ys)'
FORMULAS: Sequence[tuple[str, Any]] = (
    (f'{X} > 1', lambda x, _: x > 1),
    (f'{X} > 1 and {Y} <= 2', lambda x, y: x > 1 and y <= 2),
    (f'{X} > 1 or {X} <= 0', lambda x, _: x > 1 or x <= 0),
    (f'not ({X} >= {Y} -> {Y} = 0)', lambda x, y: x >= y and y != 0),
    (f'hypot({X}, {Y}) < limit', lambda x, y: (x * x + y * y) ** 0.5 < 2.5),
    (
        f'at least 2 of ({X} > 0, {Y} > 0, {X} - {Y} > 1)',
        lambda x, y: (x > 0) + (y > 0) + (x - y > 1) > 1,
    ),
)
NUMBERS = st.integers(-4, 8).map(lambda value: value / 2)
PARTICLES = st.lists(st.tuples(NUMBERS, NUMBERS), min_size=1, max_size=40)


def cloud(particles: Sequence[tuple[float, float]]) -> dict[str, Any]:
    x, y = (' '.join(map(repr, each)) for each in zip(*particles, strict=True))
    return {'x': 0.0, 'y': 0.0, 'xs': x, 'ys': y, 'limit': 2.5}


def interval(text: str, values: dict[str, Any]) -> ProbabilityInterval:
    probability = probability_of(f'P({text}) >= 0', {})
    probability.step(0, values)
    assert probability.is_final
    assert probability.interval() == probability.interval_at_end()
    return probability.interval()


@given(st.sampled_from(FORMULAS), PARTICLES)
def test_particles_are_counted(
    asked: tuple[str, Any], particles: Sequence[tuple[float, float]]
) -> None:
    text, holds = asked
    found = interval(text, cloud(particles))
    held = sum(bool(holds(*each)) for each in particles)
    expected = binomtest(held, len(particles)).proportion_ci(method='exact')
    assert found.lower == pytest.approx(expected.low, abs=1e-9)
    assert found.upper == pytest.approx(expected.high, abs=1e-9)


def covered(seed: int) -> bool:
    """Return True if the interval of 100 particles contains the probability."""
    generator = np.random.default_rng(seed)
    limit = float(generator.uniform(-2, 2))
    particles = generator.multivariate_normal([0, 0], [[1, 0.6], [0.6, 1]], 100)
    found = interval(f'{X} + {Y} > limit', {**cloud(particles.tolist()), 'limit': limit})
    truth = 0.5 * (1 - erf(limit / 6.4**0.5))
    return bool(found.lower <= truth <= found.upper)


def test_the_interval_has_its_confidence() -> None:
    """At least 95 % of 200, which are 190 with a deviation of 3."""
    assert sum(map(covered, range(200))) >= 180


def test_a_formula_asks_for_the_share_of_samples_at_each_state() -> None:
    text = 'let x ~ sampled(x, xs) in forall r in R: always P(x[r] > 1) > 0.5'
    group, asked = begun(text, {'R': ['a']})
    many = ' '.join(['2'] * 90 + ['0'] * 10)
    assert not group.progress(0, {'x[a]': 1.0, 'xs[a]': many})
    found = group.probability(asked)
    assert found is not None
    assert 0.82 < found.lower < 0.9 < found.upper < 0.96
    (result,) = group.progress(1, {'x[a]': 1.0, 'xs[a]': '2 0'})
    assert 'with 95 % confidence, of independent samples, which is not known' in str(result.error)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        (f'always {X} > 1', 'samples are those of one state'),
        (f'{X} > 1 and normal(y, 1) > 1', 'samples are those of one state'),
        (f'{X} > 1 and {Y} > 1', 'differ in number: .*x.*: 2, .*y.*: 3'),
        ('sampled(x, word) > 1', "samples of 'x' are 'far'"),
        ('sampled(x, none) > 1', "samples of 'x' are ''"),
        ('sampled(x, nan) > 1', "samples of 'x' are 'nan 1'"),
        ('sampled(x, 3) > 1', 'it must be a string'),
        ('normal(x, 1, covariance(y, 1)) > sampled(y, ys)', 'last equally long'),
    ],
)
def test_samples_that_are_errors(text: str, message: str) -> None:
    values = {'x': 0.0, 'y': 0.0, 'xs': '1 2', 'ys': '1 2 3'}
    with pytest.raises(DyKnowError, match=message):
        interval(text, {**values, 'word': 'far', 'none': '', 'nan': 'nan 1'})


def test_the_canonical_text_parses_to_the_same() -> None:
    formula = parse_formula(f'P({X} > 1 and {Y} > 2) > 0.5')
    assert parse_formula(str(formula)) == formula
