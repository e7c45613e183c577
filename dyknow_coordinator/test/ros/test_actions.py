"""Goals that the coordinator's action servers keep."""

from __future__ import annotations

from contextlib import suppress
from types import SimpleNamespace
from typing import Any, Self
from unittest.mock import MagicMock

import pytest
from dyknow_interfaces.action import MonitorPlan
from dyknow_interfaces.msg import PlanAction
from dyknow_interfaces.srv import ReportPlanAction
from rclpy.node import Node as RosNode
from rclpy.task import Future
from unique_identifier_msgs.msg import UUID

from dyknow_common import SECOND_NS, ExitCode
from dyknow_common.ros import DyKnowNode
from dyknow_coordinator import CoordinationError
from dyknow_coordinator.ros import actions
from dyknow_coordinator.ros.plan_monitoring import PlanMonitoring


class Node:
    """A node, as an action server sees it."""

    context = reentrant = None

    def __init__(self) -> None:
        self.spawned: list[Any] = []
        self.graph: list[tuple[str, str]] = []
        self.waited = 0.0
        self.known_s = float('inf')
        self.deadlines = SimpleNamespace(after=self.passed)

    async def passed(self, seconds: float) -> None:
        """A time has passed; the graph forgets a node in the meantime."""
        self.waited += seconds
        if self.waited > self.known_s:
            self.known_s = float('inf')
            self.graph.pop()

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        return self.graph

    def spawn(self, function: Any, *arguments: Any) -> None:
        self.spawned.append(function(*arguments))

    def let_time_pass(self) -> None:
        for each in self.spawned:
            with suppress(StopIteration):
                each.send(None)

    def get_fully_qualified_name(self) -> str:
        return '/node'


class Action:
    """An action type."""


class Situation:
    """An action server whose goals run until they are cancelled."""

    def __init__(self) -> None:
        self.options: dict[str, Any] = {}
        self.pursue: Any = None
        self.reasons: list[str] = []
        self.goals: list[Any] = []
        self.node = Node()

    @classmethod
    def started(cls, monkeypatch: pytest.MonkeyPatch) -> Self:
        made = cls()
        monkeypatch.setattr(actions, 'ActionServer', made.make_server)
        monkeypatch.setattr(actions, 'ClientWatch', lambda *_: None)
        made.start()
        return made

    def make_server(self, *arguments: Any, **options: Any) -> None:
        self.options, self.pursue = options, arguments[3]

    async def execute(self, goal: Any) -> None:
        with self.server.running(goal, self.reasons.append):
            await Future()

    def send(self, goal_id: UUID) -> None:
        goal = SimpleNamespace(goal_id=goal_id, is_cancel_requested=False)
        self.goals.append(self.pursue(goal))
        self.goals[-1].send(None)

    def start(self) -> None:
        node: Any = self.node
        self.server = actions.CancellingActionServer(node, Action, self.execute)


@pytest.fixture
def situation(monkeypatch: pytest.MonkeyPatch) -> Situation:
    return Situation.started(monkeypatch)


def test_goals_that_have_ended_are_not_kept_for_long(situation: Situation) -> None:
    """Each has its request, such as a formula of 1 MB; the default of rclpy is 900 s."""
    assert situation.options['result_timeout'] <= 60


class FakeClient(DyKnowNode):
    """A node of DyKnow that sends goals."""

    def __init__(self, name: str, started_at: int) -> None:  # without a ROS graph
        self.name, self.started_at = name, 1_800_000_000_000_000_000 + started_at * SECOND_NS

    def get_fully_qualified_name(self) -> str:
        return self.name


def test_goals_of_a_client_that_was_killed_end_when_it_is_back(situation: Situation) -> None:
    """Its formulas were evaluated twice, as the next run of it is a client, too."""
    former, other = FakeClient('/formula_monitor', 1), FakeClient('/monitor', 1)
    foreign: Any = object()
    for client in (former, former, other, foreign, foreign):
        situation.send(actions.goal_id(client))
    assert situation.reasons == []
    situation.send(actions.goal_id(FakeClient('/formula_monitor', 2)))
    assert situation.reasons == []
    situation.node.let_time_pass()
    assert situation.reasons == ['the client of ~/action was restarted'] * 2


def test_a_second_client_that_ends_at_once_ends_no_goals(situation: Situation) -> None:
    """The formulas of a running monitor were cancelled by a second one, which was refused."""
    situation.node.graph, situation.node.known_s = [('formula_monitor', '/')] * 2, 1.0
    for started_at in (1, 2):
        situation.send(actions.goal_id(FakeClient('/formula_monitor', started_at)))
    situation.goals[-1].close()
    situation.node.let_time_pass()
    assert situation.reasons == []


@pytest.mark.parametrize('number', [0, 1, 2])
def test_a_short_goal_of_a_restarted_client_ends_the_former_ones(
    situation: Situation, number: int
) -> None:
    """They were pursued for ever. The graph may not have forgotten the former run, if killed."""
    situation.node.graph = [('formula_monitor', '/')] * number
    for started_at in (1, 2):
        situation.send(actions.goal_id(FakeClient('/formula_monitor', started_at)))
    situation.goals[-1].close()
    situation.node.let_time_pass()
    assert situation.reasons == ['the client of ~/action was restarted']


class FakeExecutive(RosNode):
    """A node of a user that sends goals."""

    def __init__(self) -> None:  # without a ROS graph
        pass

    def get_fully_qualified_name(self) -> str:
        return '/executive'


