"""Values of which clocks leave several possible pass through streams, or are refused."""

from __future__ import annotations

import pytest
from recorded_flow import Flow

from dyknow_common import Alternatives, Value

REASON = 'the clocks of a and b differ by 1.2 s plus or minus 400 ms'


def either(*values: Value) -> Value:
    return Alternatives.of(values, REASON)


def test_streams_pass_them_on(flow: Flow) -> None:
    flow.create('sync(select x as a from "a", select y as b from merge("b", "c"))')
    flow.push('a', 0, x=either(1.0, 2.0))
    flow.push('c', 0, y=True)
    flow.push('b', 0, y=either(False, True))
    flow.push('a', 1, x=2.0)
    flow.push('b', 2, y=True)
    flow.push('c', 2, y=True)
    found = flow.take()
    assert {'a': either(1.0, 2.0), 'b': either(False, True)} in [each for _, each in found]
    assert not flow.broken()


@pytest.mark.parametrize(
    'text',
    [
        'select x from "a" with max_delay = 1 ms, max_gap = 9 ms, expires = true',
        'select x unless y > 3.0 from "a"',
    ],
)
def test_numbers_that_may_be_unknown_may_be_open(flow: Flow, text: str) -> None:
    flow.create(text)
    flow.push('a', 0, x=either(1, 2.0), y=0.0)
    flow.push('a', 1, x=either(1.0, True), y=0.0)
    flow.push('a', 2, x=1, y=0.0)
    flow.advance(4)
    assert flow.take() == [(0, {'x': either(1, 2.0)}), (2, {'x': 1.0})]
    (violation,) = flow.violations
    assert 'true (boolean) is not a number' in violation.message


def test_results_have_alternatives_too(flow: Flow) -> None:
    flow.create(
        'compunit p: float electrical_power((voltage: float, current: float)); '
        'sink electrical_power("a")'
    )
    flow.push('a', 0, voltage=either(10.0, 12.0), current=-2.0)
    flow.push('a', 1, voltage=either(10.0, 12.0), current=0.0)
    assert flow.take() == [(0, {'p': either(20.0, 24.0)}), (1, {'p': 0.0})]


def test_an_interval_is_converted_and_otherwise_not_calculated_with(flow: Flow) -> None:
    flow.create(
        'compunit x: float convert(x: float); sink convert("a", given = "m", wanted = "cm");'
    )
    flow.push('a', 0, x=Alternatives.between([1.0, 0.5, 1.5], REASON))
    ((_, fields),) = flow.take()
    value = fields['x']
    assert isinstance(value, Alternatives)
    assert value.is_interval
    assert value.bounds == pytest.approx((50, 150))
    assert value.reason == REASON


def test_functions_of_intervals_are_refused(flow: Flow) -> None:
    flow.create(
        'compunit p: float electrical_power((voltage: float, current: float)); '
        'sink electrical_power("a")'
    )
    flow.push('a', 0, voltage=Alternatives.between([1.0, 0.5, 1.5], REASON), current=-2.0)
    (violation,) = flow.violations
    assert 'it is a number from 0.5' in str(violation.message)


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        (
            'compunit y: float mean((x: float)); sink mean("a")',
            "given to the computational unit 'mean', which depends on its time",
        ),
        ('sync("a") with approximation = linear, sample_period = 1 ms', 'interpolated'),
        ('select x from "a" where x > 0.5', 'compared by a stream'),
        ('select x as x_%x% from "a"', 'part of a name'),
    ],
)
def test_what_cannot_use_them_says_so(flow: Flow, text: str, reason: str) -> None:
    flow.create(text)
    flow.push('a', 0, x=1.0)
    flow.push('a', 2, x=either(1.0, 2.0))
    (violation,) = flow.violations
    assert f"field 'x' is one of 2 values, as {REASON}, so it cannot be {reason}" in str(
        violation.message
    )


@pytest.mark.parametrize(
    'text',
    [
        'compunit y: float mean((x: float)); sink mean("a")',
        'sync("a") with approximation = linear',
    ],
)
def test_what_depends_on_times_is_refused_from_then_on(flow: Flow, text: str) -> None:
    """The time of the next sample is open, too, though its value is not."""
    flow.create(text)
    flow.push('a', 0, x=1.0)
    assert flow.times() == [0]
    flow.push('a', 1, x=either(1.0, 2.0))
    flow.push('a', 2, x=2.0)
    flow.push('a', 3, x=2.0)
    assert flow.times() == []
    assert [time for _, time in flow.broken()] == [1, 2, 3]
