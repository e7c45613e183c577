"""The groundings and times in the answer to a caller."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest
from dyknow_interfaces.msg import ExitStatus, FormulaResult, StreamConstraints, SymbolGrounding
from dyknow_interfaces.srv import EvaluateFormula
from nav_msgs.msg import Odometry

from dyknow_common.ros import nanoseconds_to_duration, nanoseconds_to_time
from evaluations import Evaluations, Monitored, Spares
from services import nanoseconds
from system import Batteries, System

AUTO, SYNTACTIC = EvaluateFormula.Request.AUTO, EvaluateFormula.Request.SYNTACTIC
SEMANTIC = EvaluateFormula.Request.SEMANTIC
TRUE = FormulaResult.TRUE
MILLISECOND, SECOND = 1_000_000, 1_000_000_000

pytestmark = pytest.mark.usefixtures('calm')


@pytest.fixture(scope='module')
def positions(system: System) -> Iterator[dict[str, tuple[float, float]]]:
    """The positions of the vehicles, published 20 times a second."""
    where = {'uav1': (0.0, 0.0), 'uav2': (30.0, 40.0)}
    node = system.client.node
    period = 50 * MILLISECOND
    publishers = {
        vehicle: node.create_publisher(Odometry, f'{vehicle}/odometry', 10) for vehicle in where
    }
    latest = node.get_clock().now().nanoseconds // period * period

    def publish() -> None:
        nonlocal latest
        while latest + period <= node.get_clock().now().nanoseconds:
            latest += period
            for vehicle, (east, north) in where.items():
                message = Odometry()
                message.header.stamp = nanoseconds_to_time(latest)
                message.pose.pose.position.x = east
                message.pose.pose.position.y = north
                publishers[vehicle].publish(message)

    timer = node.create_timer(0.01, publish)
    yield where
    node.destroy_timer(timer)
    for publisher in publishers.values():
        node.destroy_publisher(publisher)


def grounded(answer: Any) -> dict[str, tuple[int, str]]:
    assert answer.exit_status.code == ExitStatus.SUCCESS, answer.exit_status.message
    return {each.symbol: (each.grounding, each.stream) for each in answer.groundings}


def test_each_symbol_says_how_it_was_grounded(system: System) -> None:
    answer = system.evaluate(
        'eventually (Power[uav1] > 99 and uav2_power > 99 and "/uav1/battery".voltage > 9)'
    )
    assert answer.verdict == TRUE
    found = grounded(answer)
    assert {symbol: way for symbol, (way, _) in found.items()} == {
        'Power[uav1]': SymbolGrounding.SEMANTIC,
        'uav2_power': SymbolGrounding.SYNTACTIC,
        '"/uav1/battery".voltage': SymbolGrounding.SYNTACTIC,
    }
    assert 'from uav1_power' in found['Power[uav1]'][1]
    assert 'from uav2_power' in found['uav2_power'][1]
    assert 'from "/uav1/battery"' in found['"/uav1/battery".voltage'][1]


@pytest.mark.parametrize('grounding', [AUTO, SYNTACTIC])
def test_the_bare_name_of_a_stream(system: System, batteries: Batteries, grounding: int) -> None:
    batteries.power['uav1'] = 160.0
    answer = system.evaluate('eventually uav1_power > 150', grounding=grounding)
    assert answer.verdict == TRUE, answer.exit_status.message
    assert grounded(answer).keys() == {'uav1_power'}


def test_a_stream_that_was_just_made(system: System, spares: Spares) -> None:
    """A stream can be used in a formula as soon as its creation is answered."""
    for number in range(4):
        spares.make(f'volts_{number}', 'select voltage as volts from "/uav1/battery"')
        grounding = (AUTO, SYNTACTIC)[number % 2]
        answer = system.evaluate(f'eventually volts_{number} > 9', grounding=grounding)
        assert answer.verdict == TRUE, answer.exit_status.message


def test_the_bare_name_of_a_stream_is_no_concept(system: System) -> None:
    answer = system.evaluate('eventually uav1_power > 150', grounding=SEMANTIC)
    assert answer.exit_status.code == ExitStatus.NOT_FOUND
    assert "'uav1_power'" in answer.exit_status.message


def test_stand_ins_are_told(system: System, spares: Spares) -> None:
    spares.power('uav1_spare_power', 'uav2', of='uav1')
    answer = system.evaluate('forall u in UAV: eventually Power[u] > 99')
    assert answer.verdict == TRUE, answer.exit_status.message
    stand_ins = {each.symbol: list(each.stand_ins) for each in answer.groundings}
    (spare,) = stand_ins['Power[uav1]']
    assert 'from uav1_spare_power' in spare
    assert stand_ins['Power[uav2]'] == []


def test_a_derived_feature(
    system: System, positions: dict[str, tuple[float, float]], evaluations: Evaluations
) -> None:
    """A distance that a computational unit makes of two positions, each found by its meaning."""
    distance = 'XYDist[uav1, uav2]'
    answer = system.evaluate(f'eventually {distance} = 50', timeout=20.0)
    assert answer.verdict == TRUE, answer.exit_status.message
    assert 'uav1_uav2_distance' in grounded(answer)[distance][1]
    future = system.ask(f'always {distance} > 20', timeout=20.0)
    evaluations.wait_for_state()
    positions['uav2'] = (6.0, 8.0)
    system.decided(future, FormulaResult.FALSE)
    assert math.hypot(*positions['uav2']) == 10.0
    assert f'{distance} = 10' in future.result().explanation


def test_every_missing_feature_is_named_with_what_came_nearest(system: System) -> None:
    answer = system.evaluate('forall u in UAV: always (Power[u] < 150 and XYDist[u, u] < 1)')
    assert answer.exit_status.code == ExitStatus.NOT_FOUND, answer
    for word in ('XYDist[uav1, uav1]', 'XYDist[uav2, uav2]', 'annotate'):
        assert word in answer.exit_status.message
    assert 'XYDist[uav1, uav2]' in answer.exit_status.message.partition('there are')[2]
    assert 'Power' not in answer.exit_status.message
    assert answer.verdict == FormulaResult.UNDECIDED


def test_features_of_two_kinds_are_missing(system: System, spares: Spares) -> None:
    answer = system.evaluate('always (Power[uav7] < 150 and powr_of_uav1 < 3)')
    assert answer.exit_status.code == ExitStatus.NOT_FOUND, answer
    for word in ('uav7', 'powr_of_uav1'):
        assert word in answer.exit_status.message
    spares.clear()


def test_the_sample_period_of_a_caller(system: System, batteries: Batteries) -> None:
    """States are asked for at whole seconds after a start: that decides when it is decided."""
    start = batteries.stamp + 2 * SECOND
    constraints = StreamConstraints(
        start_time=[nanoseconds_to_time(start)],
        sample_period=[nanoseconds_to_duration(500 * MILLISECOND)],
    )
    answer = system.evaluate('always[0 s, 1 s] Power[uav1] < 150', constraints=constraints)
    assert answer.verdict == TRUE, answer.exit_status.message
    # The window's last state decides; none comes before the start. On a busy machine, the states
    # may begin later.
    end = nanoseconds(answer.decided_at) - start
    assert end >= SECOND
    assert end % (500 * MILLISECOND) == 0


def test_what_is_before_the_start_does_not_count(system: System, batteries: Batteries) -> None:
    start = batteries.change(uav1=240.0) + 4 * SECOND
    constraints = StreamConstraints(start_time=[nanoseconds_to_time(start)])
    future = system.ask('always[0 s, 600 ms] Power[uav1] < 150', constraints=constraints)
    system.client.spin_until(lambda: batteries.stamp >= start - 2 * SECOND, 'nearly')
    assert batteries.change(uav1=100.0) < start
    answer = system.decided(future, TRUE)
    assert nanoseconds(answer.decided_at) >= start + 600 * MILLISECOND


def test_nothing_is_decided_after_the_end(system: System, batteries: Batteries) -> None:
    end = batteries.stamp + SECOND
    constraints = StreamConstraints(end_time=[nanoseconds_to_time(end)])
    future = system.ask('always[0 s, 3 s] Power[uav1] < 150', 3.0, constraints=constraints)
    system.client.spin_until(lambda: batteries.stamp > end, 'the end')
    batteries.power['uav1'] = 240.0
    system.client.spin_until(future.done, 'the answer')
    assert future.result().exit_status.code == ExitStatus.TIMEOUT, future.result()
    assert future.result().verdict == FormulaResult.UNDECIDED


def test_the_delay_of_a_caller_is_kept(system: System, batteries: Batteries) -> None:
    """A caller's stricter constraint is broken by the stream."""
    constraints = StreamConstraints(max_delay=[nanoseconds_to_duration(MILLISECOND)])
    monitored = Monitored(
        system.client, 'always "/uav1/battery".voltage > 9', constraints=constraints
    )
    batteries.silent.add('uav1')
    batteries.publish_after_latest('uav1', -SECOND // 2)
    batteries.silent.clear()
    result = monitored.result()
    assert result.exit_status.code == ExitStatus.CONSTRAINT_VIOLATION, result
    assert 'max_delay: ' in result.exit_status.message
    assert '1 ms allowed' in result.exit_status.message


def test_constraints_that_make_no_sense(system: System) -> None:
    constraints = StreamConstraints(
        sample_period_deviation=[nanoseconds_to_duration(500 * MILLISECOND)],
        sample_period=[nanoseconds_to_duration(-SECOND)],
    )
    answer = system.evaluate('always Power[uav1] < 150', constraints=constraints)
    assert answer.exit_status.code == ExitStatus.INVALID_ARGUMENT, answer
    assert 'sample_period' in answer.exit_status.message


def test_a_topic_that_cannot_be_one(system: System) -> None:
    answer = system.evaluate('eventually "/a//b".voltage > 9', grounding=SYNTACTIC)
    assert answer.exit_status.code == ExitStatus.INVALID_ARGUMENT, answer.exit_status.message
    assert "'/a//b' cannot be the name of a topic" in answer.exit_status.message
