"""Violations found before samples come to a dataflow."""

from __future__ import annotations

import pytest
from recorded_flow import Flow

from dyknow_stream_processing import Violation

VIOLATION = Violation('far', 'max_delay', 5, 7, 2, 1, "stream 'far': too late")


@pytest.mark.parametrize(
    'text',
    [
        'select x from "a"',
        'sync(select x from "a", select x as y from "b")',
        'merge(select x from "a", select x from "a" where x > 1)',
    ],
)
def test_a_stream_reports_a_violation_of_its_topic_once(flow: Flow, text: str) -> None:
    flow.create(text).dataflow.report('a', VIOLATION)
    assert flow.violations == [VIOLATION]
    assert flow.drops == {}


def test_lost_samples_are_counted(flow: Flow) -> None:
    flow.create('sync(select x from "a", select x as y from "a")').dataflow.drop('a', 'lost', 3)
    flow.dataflow.drop('b', 'lost', 4)
    assert flow.drops == {'lost': 3}
    assert flow.violations == []


def test_streams_that_are_gone_are_not_named(flow: Flow) -> None:
    """Their names were handed down from stream to stream, and memory grew with each."""
    late = 'select x from "a" with max_delay = 1 ms'
    flow.create(late, 'gone').create('select x from "b"', 'between')
    flow.dataflow.destroy('gone')
    flow.create(f'merge({late}, "b")')
    flow.push('a', 0, 5, x=1)
    assert len(flow.violations) == 1
    assert flow.violations[0].stream_name == late
