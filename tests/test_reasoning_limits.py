"""Limits of the reasoning engine and of the coordinator, and normal requests meanwhile."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from dyknow_interfaces import srv
from dyknow_interfaces.action import MonitorPlan
from dyknow_interfaces.msg import (
    Domain,
    ExitStatus,
    Field,
    FormulaResult,
    PlanAction,
    PlanFormula,
    Sample,
)
from rclpy.action import ActionClient

from evaluations import Evaluations
from services import LATCHED, Nodes, assert_refused, nanoseconds, time_of
from system import POLL, System

ENGINE = 'stream_reasoning_engine'
COORDINATOR = 'stream_reasoning_coordinator'
INVALID, UNAVAILABLE = ExitStatus.INVALID_ARGUMENT, ExitStatus.UNAVAILABLE
CALM = 'forall u in UAV: always Power[u] < 150'
TRIPLES = 'forall a in S: forall b in S: forall c in S: always D[a, b] < E[c]'
PAIRS = 'forall a in S: forall b in S: always D[a, b] < 3'
LARGE = PAIRS + ' and D[a, b] < 3' * 8
LIMITS = {'group_limit': 8, 'idle_group_limit': 4, 'formula_limit': 10, 'total_part_limit': 200_000}


@pytest.fixture(scope='module')
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    """The reasoning engine alone, with some low limits."""
    with Nodes(tmp_path_factory.mktemp('limits'), stream_reasoning_engine=LIMITS) as nodes:
        yield nodes


@pytest.fixture(autouse=True)
def clean(request: pytest.FixtureRequest) -> Iterator[None]:
    """No group of a test is left to the next one."""
    yield
    while GROUPS:
        nodes = request.getfixturevalue('nodes')
        nodes.call(ENGINE, srv.FormulaGroupDestroy, formula_group_id=GROUPS.pop())


GROUPS: list[int] = []


def create(nodes: Nodes, name: str = 'group') -> Any:
    answer = nodes.call(ENGINE, srv.FormulaGroupCreate, formula_group_name=name)
    if answer.exit_status.code == ExitStatus.SUCCESS:
        GROUPS.append(answer.formula_group_id)
    return answer


def group_of(nodes: Nodes, formula: str) -> int:
    group = int(create(nodes).formula_group_id)
    add(nodes, group, formula)
    return group


def add(nodes: Nodes, group: int, formula: str) -> Any:
    fields = {'formula_group_id': group, 'formula_name': 'f', 'formula': formula}
    return nodes.call(ENGINE, srv.FormulaGroupAddFormula, **fields)


def evaluation(group: int, count: int) -> dict[str, Any]:
    return {
        'formula_group_id': group,
        'domains': [Domain(sort='S', objects=[f's{number}' for number in range(count)])],
        'state_stream': f'/states/of_{group}',
        'result_topic': f'/results/of_{group}',
    }


def evaluate(nodes: Nodes, group: int, count: int) -> Any:
    return nodes.call(ENGINE, srv.FormulaGroupEvaluate, **evaluation(group, count))


@pytest.mark.parametrize(
    ('formula', 'count', 'words'),
    [
        (TRIPLES, 100, ('1000000 instances', '10000', "'instance_limit'")),
        (TRIPLES, 200, ('8000000 instances', '10000', "'instance_limit'")),
        ('forall a in S: p[a]', 1_000_000, ('1000001', '10000', "'object_limit'")),
        ('exists a in S: exists b in S: D[a, b] < 2', 200, ("'instance_part_limit'", '20000')),
        ('forall a in S: exists b in S: D[a, b] < 2', 900, ("'part_limit'", '200000')),
    ],
)
def test_a_formula_for_too_many_objects(
    nodes: Nodes, formula: str, count: int, words: tuple[str, ...]
) -> None:
    group = group_of(nodes, formula)
    assert_refused(evaluate(nodes, group, count).exit_status, INVALID, *words)
    assert evaluate(nodes, group, 2).exit_status.code == ExitStatus.SUCCESS


def test_topics_that_the_middleware_refuses(nodes: Nodes) -> None:
    group = group_of(nodes, PAIRS)
    same = {**evaluation(group, 2), 'result_topic': 'hostile/same', 'state_stream': '/hostile/same'}
    refused = nodes.call(ENGINE, srv.FormulaGroupEvaluate, **same)
    words = ("'/hostile/same' cannot be both states and results",)
    assert_refused(refused.exit_status, INVALID, *words)
    # The engine publishes another type of message on this topic.
    own = {**evaluation(group, 2), 'result_topic': f'/{ENGINE}/_status'}
    refused = nodes.call(ENGINE, srv.FormulaGroupEvaluate, **own)
    assert_refused(refused.exit_status, INVALID, 'the middleware refuses it: ', f'{ENGINE}/_status')


def test_others_are_answered_while_a_large_group_is_prepared(nodes: Nodes) -> None:
    large = group_of(nodes, LARGE)
    requests = [
        nodes.request(ENGINE, srv.FormulaGroupEvaluate, **evaluation(large, 100)),
        nodes.request(
            ENGINE,
            srv.FormulaGroupAddFormula,
            formula_group_id=large,
            formula_name='other',
            formula='p',
        ),
    ]
    small = group_of(nodes, PAIRS)
    assert evaluate(nodes, small, 2).exit_status.code == ExitStatus.SUCCESS
    assert not requests[0].done()
    nodes.client.spin_until(
        lambda: all(each.done() for each in requests), 'the answers about the large group'
    )
    assert {each.result().exit_status.code for each in requests} == {ExitStatus.SUCCESS}
    assert requests[1].result().formula_id == 2


def test_a_group_that_is_destroyed_while_it_is_prepared(nodes: Nodes) -> None:
    group = group_of(nodes, LARGE)
    pending = nodes.request(ENGINE, srv.FormulaGroupEvaluate, **evaluation(group, 100))
    GROUPS.remove(group)
    nodes.obtain(ENGINE, srv.FormulaGroupDestroy, formula_group_id=group)
    nodes.client.spin_until(pending.done, 'the answer')
    assert_refused(pending.result().exit_status, ExitStatus.NOT_FOUND, 'destroyed meanwhile')


@pytest.mark.parametrize('last', [2.0, 5.0])
def test_states_of_a_large_group(nodes: Nodes, last: float) -> None:
    """The states are progressed in the background, in their order, and the verdict is right."""
    group = group_of(nodes, 'forall a in S: always[0 s, 9 s] D[a] < 3')
    results = nodes.collect(FormulaResult, f'/results/of_{group}', LATCHED)
    states = nodes.client.node.create_publisher(Sample, f'/states/of_{group}', 100)
    assert evaluate(nodes, group, 3000).exit_status.code == ExitStatus.SUCCESS
    nodes.client.spin_until(lambda: states.get_subscription_count() > 0, 'the engine listens')
    for second in range(10):
        value = last if second == 9 else 1.0
        fields = [Field(type='float', name=f'D[s{n}]', value=str(value)) for n in range(3000)]
        states.publish(Sample(valid_time=time_of((second + 1) * 10**9), fields=fields))
    nodes.client.spin_until(lambda: bool(results), 'the result')
    (result,) = results
    assert result.verdict == (FormulaResult.TRUE if last < 3 else FormulaResult.FALSE), result
    assert result.decided_at == time_of(10 * 10**9)
    nodes.client.node.destroy_publisher(states)


def test_too_many_groups(nodes: Nodes) -> None:
    for _ in range(4):
        group = int(create(nodes).formula_group_id)
        assert evaluate(nodes, group, 1).exit_status.code == ExitStatus.SUCCESS
    for _ in range(4):
        assert create(nodes).exit_status.code == ExitStatus.SUCCESS
    assert_refused(create(nodes).exit_status, UNAVAILABLE, "'idle_group_limit'", '4', 'raise')
    oldest = GROUPS[4]
    nodes.client.spin_until(
        lambda: create(nodes).exit_status.code == ExitStatus.SUCCESS,
        'the oldest group that nobody evaluates is replaced',
        pause=POLL,
    )
    assert_refused(add(nodes, oldest, 'p').exit_status, ExitStatus.NOT_FOUND, 'no formula group')
    GROUPS.remove(oldest)
    for group in GROUPS[4:]:
        assert evaluate(nodes, group, 1).exit_status.code == ExitStatus.SUCCESS
    assert_refused(create(nodes).exit_status, UNAVAILABLE, '8', "'group_limit'", 'the parameter')


def test_too_many_formulas(nodes: Nodes) -> None:
    group = int(create(nodes).formula_group_id)
    for _ in range(10):
        assert add(nodes, group, 'p').exit_status.code == ExitStatus.SUCCESS
    assert_refused(add(nodes, group, 'p').exit_status, UNAVAILABLE, "'formula_limit'", '10')


def test_too_many_parts_in_all_groups(nodes: Nodes) -> None:
    formula = 'forall a in S: ' + ' and '.join(['p[a]'] * 12)
    groups = [group_of(nodes, formula) for _ in range(2)]
    assert evaluate(nodes, groups[0], 7000).exit_status.code == ExitStatus.SUCCESS
    status = evaluate(nodes, groups[1], 7000).exit_status
    assert_refused(status, UNAVAILABLE, "'total_part_limit'", '200000')


def test_long_names(nodes: Nodes) -> None:
    long = 'x' * 100_000
    assert_refused(create(nodes, long).exit_status, INVALID, 'formula_group_name', '1000')
    group = int(create(nodes).formula_group_id)
    fields = {'formula_group_id': group, 'formula_name': long, 'formula': 'p'}
    status = nodes.call(ENGINE, srv.FormulaGroupAddFormula, **fields).exit_status
    assert_refused(status, INVALID, 'formula_name', '100000')


@pytest.fixture(scope='module')
def limited(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    """DyKnow with few evaluations at once."""
    limits = {
        'evaluation_limit': 3, 'plan_limit': 1, 'plan_part_limit': 5, 'feature_limit': 3,
        'ended_limit': 2,
    }  # fmt: skip
    folder = tmp_path_factory.mktemp('limited')
    with System(folder, parameters={COORDINATOR: limits}) as system:
        yield system


def test_too_many_evaluations(limited: System) -> None:
    running = [limited.ask(CALM, timeout=600.0) for _ in range(3)]
    limited.wait_until_running(running[0])
    answer = limited.evaluate('1 < 2')
    assert_refused(answer.exit_status, UNAVAILABLE, "'evaluation_limit'", '4', '3', 'try again')
    limited.batteries.power['uav1'] = 500.0
    for future in running:
        limited.decided(future, FormulaResult.FALSE)
    limited.batteries.power['uav1'] = 100.0
    assert limited.evaluate('1 < 2').verdict == FormulaResult.TRUE


def test_repeated_errors_evict_no_verdict(limited: System) -> None:
    """A formula that is retried every 0.5 s hid the verdicts of others after a while."""
    assert limited.evaluate('2 < 1').verdict == FormulaResult.FALSE
    evaluations = Evaluations(limited)
    for _ in range(3):
        before = limited.client.node.get_clock().now().nanoseconds
        answer = limited.evaluate('always Power[nobody] < 1')
        assert answer.exit_status.code == ExitStatus.NOT_FOUND
    limited.client.spin_until(
        lambda: any(nanoseconds(each.started) > before for each in evaluations.reported),
        'the last error is reported',
    )
    assert '2 < 1' in {each.name for each in evaluations.reported}, evaluations.told()
    evaluations.close()


def test_too_many_features(limited: System) -> None:
    answer = limited.evaluate('forall u in UAV: forall v in UAV: always XYDist[u, v] > 1')
    assert_refused(answer.exit_status, INVALID, "'feature_limit'", '4', '3')


def plan(limited: System, actions: int, name: str = 'plan', formulas: int = 0) -> Any:
    client = ActionClient(limited.client.node, MonitorPlan, f'{COORDINATOR}/monitor_plan')
    limited.client.spin_until(client.server_is_ready, 'the action')
    goal = MonitorPlan.Goal(name=name, actions=[PlanAction(name=f'a{n}') for n in range(actions)])
    goal.formulas = [PlanFormula(name=f'f{n}', formula=CALM) for n in range(formulas)]
    sent = client.send_goal_async(goal)
    return limited.client.result(sent, 'the goal is accepted').get_result_async(), sent.result()


def test_too_many_plans(limited: System) -> None:
    refused, _ = plan(limited, 6)
    limited.client.spin_until(refused.done, 'the refusal')
    assert_refused(refused.result().result.exit_status, INVALID, "'plan_part_limit'", '6', '5')
    running, goal = plan(limited, 1, formulas=4)
    refused, _ = plan(limited, 1, name='other')
    limited.client.spin_until(refused.done, 'the refusal')
    assert_refused(refused.result().result.exit_status, UNAVAILABLE, "'plan_limit'", '2', '1')
    goal.cancel_goal_async()
    limited.client.spin_until(running.done, 'the end of the plan')
    errors = [each.exit_status for each in running.result().result.verdicts]
    # The fourth formula could not be started.
    assert [each.code for each in errors].count(UNAVAILABLE) == 1
    assert "'evaluation_limit'" in errors[3].message
