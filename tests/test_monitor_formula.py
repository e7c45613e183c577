"""MonitorFormula: progress, verdicts and refusals."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from dyknow_interfaces import srv
from dyknow_interfaces.msg import ExitStatus, FormulaResult

from evaluations import Monitored
from services import assert_refused, nanoseconds
from system import ALWAYS, Batteries, System

COORDINATOR = '/stream_reasoning_coordinator'
INVALID = ExitStatus.INVALID_ARGUMENT
MISSING = ExitStatus.NOT_FOUND


@pytest.fixture
def telemetry(system: System, batteries: Batteries) -> Batteries:
    """Of vehicles that fly calmly, with no evaluation left from before."""
    system.wait_for_streams()
    return batteries


@pytest.mark.usefixtures('telemetry')
def test_a_monitor_tells_how_it_goes_and_is_cancelled(system: System) -> None:
    monitor = Monitored(system.client, ALWAYS)
    told = monitor.feedback
    system.client.spin_until(
        lambda: bool(told) and told[-1].states_progressed > told[0].states_progressed, 'progress'
    )
    for earlier, later in pairwise(told):
        assert later.states_progressed >= earlier.states_progressed
        assert nanoseconds(later.latest_valid_time) >= nanoseconds(earlier.latest_valid_time)
    assert all(feedback.residual_formula for feedback in told)
    assert 'Power[uav1]' in told[-1].residual_formula
    assert system.streams() > system.fleet_streams
    result = monitor.end()
    assert monitor.status == GoalStatus.STATUS_CANCELED
    assert result.exit_status.code == ExitStatus.CANCELLED
    assert result.verdict == FormulaResult.UNDECIDED
    system.wait_for_streams()


def test_a_monitor_ends_with_the_verdict(system: System, telemetry: Batteries) -> None:
    monitor = Monitored(system.client, ALWAYS)
    system.client.spin_until(
        lambda: any(feedback.states_progressed for feedback in monitor.feedback), 'progress'
    )
    telemetry.power['uav2'] = 240.0
    result = monitor.result()
    assert monitor.status == GoalStatus.STATUS_SUCCEEDED
    assert result.exit_status.code == ExitStatus.SUCCESS
    assert result.verdict == FormulaResult.FALSE
    assert result.canonical_formula == 'forall u in UAV: (always (Power[u] < 150))'
    assert 'Power[uav2]' in result.explanation
    assert nanoseconds(result.decided_at) > nanoseconds(monitor.feedback[-1].latest_valid_time)
    system.wait_for_streams()


def test_a_monitor_of_a_formula_that_needs_no_state(system: System) -> None:
    monitor = Monitored(system.client, '1 < 2')
    result = monitor.result()
    assert monitor.status == GoalStatus.STATUS_SUCCEEDED
    assert result.verdict == FormulaResult.TRUE
    assert nanoseconds(result.decided_at) == 0


@pytest.mark.usefixtures('telemetry')
def test_a_monitor_that_takes_too_long(system: System) -> None:
    monitor = Monitored(system.client, ALWAYS, timeout=1)
    result = monitor.result()
    assert monitor.status == GoalStatus.STATUS_ABORTED
    assert_refused(result.exit_status, ExitStatus.TIMEOUT, '1 s')
    system.wait_for_streams()


@pytest.mark.parametrize(
    ('fields', 'word'),
    [
        ({'grounding': 9}, 'SYNTACTIC'),
        ({'timeout': Duration(sec=-1)}, 'negative'),
    ],
)
def test_a_question_that_makes_no_sense(system: System, fields: dict[str, Any], word: str) -> None:
    answer = system.client.call(
        srv.EvaluateFormula, f'{COORDINATOR}/evaluate_formula', formula=ALWAYS, **fields
    )
    assert_refused(answer.exit_status, INVALID, word)
