"""The drift of forecasts: its test, and the values that it compares."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import accumulate, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded_flow import Flow

from dyknow_stream_processing.dataflow.drift import SIGNIFICANCE, WINDOW, Coverage, DriftTest
from dyknow_stream_processing.dataflow.forecasts import ConstantVelocity

SECOND = 10**9
MS = 10**6
PROMISE = Coverage(0.95, 40, SECOND)


def test_promises_are_texts() -> None:
    assert Coverage.parse(str(PROMISE)) == PROMISE
    assert str(PROMISE) == '0.95 of 40 blocks of 1 s'


@pytest.mark.parametrize(
    'text',
    ['0.95', '1.5 of 40 blocks of 1 s', '0.9 of 4 blocks of 0 s', '. of 4 blocks of 1 s', ''],
)
def test_other_texts_promise_nothing(text: str) -> None:
    with pytest.raises(ValueError, match=r'is no coverage|could not convert'):
        Coverage.parse(text)


@given(st.floats(0.5, 0.999), st.integers(1, 200), st.integers(0, 30), st.integers(0, 30))
def test_the_chance_is_that_of_an_urn(coverage: float, blocks: int, one: int, other: int) -> None:
    """Each value outside makes the next one likelier, as a ball that is put back with another."""
    outside, values = min(one, other), max(one, other)
    a, total = (1 - coverage) * (blocks + 1), float(blocks + 1)
    chances = [1.0]
    for drawn in range(values):
        more = [each * (a + k) / (total + drawn) for k, each in enumerate(chances)]
        fewer = [each - up for each, up in zip(chances, more, strict=True)]
        chances = [low + high for low, high in zip([*fewer, 0.0], [0.0, *more], strict=True)]
    found = Coverage(coverage, blocks, SECOND).chance(outside, values)
    assert math.isclose(found, sum(chances[outside:]), rel_tol=1e-6, abs_tol=1e-12)


def noted(
    test: DriftTest, seconds: int, error: Callable[[int], float], begin: int = 0
) -> list[str]:
    """Note values of 0, of which errors are forecast, and return the warning after each second."""
    found = []
    for second in range(begin, begin + seconds):
        for part in range(10):
            test.note(second * SECOND + part * 100 * MS, 0.0, error(second), 1.0)
        found.append(test.warning)
    return found


def test_a_drift_is_noticed_and_forgotten() -> None:
    test = DriftTest(PROMISE, SECOND, 500 * MS)
    assert not any(noted(test, 2 * WINDOW, lambda second: 2.0 * (second % 20 == 0)))
    late = noted(test, WINDOW, lambda _: 1.5, 2 * WINDOW)
    assert ' of the last 100 values, at most one in each 1 s, were outside' in late[-1]
    assert 5 < next(second for second, each in enumerate(late) if each) < 40
    assert not noted(test, 2 * WINDOW, lambda _: -0.5, 3 * WINDOW)[-1]


def test_new_forecasts_that_are_all_wrong_are_noticed_soon() -> None:
    found = noted(DriftTest(PROMISE, SECOND, 500 * MS), 10, lambda _: -1.5)
    assert next(second for second, each in enumerate(found) if each) <= 7


@given(
    st.lists(st.tuples(st.integers(1, 40), st.floats(-2, 2)), min_size=2, max_size=90),
    st.integers(1, 30),
    st.integers(1, 30),
    st.integers(1, 40),
)
def test_values_are_compared_with_what_was_forecast(
    samples: list[tuple[int, float]], horizon: int, block: int, step: int
) -> None:
    test = DriftTest(Coverage(0.5, 1, block), horizon, step)
    times = list(accumulate(step for step, _ in samples))
    values = [value for _, value in samples]
    begins: list[int] = []
    for number, (time, value) in enumerate(zip(times, values, strict=True)):
        before = test._pending
        test.note(time, value, -value, 1.0)
        test.note(time - 1, math.nan, math.nan, 1.0)  # As if a batch were computed again.
        if test._pending != before and test._pending:
            begins.append(number)
    expected = []
    for begin in begins:
        due = times[begin] + horizon
        after = next((each for each in range(len(times)) if times[each] >= due), None)
        if after is None:
            continue
        gap, period = times[after] - times[after - 1], 0
        if after > 1:
            period = times[after - 1] - times[after - 2]
        if times[after] == due or gap <= max(step, 3 * period):
            expected.append(abs(np.interp(due, times, values) + values[begin]) > 1.0)
    assert list(test._outside) == expected[-WINDOW:]
    assert begins[0] == 0
    for one, other in pairwise(begins):
        # No two forecasts are open at once, and there is one in each block.
        assert times[other] >= times[one] + horizon
        assert times[other] - times[0] >= (begins.index(other) - 1) * block


def test_gaps_and_unknown_values_tell_nothing() -> None:
    test = DriftTest(PROMISE, SECOND, 100 * MS)
    for number in range(200):
        test.note(number * 10 * SECOND, 0.0, math.nan if number % 2 else 9.0, 1.0)
        test.note(number * 10 * SECOND + 100 * MS, math.nan, math.nan, 1.0)
    assert not test._outside


def test_the_chance_of_a_wrong_warning_is_that_of_the_significance() -> None:
    """Conformal calibrations by a few scores each: the number of values outside is as promised."""
    random = np.random.default_rng(2)
    runs, low = 1500, 0
    for _ in range(runs):
        limit = np.sort(random.normal(size=39))[37]  # 38 of 40: a coverage of 0.95
        outside = int((random.normal(size=60) > limit).sum())
        low += Coverage(0.95, 39, 1).chance(outside, 60) < 0.02
    # Not so of a binomial distribution: 8 % of the calibrations would be blamed.
    assert low / runs < 0.02 + 3 * math.sqrt(0.02 / runs)
    assert SIGNIFICANCE < 0.02


def test_a_stream_warns(flow: Flow) -> None:
    unit = 'compunit bound: float constant_velocity((value: float, rate: float)); '
    use = (
        'sink constant_velocity("/odom", horizon = 1 s, step = 1 s, bound = "{}", '
        'widening = "0 0.5; 0.95 of 40 blocks of 1 s")'
    )
    flow.create(unit + use.format('low'), 'low').create(unit + use.format('high'), 'high')
    for second in range(20):
        flow.push('/odom', 1000 * second, value=0.0, rate=0.25)
    assert not flow.dataflow.warnings()
    for second in range(20, 50):
        flow.push('/odom', 1000 * second, value=0.0, rate=-0.75)
    (warning,) = flow.dataflow.warnings()
    assert warning.startswith("stream 'low': ")
    assert 'forecast 1 s before, and 0.05 of them may be' in warning


def test_a_forecast_without_a_promise_has_no_drift() -> None:
    unit = ConstantVelocity(1000 * MS, 500 * MS, widening='0 1 2')
    for second in range(50):
        unit({'value': 9.0 * (second % 2), 'rate': 0.0}, valid_time=second * SECOND)
    assert unit.drift is None
