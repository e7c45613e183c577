"""Measurement of the flow of a stream."""

from hypothesis import given
from hypothesis import strategies as st

from dyknow_stream_processing import Sample
from dyknow_stream_processing.reporting.stream_report import NO_FLOW, Flow, FlowMeter

SECOND = 1_000_000_000


def sample(delay: int) -> Sample:
    return Sample(SECOND, SECOND + delay, {})


@given(st.lists(st.lists(st.integers(-SECOND, SECOND), max_size=9), max_size=4))
def test_each_period_is_measured_by_itself(periods: list[list[int]]) -> None:
    meter = FlowMeter(0)
    for number, delays in enumerate(periods, start=1):
        for delay in delays:
            meter.note(sample(delay))
        flow = meter.measure(2 * SECOND * number)
        if delays:
            assert flow == Flow(len(delays) / 2, sum(delays) // len(delays), max(delays))
        else:
            assert flow == NO_FLOW


def test_nothing_flows_while_time_stands_still() -> None:
    meter = FlowMeter(SECOND)
    meter.note(sample(5))
    assert meter.measure(SECOND) == NO_FLOW
    meter.note(sample(5))
    assert meter.measure(2 * SECOND) == Flow(1.0, 5, 5)
