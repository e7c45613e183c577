"""Probabilities of formulas: do their intervals contain the truth, and what do they cost?

- calibration: cases with known noise. In each, a formula is asked over the same estimates, with
  errors that are drawn anew; the share of draws in which it holds is the truth. The exact
  probability must agree with it, the 95 % intervals of simulated runs must contain it in 94 % to
  97 % of the cases. Bounds that assume nothing must always contain it, whatever the correlation.
- cost: of a state, for ten formulas of each model.
- leakage: of the exact distribution, if fewer remaining formulas are followed than there are.

The truth comes from an implementation of its own here, over whole arrays of errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, sqrt
from time import process_time
from typing import Any
from unittest.mock import patch

import numpy as np
from parts import measure
from scipy.special import betaincinv

from dyknow_common import ProbabilityInterval
from dyknow_reasoning import probability_of
from dyknow_reasoning.execution.probability import formula_probability, simulation

SECOND = 10**9
STATES = 12
WINDOW = 3
FORMULA = 'always[0 s, 8 s] ({0} > -1 or eventually[0 s, 3 s] {0} > 1)'


def truth_of(numbers: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return in which runs FORMULA holds; a run is a row, with a state each second."""
    above = np.lib.stride_tricks.sliding_window_view(numbers > 1, WINDOW + 1, axis=1).any(axis=2)
    found: np.ndarray[Any, Any] = ((numbers[:, :9] > -1) | above[:, :9]).all(axis=1)
    return found


def errors(generator: np.random.Generator, runs: int, correlation: float) -> np.ndarray[Any, Any]:
    """Return errors of a first-order Gauss-Markov process."""
    found = generator.standard_normal((runs, STATES))
    for state in range(1, STATES):
        found[:, state] *= sqrt(1 - correlation**2)
        found[:, state] += correlation * found[:, state - 1]
    return found


def interval_of(constant: str, estimates: Sequence[float], *seed: int) -> ProbabilityInterval:
    """Return the interval of the probability of the formula over estimates.

    Args:
        constant: the last argument of `normal`, with a comma: how errors depend on time.
        estimates: one for each second.
        seed: of simulated errors, which each run has of its own.
    """
    number = f'normal(x, 1{constant})'
    probability = probability_of(f'P({FORMULA.format(number)}) >= 0', {})
    if seed:
        model = probability._model  # noqa: SLF001
        assert isinstance(model, simulation.SimulatedRuns)
        model._generator = np.random.default_rng(seed)  # noqa: SLF001
    for state, estimate in enumerate(estimates):
        probability.step(state * SECOND, {'x': float(estimate)})
    return probability.interval()


def calibration(*, quick: bool) -> dict[str, Any]:
    """Return how often the truth is in the intervals of each model.

    Of independent errors, the truth is the exact probability; that itself is compared with the
    share of true runs: its 95 % interval must contain the exact probability in 95 % of the cases.
    """
    runs = 100 if quick else 10_000
    generator = np.random.default_rng(1)
    covered = {'exact': 0, 'simulated': 0, 'bounds, independent': 0, 'bounds, correlated': 0}
    draw = 400
    tail = 0.025
    for index in range(runs):
        estimates = generator.normal(-0.5, 0.7, STATES)
        exact = interval_of(', 0 s', estimates)
        share = int(truth_of(estimates + errors(generator, draw, 0.0)).sum())
        lower = betaincinv(share, draw - share + 1, tail) if share else 0.0
        upper = betaincinv(share + 1, draw - share, 1 - tail) if share < draw else 1.0
        covered['exact'] += bool(lower <= exact.lower <= upper)
        # The simulation, of the same independent errors: 1 ns is as good as independent.
        interval = interval_of(', 1 ns', estimates, index, 7)
        covered['simulated'] += interval.lower <= exact.lower <= interval.upper
        bounds = interval_of('', estimates)
        covered['bounds, independent'] += bounds.lower <= exact.lower <= bounds.upper
        correlation = float(generator.choice([0.3, 0.9, 0.99]))
        share = truth_of(estimates + errors(generator, draw, correlation)).mean()
        slack = 5 * sqrt(max(share * (1 - share), 1 / draw) / draw)
        covered['bounds, correlated'] += bounds.lower - slack <= share <= bounds.upper + slack
    return {
        **{name: each / runs for name, each in covered.items()},
        'simulated, time constant 2 s': correlated_coverage(runs),
    }


