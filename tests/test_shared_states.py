"""Formulas over the same streams share their states, and nothing else."""

from __future__ import annotations

from typing import Any

import pytest
from dyknow_interfaces.msg import ExitStatus, FormulaResult, StreamConstraints
from rcl_interfaces.srv import GetParameters

from dyknow_common.ros import LONG_TIMEOUT_S, REPORTS, nanoseconds_to_duration
from evaluations import Evaluations, Monitored
from services import nanoseconds
from system import LIMIT, Batteries, System

TRUE, FALSE = FormulaResult.TRUE, FormulaResult.FALSE
SECOND = 1_000_000_000


@pytest.fixture(autouse=True)
def only_fleet_streams(system: System, calm: Batteries) -> None:  # noqa: ARG001 - regular telemetry
    """The test begins with the streams of the fleet alone."""
    system.wait_for_streams()


def states(system: System) -> set[str]:
    return system.streams() - system.fleet_streams


def test_twenty_formulas_over_the_same_streams(
    system: System, batteries: Batteries, evaluations: Evaluations
) -> None:
    first = system.ask('forall u in UAV: always Power[u] < 130', timeout=LIMIT)
    evaluations.wait_for_state()
    others = [
        system.ask(f'forall u in UAV: always Power[u] < {limit} W', timeout=LIMIT)
        for limit in range(131, 150)
    ]
    running = evaluations.wait_for_state(20)
    assert len({each.formula_group_id for each in running}) == 1
    assert len({each.state_stream for each in running}) == 1
    assert len(evaluations.groups()) == 1
    assert len(states(system)) == 1
    # The last ones stay when the first one has its verdict.
    batteries.power['uav1'] = 140.0
    early = [first, *others[:10]]
    system.client.spin_until(lambda: all(each.done() for each in early), 'half of the verdicts')
    assert {each.result().verdict for each in early} == {FALSE}, early[0].result()
    assert all(' W' in each.result().explanation for each in early[1:])
    assert len(evaluations.wait_for(9)) == 9
    assert not any(each.done() for each in others[10:])
    batteries.power['uav2'] = 240.0
    system.client.spin_until(lambda: all(each.done() for each in others), 'all verdicts')
    assert {each.result().verdict for each in others} == {FALSE}


def test_a_formula_begins_with_its_own_first_state(
    system: System, batteries: Batteries, evaluations: Evaluations
) -> None:
    """States from before a formula's request do not count for it."""
    batteries.power['uav1'] = 240.0
    former = system.ask('eventually Power[uav1] < 150', timeout=30.0)
    (before,) = evaluations.wait_for_state()
    late = system.ask('eventually[0 s, 1 s] Power[uav1] < 150')
    asked = batteries.stamp
    system.decided(late, FALSE)
    assert nanoseconds(late.result().decided_at) > asked + SECOND // 2
    (after,) = evaluations.wait_for(1)
    assert after.formula_group_id == before.formula_group_id
    batteries.power['uav1'] = 100.0
    system.decided(former, TRUE)


def test_one_is_cancelled(system: System, batteries: Batteries, evaluations: Evaluations) -> None:
    staying = system.ask('always Power[uav1] < 150', timeout=30.0)
    evaluations.wait_for_state()
    leaving = Monitored(system.client, 'always Power[uav1] < 160', timeout=30.0)
    evaluations.wait_for_state(2)
    assert len(evaluations.groups()) == 1
    assert leaving.end().exit_status.code == ExitStatus.CANCELLED
    evaluations.wait_for(1)
    batteries.power['uav1'] = 155.0
    system.decided(staying, FALSE)


