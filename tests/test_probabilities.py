"""Probabilities that real nodes evaluate."""

from __future__ import annotations

from typing import Any

from dyknow_interfaces.msg import EvaluationStatusArray
from nav_msgs.msg import Odometry

from dyknow_common import Verdict
from dyknow_common.ros import LATCHED
from dyknow_coordinator import Answer, Progress
from dyknow_coordinator.ros import FormulaClient
from system import Batteries, System

STATED = 'let Power ~ normal(Power, 4 W, 0 s) in forall u in UAV: '


def test_a_formula_asks_for_probabilities(system: System, batteries: Batteries) -> None:
    """The estimates are 100 W, 2.5 and 0.5 deviations from the limits."""
    assert set(batteries.power.values()) == {100.0}
    system.wait_for_streams()
    with FormulaClient(system.client.node) as client:
        texts = (
            f'{STATED}always[0 s, 300 ms] P(Power[u] < 110 W) >= 0.99',
            f'{STATED}P(always[0 s, 300 ms] Power[u] < 102 W) >= 0.9',
        )
        node, told, statuses = system.client.node, list[Progress](), list[Any]()
        topic = '/stream_reasoning_coordinator/evaluations'
        subscription = node.create_subscription(
            EvaluationStatusArray, topic, statuses.append, LATCHED
        )
        endless = client.monitor(
            f'{STATED}always P(Power[u] < 110 W) >= 0.99', on_feedback=told.append
        )
        monitors = [client.monitor(text) for text in texts]
        for each in monitors:
            system.client.spin_until(each.outcome.done, 'the verdict')
        system.client.spin_until(lambda: any(each.probability for each in told), 'a probability')
        system.client.spin_until(
            lambda: any(
                interval.upper < 1
                for array in statuses
                for status in array.evaluations
                for interval in status.probability
            ),
            'a status with a probability',
        )
        endless.cancel()
        system.client.spin_until(endless.outcome.done, 'the end')
        node.destroy_subscription(subscription)
        true, false = (each.outcome.result() for each in monitors)
    system.wait_for_streams()
    assert isinstance(true, Answer)
    assert isinstance(false, Answer)
    assert (true.verdict, false.verdict) == (Verdict.TRUE, Verdict.FALSE)
    (bounds, *_) = {each.probability.bounds for each in told if each.probability}
    assert bounds == '0.99379'
    assert 'at most 0.691463, assuming independent errors' in false.explanation


def test_covariances_and_samples_of_a_topic(system: System) -> None:
    """The errors of the point (1, 1) go together; the samples are 0 to 35."""
    pose, cloud = '"/cloud".pose', '"/cloud".twist.covariance'
    x, y = (f'{pose}.pose.position.{each}' for each in 'xy')
    covariance = f'covariance({y}, {pose}.covariance[1])'
    correlated = f'normal({x}, sqrt({pose}.covariance[0]), {covariance})'
    difference = f'{correlated} - normal({y}, sqrt({pose}.covariance[7]))'
    sampled = f'sampled(mean({cloud}), samples({cloud}))'
    node, odometry = system.client.node, Odometry()
    odometry.pose.pose.position.x = odometry.pose.pose.position.y = 1.0
    odometry.pose.covariance[[0, 1, 7]] = 1.0, 0.995, 1.0
    odometry.twist.covariance[:] = range(36)
    publisher = node.create_publisher(Odometry, '/cloud', 10)

    def publish() -> None:
        odometry.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(odometry)

    timer = node.create_timer(0.1, publish)
    with FormulaClient(node) as client:
        asked = client.monitor(
            f'always[0 s, 300 ms] (P(abs({difference}) < 0.3) > 0.9 and P({sampled} > 17.5) > 0.32)'
        )
        system.client.spin_until(asked.outcome.done, 'the verdict')
        answer = asked.outcome.result()
    node.destroy_timer(timer)
    node.destroy_publisher(publisher)
    assert isinstance(answer, Answer)
    assert answer.check().verdict is Verdict.TRUE