@pytest.mark.parametrize('number', [1, 2])
def test_goals_of_a_user_s_client_end_when_it_alone_has_its_name(
    situation: Situation, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    former = actions.goal_id(FakeExecutive())
    monkeypatch.setattr(actions, '_PROCESS_START', actions._PROCESS_START + SECOND_NS)
    newer = actions.goal_id(FakeExecutive())
    situation.node.graph = [('other', '/'), *[('executive', '/')] * number]
    situation.node.known_s = 3.0 if number == 2 else float('inf')
    is_over = situation.server.is_over(bytes(former.uuid), bytes(newer.uuid))
    assert is_over == (number == 1)
    situation.send(former)
    situation.send(newer)
    situation.node.let_time_pass()
    assert situation.reasons == ['the client of ~/action was restarted']
    assert len(situation.node.graph) == 2


@pytest.mark.parametrize(('number', 'reasons'), [(1, 1), (2, 0)])
def test_a_short_goal_of_a_user_s_client(
    situation: Situation, monkeypatch: pytest.MonkeyPatch, number: int, reasons: int
) -> None:
    """If the name was shared, the node that is left may be the one with the former goals."""
    situation.node.graph, situation.node.known_s = [('executive', '/')] * number, 3.0
    situation.send(actions.goal_id(FakeExecutive()))
    monkeypatch.setattr(actions, '_PROCESS_START', actions._PROCESS_START + SECOND_NS)
    situation.send(actions.goal_id(FakeExecutive()))
    situation.goals[-1].close()
    situation.node.let_time_pass()
    assert len(situation.reasons) == reasons


def test_a_former_run_that_is_still_alive_ends_no_goals(situation: Situation) -> None:
    for started_at in (2, 1):
        situation.send(actions.goal_id(FakeClient('/formula_monitor', started_at)))
    situation.node.let_time_pass()
    assert situation.reasons == []


class Plans(Situation):
    """Plans of one name, of clients that send a goal each."""

    def start(self) -> None:
        node: Any = self.node
        node.serve, node.request_sent_at = self.serve, lambda: 0
        node.now = lambda: 1
        self.limits = MagicMock()
        self.server = PlanMonitoring(node, MagicMock(), self.limits).server
        self.results: list[MonitorPlan.Result] = []

    def serve(self, _: Any, report: Any) -> None:
        self.report = report

    def send(self, goal_id: UUID) -> Any:
        request = MonitorPlan.Goal(name='survey', actions=[PlanAction(name='fly')])
        goal = MagicMock(goal_id=goal_id, request=request, is_cancel_requested=False)
        self.goals.append(self.pursue(goal))
        return self.go_on(-1)

    def go_on(self, number: int) -> Any:
        """Run a goal until it waits; return the result if it has ended."""
        try:
            self.goals[number].send(None)
        except StopIteration as end:
            return end.value
        return None

    def report_start(self, goal_id: UUID) -> None:
        request = ReportPlanAction.Request(plan='survey', action='fly', goal_id=goal_id.uuid)
        self.report(request, None)


@pytest.fixture
def plans(monkeypatch: pytest.MonkeyPatch) -> Plans:
    return Plans.started(monkeypatch)


def test_a_restarted_client_takes_over_the_name_of_its_plan(plans: Plans) -> None:
    goals = [actions.goal_id(FakeClient('/executive', started_at)) for started_at in (1, 2)]
    for each in goals:
        plans.send(each)
    plans.report_start(goals[1])
    plans.node.let_time_pass()
    ended = plans.go_on(0)
    assert ended.exit_status.code == ExitCode.CANCELLED
    assert ended.exit_status.message == 'the client of ~/monitor_plan was restarted'
    with pytest.raises(CoordinationError, match="another client's plan 'survey' is monitored"):
        plans.report_start(goals[0])


def test_a_second_client_that_ends_at_once_ends_no_plan(plans: Plans) -> None:
    """The plan of a running node was cancelled by a second one, which was refused."""
    plans.node.graph, plans.node.known_s = [('executive', '/')] * 2, 1.0
    goals = [actions.goal_id(FakeClient('/executive', started_at)) for started_at in (1, 2)]
    for each in goals:
        plans.send(each)
    plans.server._on_cancel(SimpleNamespace(goal_id=goals[1]))
    assert plans.go_on(1).exit_status.code == ExitCode.CANCELLED
    plans.node.let_time_pass()
    plans.report_start(goals[0])


def test_a_plan_of_another_client_keeps_its_name(plans: Plans) -> None:
    plans.send(actions.goal_id(FakeClient('/executive', 1)))
    refused = plans.send(actions.goal_id(FakeClient('/other', 2)))
    assert refused.exit_status.code == ExitCode.ALREADY_EXISTS
    assert refused.exit_status.message == (
        "a plan 'survey' is monitored already; give this one another name"
    )


def test_plans_of_one_name_are_counted(plans: Plans) -> None:
    """A client that was restarted every second had as many plans as it wanted."""
    for started_at in (1, 2, 3, 4):
        plans.send(actions.goal_id(FakeClient('/executive', started_at)))
    counts = [each.args[1] for each in plans.limits.check.call_args_list]
    # The limit of parts is checked, too; the plan that is replaced does not count.
    assert counts[1::2] == [1, 1, 2, 3]
    plans.node.let_time_pass()