def test_states_of_another_kind_are_not_shared(
    system: System, batteries: Batteries, evaluations: Evaluations
) -> None:
    slow = StreamConstraints(sample_period=[nanoseconds_to_duration(SECOND)])
    futures = [
        system.ask('always Power[uav1] < 150'),
        system.ask('always Power[uav1] < 150', constraints=slow),
        system.ask('always Power[uav2] < 150'),
        system.ask('forall u in UAV: always Power[u] < 150'),
    ]
    running = evaluations.wait_for(4)
    assert len({each.formula_group_id for each in running}) == 4
    assert len({each.state_stream for each in running}) == 4
    batteries.change(uav1=240.0, uav2=240.0)
    system.client.spin_until(lambda: all(each.done() for each in futures), 'verdicts')
    assert {each.result().verdict for each in futures} == {FALSE}


def test_all_formulas_of_a_group_hear_of_what_broke(
    system: System, batteries: Batteries, evaluations: Evaluations
) -> None:
    """Also those that come just when it breaks."""
    formula = 'always Power[uav1] < {}'
    futures = [system.ask(formula.format(limit), timeout=20.0) for limit in range(150, 155)]
    evaluations.wait_for_state(5)
    batteries.silent.add('uav1')

    asked = batteries.stamp

    def ask_on() -> bool:
        nonlocal asked
        if (stamp := batteries.stamp) > asked and len(futures) < 200:
            asked = stamp
            for _ in range(5):
                futures.append(system.ask(formula.format(155 + len(futures)), timeout=20.0))
        return bool(futures[0].done())

    system.client.spin_until(ask_on, 'an answer')
    told = [each for each in futures if each.done()]
    assert {each.result().exit_status.code for each in told} == {ExitStatus.CONSTRAINT_VIOLATION}
    # Who asked after it broke is evaluated over the next states that there are.
    batteries.silent.clear()
    batteries.power['uav1'] = 1000.0
    system.client.spin_until(lambda: all(each.done() for each in futures), 'all answers')
    for answer in (each.result() for each in futures):
        assert (
            answer.verdict == FALSE or answer.exit_status.code == ExitStatus.CONSTRAINT_VIOLATION
        ), answer


def test_two_hundred_at_once(
    system: System, batteries: Batteries, evaluations: Evaluations
) -> None:
    formulas = [f'forall u in UAV: always Power[u] < {limit}' for limit in range(150, 250)]
    formulas += [f'forall u in UAV: eventually Power[u] > {limit}' for limit in range(150, 250)]
    # Two hundred requests take a minute where twenty other processes compute.
    futures = [system.ask(formula, timeout=4 * LIMIT) for formula in formulas]
    running: list[Any] = []

    def progressed() -> bool:
        running[:] = [each for each in evaluations.running if each.states_progressed]
        return len(running) == 200 or any(each.done() for each in futures)

    def lacking() -> str:
        without = [each for each in evaluations.running if not each.states_progressed]
        return f'{len(running)} of {len(evaluations.running)} with states; without: {without[:3]}'

    system.client.spin_until(progressed, 'states of all evaluations', 3 * LIMIT, instead=lacking)
    assert {each.result().exit_status.message for each in futures if each.done()} == set()
    assert len({each.formula_group_id for each in running}) == 1
    assert len(states(system)) == 1
    batteries.power['uav1'] = batteries.power['uav2'] = 300.0
    system.client.spin_until(lambda: all(each.done() for each in futures), 'all verdicts')
    messages = {each.result().exit_status.message for each in futures}
    assert messages == {''}
    assert [each.result().verdict for each in futures] == [FALSE] * 100 + [TRUE] * 100


def test_no_report_on_many_formulas_is_dropped(system: System) -> None:
    """The engine reports on all formulas at once; a shorter queue keeps the last ones only."""
    limit = system.client.call(
        GetParameters, 'stream_reasoning_coordinator/get_parameters', names=['evaluation_limit']
    )
    assert limit.values[0].integer_value <= REPORTS.depth


def test_nodes_wait_longer_for_a_query_than_it_may_take(system: System) -> None:
    """Otherwise, the message of the ontology manager that says what to do reaches nobody."""
    limit = system.client.call(
        GetParameters, 'ontology_manager/get_parameters', names=['query_limit']
    )
    assert limit.values[0].double_value < LONG_TIMEOUT_S
