"""MonitorPlan: the formulas of a plan run when it is their time, and nothing is left running."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any, Self

import pytest
from action_msgs.msg import GoalStatus
from dyknow_interfaces.action import MonitorPlan
from dyknow_interfaces.msg import ExitStatus
from dyknow_interfaces.srv import ReportPlanAction
from geometry_msgs.msg import PointStamped
from rclpy.action import ActionClient

from dyknow_common import DyKnowError, ExitCode, Verdict
from dyknow_common.ros import nanoseconds_to_time
from dyknow_coordinator import (
    FormulaPosition,
    Holds,
    Plan,
    PlanAction,
    PlanFormula,
    PlanOutcome,
    PlanPhase,
    PlanVerdict,
)
from dyknow_coordinator.ros import FormulaClient
from system import Batteries, System

CALM = 'forall u in UAV: always Power[u] < 150'
PENDING, RUNNING, DECIDED, WITHDRAWN, FAILED = PlanPhase


class Asker:
    """Asks about plans from the test's own node."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.client = FormulaClient(system.client.node)
        self.phases: dict[FormulaPosition, list[PlanPhase]] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close()

    def monitor(self, plan: Plan) -> Any:
        """Has a plan monitored, and notes the phases of its formulas."""
        return self.client.monitor_plan(plan, on_verdict=self._note)

    def report(self, report: Callable[[str], Any], action: str) -> None:
        """Reports of an action, and waits until that is taken."""
        task = self.system.client.executor.create_task(report, action)
        self.system.client.spin_until(task.done, f'the report of {action}')
        task.result()

    def wait(self, action: str, formula: str, phase: PlanPhase) -> None:
        """Waits until a formula is told to be in a phase."""
        place = FormulaPosition(action, formula)
        self.system.client.spin_until(
            lambda: phase in self.phases.get(place, ()), f'{place} is {phase.name}: {self.phases}'
        )

    def outcome(self, monitor: Any) -> PlanOutcome:
        """Return the outcome of a plan; then nothing is left running."""
        self.system.client.spin_until(monitor.outcome.done, 'the end of the plan')
        self.system.wait_for_streams()
        return monitor.outcome.result()  # type: ignore[no-any-return]

    def _note(self, verdict: PlanVerdict) -> None:
        self.phases.setdefault(verdict.position, []).append(verdict.phase)


@pytest.fixture
def asker(system: System, batteries: Batteries) -> Iterator[Asker]:  # noqa: ARG001 - regular telemetry
    system.wait_for_streams()
    with Asker(system) as asking:
        yield asking


def test_formulas_run_when_it_is_their_time(asker: Asker) -> None:
    each = tuple(PlanFormula(holds.name, CALM, holds) for holds in Holds)
    plan = Plan(
        'mission', (PlanAction('take_off', each), PlanAction('land')), (PlanFormula('all', CALM),)
    )
    monitor = asker.monitor(plan)
    asker.wait('', 'all', RUNNING)
    asker.wait('take_off', 'BEFORE', RUNNING)
    assert len(asker.phases) == 2
    asker.report(monitor.started, 'take_off')
    asker.wait('take_off', 'BEFORE', WITHDRAWN)
    asker.wait('take_off', 'WHILE_EXECUTING', RUNNING)
    asker.wait('take_off', 'FROM_START', RUNNING)
    assert FormulaPosition('take_off', 'AFTER') not in asker.phases
    asker.report(monitor.succeeded, 'take_off')
    asker.wait('take_off', 'WHILE_EXECUTING', WITHDRAWN)
    asker.wait('take_off', 'AFTER', RUNNING)
    asker.report(monitor.started, 'land')
    asker.report(monitor.succeeded, 'land')
    outcome = asker.outcome(monitor)
    assert outcome.error is None
    assert outcome.violations == ()
    assert [verdict.position for verdict in outcome.verdicts] == list(plan.formulas_by_position)
    assert {verdict.phase for verdict in outcome.verdicts} == {WITHDRAWN}
    assert all(phases == [RUNNING, WITHDRAWN] for phases in asker.phases.values())
    for verdict in outcome.verdicts:
        has_held = re.fullmatch(r'held in \d+ states?', verdict.explanation)
        assert has_held or verdict.explanation == 'no state of its period had come'
        assert verdict.outcome == ('withdrawn (held)' if has_held else 'withdrawn')


