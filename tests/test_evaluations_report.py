"""Reports of evaluations as an observer receives them: a plain node that subscribes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from dyknow_interfaces.msg import EvaluationStatusArray
from rclpy.qos import DurabilityPolicy, QoSProfile

from dyknow_common import ExitCode, Verdict
from dyknow_coordinator import (
    CoordinationError,
    EvaluationPhase,
    EvaluationStatus,
    Grounding,
    SymbolGrounding,
)
from dyknow_coordinator.ros.reporting.evaluation_messages import status_from_message
from reporter import Reporter
from services import nanoseconds

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
EVALUATIONS = '/stream_reasoning_coordinator/evaluations'
SECOND = 1_000_000_000


@pytest.fixture
def reporter() -> Iterator[Reporter]:
    running = Reporter()
    yield running
    running.close()


@pytest.fixture
def running(reporter: Reporter) -> EvaluationStatus:
    """An evaluation that has just had a state."""
    return EvaluationStatus(
        'power',
        'always (Power[uav1] < 200)',
        EvaluationPhase.RUNNING,
        started=reporter.now(),
        plan='survey',
        action='take off',
        formula_group_id=4,
        state_stream='/dyknow/streams/states_1',
        groundings=(SymbolGrounding('Power[uav1]', Grounding.SEMANTIC, 'select a from b', ('c',)),),
        events=('begun',),
        states_progressed=3,
        latest_valid_time=reporter.now() + 3600 * SECOND,
        residual_formula='always (Power[uav1] < 200)',
    )


def ended(status: EvaluationStatus) -> EvaluationStatus:
    return replace(
        status,
        phase=EvaluationPhase.ENDED,
        verdict=Verdict.FALSE,
        decided_at=status.started,
        explanation='Power[uav1] = 231.4 is not < 200',
    )


def test_an_evaluation_is_told_as_it_is(reporter: Reporter, running: EvaluationStatus) -> None:
    failed = replace(running, name='failed', error=CoordinationError('gone', ExitCode.UNAVAILABLE))
    reporter.tell(running, ended(running), failed)
    heard = reporter.client.collect(EvaluationStatusArray, EVALUATIONS, LATCHED)
    reporter.until(lambda: bool(heard) and len(heard[-1].evaluations) == 3, 'all evaluations')
    told = [status_from_message(each) for each in heard[-1].evaluations]
    assert told[:2] == [running, ended(running)]
    assert told[2].error is not None
    assert (told[2].error.code, told[2].error.message) == (ExitCode.UNAVAILABLE, 'gone')
    assert replace(told[2], error=None) == replace(failed, error=None)
    assert nanoseconds(heard[-1].stamp) > running.started


def test_who_comes_late_hears_what_has_ended(reporter: Reporter, running: EvaluationStatus) -> None:
    early = reporter.client.collect(EvaluationStatusArray, EVALUATIONS, LATCHED)
    reporter.tell(ended(running))
    reporter.until(lambda: bool(early) and bool(early[-1].evaluations), 'the end')
    late = reporter.client.collect(EvaluationStatusArray, EVALUATIONS, LATCHED)
    reporter.until(lambda: bool(late), 'the end, once more')
    assert late[0] == early[-1]


def test_hundreds_of_changes_make_few_messages(
    reporter: Reporter, running: EvaluationStatus
) -> None:
    heard = reporter.client.collect(EvaluationStatusArray, EVALUATIONS, LATCHED)
    reporter.until(lambda: bool(heard), 'the first report')
    before = len(heard)
    for number in range(300):
        reporter.tell(replace(ended(running), states_progressed=number))
    reporter.until(lambda: len(heard) > before, 'a report')
    assert [each.evaluations[0].states_progressed for each in heard[before:]] == [299]


def test_while_anything_runs_it_is_told_on_and_on(
    reporter: Reporter, running: EvaluationStatus
) -> None:
    reporter.statuses = [running]
    heard = reporter.client.collect(EvaluationStatusArray, EVALUATIONS, LATCHED)
    reporter.until(lambda: len(heard) >= 3, 'three reports')


def test_diagnostics(reporter: Reporter, running: EvaluationStatus) -> None:
    """What they say of each evaluation is tested without topics, in test_evaluation_status."""
    silent = replace(running, name='silent', latest_valid_time=1)
    reporter.tell(ended(running), running, silent)
    heard = reporter.client.collect(DiagnosticArray, '/diagnostics', 10)
    reporter.until(lambda: bool(heard), 'diagnostics')
    assert {each.name: each.level for each in heard[0].status} == {
        '/stream_reasoning_coordinator: power': DiagnosticStatus.ERROR,
        '/stream_reasoning_coordinator: power (2)': DiagnosticStatus.OK,
        '/stream_reasoning_coordinator: silent': DiagnosticStatus.WARN,
    }
    first = heard[0].status[0]
    assert first.hardware_id == 'none'
    assert first.message == 'false: Power[uav1] = 231.4 is not < 200'
    values = {each.key: each.value for each in first.values}
    assert values['streams'] == 'Power[uav1]: select a from b'
    assert (values['plan'], values['action']) == ('survey', 'take off')
    assert nanoseconds(heard[0].header.stamp) > running.started
