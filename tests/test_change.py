"""Streams, annotations and objects that come and go while formulas are evaluated."""

from __future__ import annotations

import pytest
from dyknow_interfaces.msg import ExitStatus, FormulaResult
from dyknow_interfaces.srv import ConceptCreate, ConceptDestroy, InstanceCreate, InstanceDestroy

from evaluations import Evaluations, Monitored, Spares
from services import nanoseconds
from system import POLL, SOON_NOTICED, SPARES, Batteries, SharedSystem, System

TRUE, FALSE = FormulaResult.TRUE, FormulaResult.FALSE
SPARE = 'uav1_spare_power'
FAST = 'sample_period = 200 ms, sample_period_deviation = 50 ms, max_delay = 1 s'

pytestmark = pytest.mark.usefixtures('calm')


@pytest.fixture(scope='module')
def system(shared_system: SharedSystem, composition: bool) -> System:  # noqa: FBT001 - a fixture
    return shared_system.get(parameters=SOON_NOTICED, spares=SPARES, composition=composition)


def wait_for_own_streams(system: System, count: int) -> None:
    """Wait until there are so many streams beside the fleet's."""
    system.client.spin_until(
        lambda: len(system.streams() - system.fleet_streams) == count,
        f'{count} streams beside those of the fleet',
        pause=POLL,
    )


def assert_no_state_was_lost(monitored: Monitored) -> None:
    """The battery has a state each 200 ms; whatever streams they came by, all were progressed."""
    told = [each for each in monitored.feedback if each.states_progressed]
    first, last = told[0], told[-1]
    duration = nanoseconds(last.latest_valid_time) - nanoseconds(first.latest_valid_time)
    assert last.states_progressed - first.states_progressed == duration // Batteries.PERIOD > 0


def test_a_better_stream_comes_and_goes(
    system: System, batteries: Batteries, evaluations: Evaluations, spares: Spares
) -> None:
    monitored = Monitored(system.client, 'always Power[uav1] < 150', timeout=40.0)
    system.client.spin_until(lambda: bool(monitored.feedback), 'states')
    assert 'from uav1_power' in monitored.feedback[-1].streams[0]
    former = system.streams() - system.fleet_streams
    spares.power(SPARE, 'spare1', of='uav1', timing=FAST)
    evaluations.wait_for_event('better', SPARE)
    # What the other stream says does not count any more, once all states are made of this one.
    system.client.spin_until(
        lambda: former.isdisjoint(system.streams()), 'the former states are gone', pause=POLL
    )
    # The spare stream, the states, and the standby's states of the other stream.
    wait_for_own_streams(system, 3)
    batteries.power['uav1'] = 240.0
    said = batteries.stamp
    system.client.spin_until(lambda: batteries.stamp >= said + 10**9, 'a second')
    batteries.power['uav1'] = 100.0
    settled = batteries.stamp
    system.client.spin_until(lambda: batteries.stamp >= settled + 10**9, 'a second')
    spares.forget(SPARE)
    evaluations.wait_for_event('better', 'from uav1_power')
    wait_for_own_streams(system, 2)
    count = len(monitored.feedback)
    system.client.spin_until(lambda: len(monitored.feedback) > count + 1, 'more states')
    assert_no_state_was_lost(monitored)
    assert [SPARE in event for event in monitored.events] == [True, False]
    batteries.power['spare1'] = 300.0
    batteries.power['uav1'] = 240.0
    result = monitored.result()
    assert result.verdict == FALSE, result
    assert 'Power[uav1] = 24' in result.explanation
    assert SPARE not in result.groundings[0].stream


def test_a_surge_while_streams_are_replaced(
    system: System, batteries: Batteries, evaluations: Evaluations, spares: Spares
) -> None:
    """Each state counts: one in which the limit is broken is seen, whenever it comes."""
    for _ in range(3):
        future = system.ask('always Power[uav1] < 150', timeout=20.0)
        evaluations.wait_for_state()
        spares.power(SPARE, 'spare1', of='uav1', timing=FAST)
        said = batteries.stamp
        system.client.spin_until(lambda: batteries.stamp > said, 'a sample')  # noqa: B023
        surge = batteries.change(uav1=240.0, spare1=240.0)
        system.client.spin_until(lambda: batteries.stamp > surge, 'one sample')  # noqa: B023
        batteries.change(uav1=100.0, spare1=100.0)
        system.decided(future, FALSE)
        assert nanoseconds(future.result().decided_at) == surge + Batteries.PERIOD
        evaluations.wait_for_nothing()
        spares.clear()