def correlated_coverage(runs: int) -> float:
    """Return how often simulated intervals contain the truth, with a time constant of 2 s."""
    generator = np.random.default_rng(2)
    covered = 0
    estimates = generator.normal(-0.5, 0.7, STATES)
    share = truth_of(estimates + errors(generator, 1_000_000, exp(-0.5))).mean()
    for index in range(runs):
        interval = interval_of(', 2 s', estimates, index, 9)
        covered += interval.lower <= share <= interval.upper
    return covered / runs


FORMULAS = (
    'always[0 s, 1 h] {x} > 0',
    'always ({x} > 1 -> eventually[0 s, 2 s] {y} > 0)',
    'eventually[0 s, 1 h] ({x} < 0 or {y} < 0)',
    'always {x} - {y} < 9',
    'always ({x} > 0 and {y} > 0)',
    '{x} > 0 until[0 s, 1 h] {y} > 3',
    'always eventually[0 s, 1 s] {x} > 1',
    'always[0 s, 1 h] ({x} > -1 or {x} < -3)',
    'eventually[0 s, 1 h] always[0 s, 1 s] {y} > 1',
    'always not ({x} < 0 and {y} < 0)',
)


def cost(*, quick: bool) -> dict[str, float]:
    """Return the milliseconds of a state for ten formulas, with intervals asked for each time.

    They are asked anew after ROUND states, as those that are decided cost nothing. The time is that
    of the processor: simulated runs take 0.05 ms each, which other processes often interrupt.
    """
    states = 200 if quick else 1000
    generator = np.random.default_rng(3)
    rows = [
        {'x': float(x), 'y': float(y), 's': 1.0} for x, y in generator.normal(2, 0.5, (states, 2))
    ]
    found = {}
    for name, constant in (('bounds', ''), ('exact', ', 0 s'), ('simulated', ', 2 s')):
        terms = {each: f'normal({each}, s{constant})' for each in ('x', 'y')}
        asked = [f'P({text.format(**terms)}) >= 0' for text in FORMULAS]
        times = []
        for state, values in enumerate(rows):
            if state % ROUND == 0:
                running = [probability_of(text, {}) for text in asked]
            start = process_time()
            for each in running:
                each.step(state * SECOND // 10, values)
                each.interval()
            times.append(process_time() - start)
        found[name] = round(1000 * float(np.median(times)), 3)
    return found


ROUND = 100
"""The number of states of the formulas whose cost is measured."""

KNOWN = 'normal(x, 1, 0 s) > 0'
LEAKY = f'always ({KNOWN} or eventually[0 s, 100 s] always[0 s, 10 s] {KNOWN})'
UNKNOWN = 0.2
"""The part of the states at which the proposition is as likely true as false."""
ENOUGH = 0.99
"""The part of the probability that is decided, or has leaked, at the end of a run."""


def leakage(*, quick: bool) -> dict[str, dict[str, float]]:
    """Return what is decided and what leaks, by the most remaining formulas that are followed.

    The formula and the kind of states are those of the experiments with leaky progression graphs
    (de Leng and Heintz, Approximate Stream Reasoning with Metric Temporal Logic under Uncertainty,
    AAAI 2019; their program is github.com/dnleng/jprogress). It ends once 99 % are decided or have
    leaked.
    """
    states = 10_000 if quick else 100_000
    found = {}
    for limit in (5, 10, 20, 50, 100, 150, 190, 2000):
        generator = np.random.default_rng(1)
        probability = probability_of(f'P({LEAKY}) >= 0', {})
        model: Any = probability._model  # noqa: SLF001 - what it follows is measured
        decided = leaked = 0.0
        most = state = 0
        with patch.object(formula_probability, 'MAX_REMAINDERS', limit):
            while state < states and decided + leaked < ENOUGH:
                is_unknown = generator.random() < UNKNOWN
                probability.step(state * SECOND, {'x': 0.0 if is_unknown else 1e6})
                decided = sum(model._decided.values())  # noqa: SLF001
                leaked = 1 - decided - sum(model._open.values())  # noqa: SLF001
                most, state = max(most, len(model._open)), state + 1  # noqa: SLF001
        parts = {'decided': round(decided, 4), 'leaked': round(abs(leaked), 4)}
        found[str(limit)] = {'nodes': most, 'states': state, **parts}
    return found


if __name__ == '__main__':
    measure(__doc__, calibration, cost, leakage)