def test_a_violated_formula_is_told_with_its_action(asker: Asker, batteries: Batteries) -> None:
    calm, soon = PlanFormula('calm', CALM), PlanFormula('soon', 'eventually Power[uav1] > 0')
    actions = (PlanAction('climb', (calm, soon)), PlanAction('land', (calm,)))
    monitor = asker.monitor(Plan('mission', actions))
    asker.report(monitor.started, 'climb')
    asker.wait('climb', 'soon', DECIDED)
    batteries.power['uav2'] = 240.0
    asker.wait('climb', 'calm', DECIDED)
    assert not monitor.outcome.done()
    asker.report(monitor.failed, 'climb')
    asker.report(monitor.failed, 'land')
    outcome = asker.outcome(monitor)
    (violation,) = outcome.violations
    assert violation.position == FormulaPosition('climb', 'calm')
    assert violation.verdict is Verdict.FALSE
    assert violation.formula == 'forall u in UAV: (always (Power[u] < 150))'
    assert 'Power[uav2] = 24' in violation.explanation
    assert violation.decided_at is not None
    verdicts = {verdict.position: verdict for verdict in outcome.verdicts}
    assert verdicts[FormulaPosition('climb', 'soon')].verdict is Verdict.TRUE
    assert verdicts[FormulaPosition('land', 'calm')].phase is PENDING


def test_a_plan_that_stops_at_a_violation(asker: Asker) -> None:
    action = PlanAction('climb', (PlanFormula('bad', 'always Powr[uav1] < 150'),))
    monitor = asker.monitor(
        Plan('mission', (action,), (PlanFormula('all', CALM),), stop_at_violation=True)
    )
    asker.report(monitor.started, 'climb')
    outcome = asker.outcome(monitor)
    assert outcome.error is None
    all_calm, bad = outcome.verdicts
    assert all_calm.phase is WITHDRAWN
    assert bad.phase is FAILED
    assert bad.is_violation
    assert bad.error is not None
    assert bad.error.code is ExitCode.NOT_FOUND
    assert 'Powr' in bad.error.message
    with pytest.raises(DyKnowError, match="plan 'mission' is over"):
        asker.report(monitor.succeeded, 'climb')


def test_a_plan_over_stamps_of_another_clock(asker: Asker) -> None:
    """As of a recording that is replayed without simulated time: the states of a period count."""
    node, message = asker.system.client.node, PointStamped()
    publisher = node.create_publisher(PointStamped, '/old', 10)
    sent: list[int] = []

    def publish() -> None:
        sent.append(len(sent))
        message.header.stamp = nanoseconds_to_time(10**17 + len(sent) * 10**8)
        publisher.publish(message)

    timer = node.create_timer(0.1, publish)
    formula = PlanFormula('all', 'always "/old".point.x < 1')
    monitor = asker.monitor(Plan('mission', (PlanAction('climb', (formula,)),)))
    asker.report(monitor.started, 'climb')
    asker.wait('climb', 'all', RUNNING)
    due = len(sent) + 20
    asker.system.client.spin_until(lambda: len(sent) > due, 'states')
    asker.report(monitor.succeeded, 'climb')
    (verdict,) = asker.outcome(monitor).verdicts
    node.destroy_timer(timer)
    node.destroy_publisher(publisher)
    assert re.fullmatch(r'held in \d+ states', verdict.explanation)