def test_an_exact_match_comes_after_one_below_it(
    system: System, batteries: Batteries, evaluations: Evaluations, spares: Spares
) -> None:
    call = system.client.call
    parents = {'concept_name': 'HoverPower', 'parent_concepts': ['Power']}
    made = call(ConceptCreate, 'ontology_manager/concept_create', **parents)
    assert made.exit_status.code == ExitStatus.SUCCESS, made.exit_status.message
    spares.make('uav3_hover', 'select voltage as power from "/uav3/battery"')
    spares.make('uav3_total', 'select voltage as power from "/spare1/battery"')
    call(
        InstanceCreate, 'ontology_manager/instance_create',
        instance_name='uav3', concept_names=['UAV'],
    )  # fmt: skip
    spares.annotate('uav3_hover', f'HoverPower[uav3] = power with {FAST}')
    monitored = Monitored(system.client, 'always Power[uav3] < 150')
    (before,) = evaluations.wait_for_state()
    assert 'from uav3_hover' in before.groundings[0].stream
    spares.annotate('uav3_total', 'Power[uav3] = power')
    evaluations.wait_for_event('better', 'uav3_total')
    result = monitored.end()
    assert result.exit_status.code == ExitStatus.CANCELLED, result
    assert 'from uav3_total' in result.groundings[0].stream
    (stand_in,) = result.groundings[0].stand_ins
    assert 'from uav3_hover' in stand_in
    spares.clear()
    call(InstanceDestroy, 'ontology_manager/instance_destroy', instance_name='uav3')
    call(ConceptDestroy, 'ontology_manager/concept_destroy', concept_name='HoverPower')
    assert batteries.power['uav3'] == 100.0


def test_an_annotation_that_is_taken_away(
    system: System, batteries: Batteries, evaluations: Evaluations, spares: Spares
) -> None:
    """With nothing in its place the caller is told; replaced within a moment it is not missed."""
    parents = {'concept_name': 'Load', 'parent_concepts': ['Power']}
    system.client.call(ConceptCreate, 'ontology_manager/concept_create', **parents)
    spares.make('level', 'select voltage as level from "/uav1/battery"')
    spares.annotate('level', 'Load[uav1] = level')
    future = system.ask('always Load[uav1] > 0', timeout=30.0)
    evaluations.wait_for_state()
    spares.forget('level')
    spares.annotate('level', 'Load[uav1] = level')
    changed = batteries.stamp
    system.client.spin_until(lambda: batteries.stamp > changed + 3 * 10**9, 'three seconds')
    assert not future.done(), future.result()
    spares.forget('level')
    answer = system.client.result(future, 'the answer')
    assert answer.exit_status.code == ExitStatus.NOT_FOUND, answer
    assert 'Load[uav1]' in answer.exit_status.message
    system.client.call(ConceptDestroy, 'ontology_manager/concept_destroy', concept_name='Load')


def test_a_new_vehicle(
    system: System, batteries: Batteries, evaluations: Evaluations, spares: Spares
) -> None:
    """A domain is fixed for an evaluation, unless it asked to restart."""
    formula = 'forall u in UAV: always Power[u] < 150'
    fixed = system.ask(formula, timeout=60.0)
    following = Monitored(system.client, formula, timeout=60.0, restart_on_change=True)
    evaluations.wait_for_state(2)
    batteries.power['uav3'] = 240.0
    system.client.call(
        InstanceCreate, 'ontology_manager/instance_create',
        instance_name='uav3', concept_names=['UAV'],
    )  # fmt: skip
    evaluations.wait_for_event('cannot restart', 'Power[uav3]')
    assert any('no stream carries Power[uav3]' in each.waits_for for each in evaluations.running)
    spares.power('uav3_power', 'uav3', of='uav3')
    result = following.result()
    assert result.verdict == FALSE, result
    assert 'Power[uav3] = 24' in result.explanation
    # Feedback may be lost; the coordinator keeps the events.
    events = [event for each in evaluations.ended(formula) for event in each.events]
    told = [*events, *following.events]
    assert any('restarted' in event and 'uav3' in event for event in told), told
    # The next evaluation sees it, too.
    answer = system.evaluate(formula)
    assert answer.verdict == FALSE, answer
    assert 'Power[uav3]' in answer.explanation
    assert not fixed.done()
    batteries.power['uav2'] = 240.0
    system.decided(fixed, FALSE)
    assert 'Power[uav2]' in fixed.result().explanation
    assert 'uav3' not in fixed.result().explanation
    spares.clear()
    system.client.call(InstanceDestroy, 'ontology_manager/instance_destroy', instance_name='uav3')


def test_a_vehicle_that_leaves(
    system: System, batteries: Batteries, evaluations: Evaluations, spares: Spares
) -> None:
    call = system.client.call
    spares.make('uav3_made', 'select voltage as altitude from "/uav3/battery"')
    call(
        InstanceCreate, 'ontology_manager/instance_create',
        instance_name='uav3', concept_names=['UAV'],
    )  # fmt: skip
    spares.power('uav3_power', 'uav3', of='uav3')
    formula = 'forall u in UAV: always Power[u] < 150'
    following = Monitored(system.client, formula, timeout=60.0, restart_on_change=True)
    evaluations.wait_for_state()
    spares.forget('uav3_power')
    call(InstanceDestroy, 'ontology_manager/instance_destroy', instance_name='uav3')
    evaluations.wait_for_event('restarted', 'uav1, uav2')
    batteries.silent.add('uav3')
    evaluations.wait_for_state()
    batteries.power['uav1'] = 240.0
    result = following.result()
    assert result.verdict == FALSE, result
    assert 'Power[uav1]' in result.explanation
