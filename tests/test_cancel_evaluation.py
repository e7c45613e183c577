"""An operator ends evaluations by their name."""

from __future__ import annotations

from typing import Any

import pytest
from dyknow_interfaces.msg import ExitStatus, FormulaResult
from dyknow_interfaces.srv import CancelEvaluation

from commands import command, output_beside
from dyknow_common import ExitCode
from dyknow_coordinator import Plan, PlanAction, PlanFormula, PlanPhase
from dyknow_coordinator.ros import FormulaClient
from evaluations import COORDINATOR, Evaluations, Monitored
from services import assert_refused
from system import ALWAYS, System

UNTIMED = 'always "/uav1/battery".current < 150'
"""No constraint of a stream ends it, however busy the machine is."""

CANONICAL = 'forall u in UAV: (always (Power[u] < 150))'
WHO = f'cancelled by an operator, who called /{COORDINATOR}/cancel_evaluation'

pytestmark = pytest.mark.usefixtures('calm')


def cancel(system: System, name: str) -> Any:
    return system.client.call(CancelEvaluation, f'{COORDINATOR}/cancel_evaluation', name=name)


def cancel_by_command(system: System) -> tuple[int, str]:
    """Run the command beside the telemetry; its exit code and its output."""
    line = command('evaluations', '--cancel', 'calm')
    done = output_beside(system.client, line, system.environment)
    return done.returncode, done.stdout


def assert_cancelled(exit_status: Any) -> None:
    assert (exit_status.code, exit_status.message) == (ExitStatus.CANCELLED, WHO)


def test_all_evaluations_of_a_name_are_ended(system: System, evaluations: Evaluations) -> None:
    named = [Monitored(system.client, ALWAYS, name='calm') for _ in range(2)]
    other = Monitored(system.client, ALWAYS, name='other')
    evaluations.wait_for_state(3)
    answer = cancel(system, 'calm')
    assert (answer.exit_status.code, answer.cancelled) == (ExitStatus.SUCCESS, 2)
    for each in named:
        result = each.result()
        assert_cancelled(result.exit_status)
        assert result.verdict == FormulaResult.UNDECIDED
    assert [each.name for each in evaluations.wait_for(1)] == ['other']
    assert other.end().exit_status.message == 'cancelled by the caller'


@pytest.mark.parametrize('name', [CANONICAL, ALWAYS])
def test_a_caller_of_the_service_is_answered(
    system: System, evaluations: Evaluations, name: str
) -> None:
    """Without a name of its own, an evaluation has its formula as name."""
    answered = system.ask(ALWAYS)
    evaluations.wait_for_state()
    assert cancel(system, name).cancelled == 1
    system.client.spin_until(answered.done, 'the answer')
    assert_cancelled(answered.result().exit_status)


def test_a_name_that_nothing_has(system: System, evaluations: Evaluations) -> None:
    assert_refused(cancel(system, '').exit_status, ExitStatus.NOT_FOUND, '(there are: none)')
    monitored = Monitored(system.client, ALWAYS, name='calm')
    evaluations.wait_for(1)
    assert_refused(
        cancel(system, 'clam').exit_status,
        ExitStatus.NOT_FOUND,
        "nothing named 'clam' is being evaluated (there are: calm)",
    )
    assert cancel(system, 'calm').cancelled == 1
    assert_cancelled(monitored.result().exit_status)
    assert cancel(system, 'calm').exit_status.code == ExitStatus.NOT_FOUND


def test_a_formula_of_a_plan_then_has_failed(system: System, evaluations: Evaluations) -> None:
    plan = Plan('flight', (PlanAction('fly', (PlanFormula('calm', ALWAYS),)),))
    with FormulaClient(system.client.node) as client:
        monitor = client.monitor_plan(plan)
        system.client.executor.create_task(monitor.started, 'fly')
        evaluations.wait_for_state()
        assert cancel(system, 'calm').cancelled == 1
        reported = system.client.executor.create_task(monitor.succeeded, 'fly')
        system.client.spin_until(monitor.outcome.done, 'the end of the plan')
        system.client.spin_until(reported.done, 'the answer to the report')
    (verdict,) = monitor.outcome.result().verdicts
    assert (verdict.phase, verdict.error.code) == (PlanPhase.FAILED, ExitCode.CANCELLED)
    assert verdict.error.message == WHO


def test_the_command(system: System, evaluations: Evaluations) -> None:
    monitored = Monitored(system.client, UNTIMED, name='calm')
    evaluations.wait_for(1)
    assert cancel_by_command(system) == (0, "cancelled 1 evaluation named 'calm'\n")
    assert_cancelled(monitored.result().exit_status)
    refusal = "nothing named 'calm' is being evaluated (there are: none)"
    assert cancel_by_command(system) == (2, f'evaluations: {refusal}\n')