def test_a_cancelled_plan(asker: Asker) -> None:
    monitor = asker.monitor(Plan('mission', (PlanAction('climb'),), (PlanFormula('all', CALM),)))
    asker.wait('', 'all', RUNNING)
    asker.system.client.spin_until(
        lambda: asker.system.streams() > asker.system.fleet_streams, 'the states'
    )
    monitor.cancel()
    outcome = asker.outcome(monitor)
    assert outcome.error is not None
    assert outcome.error.code is ExitCode.CANCELLED
    (verdict,) = outcome.verdicts
    assert verdict.phase is WITHDRAWN
    # Its name is free again.
    again = asker.monitor(Plan('mission', (PlanAction('climb'),)))
    asker.report(again.failed, 'climb')
    assert asker.outcome(again).error is None


def test_reports_that_make_no_sense(asker: Asker) -> None:
    monitor = asker.monitor(Plan('mission', (PlanAction('climb'), PlanAction('land'))))
    with pytest.raises(DyKnowError, match='it has not started; report that it has started'):
        asker.report(monitor.succeeded, 'climb')
    with pytest.raises(DyKnowError, match='it has: climb, land') as caught:
        asker.report(monitor.started, 'swim')
    assert caught.value.code is ExitCode.NOT_FOUND
    asker.report(monitor.started, 'climb')
    with pytest.raises(DyKnowError, match='it is being executed'):
        asker.report(monitor.started, 'climb')
    taken = asker.monitor(Plan('mission', (PlanAction('dive'),)))
    error = asker.outcome(taken).error
    assert error is not None
    assert error.code is ExitCode.ALREADY_EXISTS
    monitor.cancel()
    asker.outcome(monitor)


def test_a_refused_plan_reports_nothing_of_the_one_with_its_name(asker: Asker) -> None:
    plan = Plan('mission', (PlanAction('climb'), PlanAction('land')))
    monitor = asker.monitor(plan)
    asker.report(monitor.started, 'climb')
    # The report may be sent before the plan is refused.
    with pytest.raises(DyKnowError) as caught:
        asker.report(asker.monitor(plan).failed, 'climb')
    assert caught.value.code is ExitCode.ALREADY_EXISTS
    asker.report(monitor.succeeded, 'climb')
    monitor.cancel()
    asker.outcome(monitor)


@pytest.mark.parametrize(
    ('fields', 'code', 'word'),
    [
        ({'plan': 'picnic', 'action': 'eat'}, ExitStatus.NOT_FOUND, "no plan 'picnic'"),
        ({'plan': 'mission', 'event': 7}, ExitStatus.INVALID_ARGUMENT, 'STARTED (0)'),
    ],
)
def test_reports_by_service(asker: Asker, fields: dict[str, Any], code: int, word: str) -> None:
    monitor = asker.monitor(Plan('mission', (PlanAction('climb'),)))
    asker.report(monitor.started, 'climb')
    service = 'stream_reasoning_coordinator/report_plan_action'
    answer = asker.system.client.call(ReportPlanAction, service, **fields)
    assert answer.exit_status.code == code, answer
    assert word in answer.exit_status.message
    monitor.cancel()
    asker.outcome(monitor)


def test_goals_that_make_no_sense(asker: Asker) -> None:
    client = asker.system.client
    action = ActionClient(client.node, MonitorPlan, 'stream_reasoning_coordinator/monitor_plan')
    client.spin_until(action.server_is_ready, 'the action')
    for goal, word in (
        (MonitorPlan.Goal(name='mission'), 'no actions'),
        (MonitorPlan.Goal(name='mission', grounding=9), 'SYNTACTIC'),
    ):
        sent = action.send_goal_async(goal)
        result = client.result(sent, 'the goal is accepted').get_result_async()
        client.spin_until(result.done, 'the result')
        assert result.result().status == GoalStatus.STATUS_ABORTED
        status = result.result().result.exit_status
        assert status.code == ExitStatus.INVALID_ARGUMENT
        assert word in status.message
    action.destroy()
