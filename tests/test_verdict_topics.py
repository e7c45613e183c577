"""The topics with the verdicts of named formulas, of a running coordinator."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import isnan
from typing import Any

import pytest
from dyknow_interfaces.msg import ExitStatus, FormulaVerdict
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from dyknow_common import Verdict
from dyknow_common.ros import time_to_nanoseconds
from dyknow_coordinator import EvaluationPhase, EvaluationStatus
from dyknow_coordinator.ros.reporting.verdict_publishers import VerdictPublishers
from evaluations import COORDINATOR, Evaluations, Monitored
from reporter import Reporter
from system import Batteries, Client, System

VERDICTS = f'/{COORDINATOR}/verdicts'
LATCHED = QoSProfile(
    depth=10,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    reliability=ReliabilityPolicy.RELIABLE,
)
PLOTTED = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
"""As plotting tools subscribe."""

POWER = 'always Power[uav1] < 200'

pytestmark = pytest.mark.usefixtures('calm')


class Verdicts:
    """The messages on the topic of a formula."""

    def __init__(self, client: Client, token: str, profile: QoSProfile = LATCHED) -> None:
        self.heard: list[Any] = []
        self._client = client
        self._subscription = client.node.create_subscription(
            FormulaVerdict, f'{VERDICTS}/{token}', self.heard.append, profile
        )

    def close(self) -> None:
        self._client.node.destroy_subscription(self._subscription)

    def wait_for(self, verdict: Verdict) -> Any:
        self._client.spin_until(
            lambda: self.heard[-1:] != [] and self.heard[-1].verdict == verdict,
            f'{verdict.name} on the topic',
            instead=lambda: self.heard[-1:],
        )
        return self.heard[-1]


@pytest.fixture
def client(system: System) -> Client:
    return system.client


@pytest.fixture
def power(client: Client) -> Iterator[Verdicts]:
    verdicts = Verdicts(client, 'power')
    yield verdicts
    verdicts.close()


def topics(client: Client) -> set[str]:
    """The last parts of the names of all topics with verdicts."""
    names = [name for name, _ in client.node.get_topic_names_and_types()]
    return {name.rpartition('/')[2] for name in names if name.startswith(f'{VERDICTS}/')}


def test_a_formula_that_becomes_false(
    client: Client, power: Verdicts, evaluations: Evaluations, batteries: Batteries
) -> None:
    monitored = Monitored(client, POWER, name='power', margin=True)
    evaluations.wait_for_state()
    client.spin_until(
        lambda: power.heard[-1:] != [] and power.heard[-1].upper_margin == 100.0,
        'the margin',
        instead=lambda: power.heard[-1:],
    )
    running = power.heard[-1]
    assert (running.name, running.verdict) == ('power', Verdict.UNDECIDED)
    assert not running.is_violated
    assert not running.presumably_false
    stamp = time_to_nanoseconds(running.header.stamp)
    assert stamp > 0
    batteries.power['uav1'] = 231.0
    ended = power.wait_for(Verdict.FALSE)
    result = monitored.result()
    assert ended.is_violated
    assert ended.exit_status.code == ExitStatus.SUCCESS
    assert time_to_nanoseconds(ended.header.stamp) >= time_to_nanoseconds(result.decided_at) > stamp
    assert ended.upper_margin == pytest.approx(-31.0)
    late = Verdicts(client, 'power')
    assert late.wait_for(Verdict.FALSE) == ended
    late.close()


def test_it_is_published_each_second_and_its_next_evaluation_continues_it(
    client: Client, power: Verdicts, evaluations: Evaluations
) -> None:
    plotted = Verdicts(client, 'power', PLOTTED)
    monitored = Monitored(client, POWER, name='power')
    evaluations.wait_for_state()
    before = len(plotted.heard)
    client.spin_until(lambda: len(plotted.heard) >= before + 3, 'three more verdicts')
    assert isnan(plotted.heard[-1].lower_margin)
    assert monitored.end().exit_status.code == ExitStatus.CANCELLED
    client.spin_until(
        lambda: power.heard[-1:] != [] and power.heard[-1].exit_status.code == ExitStatus.CANCELLED,
        'it is cancelled',
    )
    assert not power.heard[-1].is_violated
    again = Monitored(client, POWER, name='power')
    client.spin_until(
        lambda: power.heard[-1].exit_status.code == ExitStatus.SUCCESS, 'it runs again'
    )
    assert 'power_2' not in topics(client)
    again.cancel()
    plotted.close()


def test_two_at_once_have_two_topics_and_a_formula_without_a_name_has_none(
    client: Client, evaluations: Evaluations
) -> None:
    before = topics(client)
    monitored = [
        Monitored(client, POWER, name='no surge'),
        Monitored(client, 'always Power[uav2] < 200', name='no surge'),
        Monitored(client, POWER),
    ]
    evaluations.wait_for(3)
    wanted = {'no_surge', 'no_surge_2'}
    client.spin_until(lambda: wanted <= topics(client), 'both topics')
    assert topics(client) - before == wanted
    for each in monitored:
        each.cancel()


def test_an_episode_is_a_violation_until_it_ends(
    client: Client, evaluations: Evaluations, batteries: Batteries
) -> None:
    verdicts = Verdicts(client, 'standing')
    monitored = Monitored(client, 'Power[uav1] < 200', name='standing', every_state=True)
    evaluations.wait_for_state()

    def wait_for(is_violated: bool) -> None:  # noqa: FBT001
        client.spin_until(
            lambda: verdicts.heard[-1:] != [] and verdicts.heard[-1].is_violated is is_violated,
            f'is_violated is {is_violated}',
        )
        assert verdicts.heard[-1].verdict == Verdict.UNDECIDED

    wait_for(False)
    batteries.power['uav1'] = 231.0
    wait_for(True)
    batteries.power['uav1'] = 100.0
    wait_for(False)
    monitored.cancel()
    verdicts.close()


def test_an_error_is_on_the_topic(client: Client) -> None:
    verdicts = Verdicts(client, 'wrong')
    Monitored(client, 'always Pwer[uav1] < 200', name='wrong').result()
    client.spin_until(
        lambda: (
            verdicts.heard[-1:] != []
            and verdicts.heard[-1].exit_status.code == ExitStatus.NOT_FOUND
        ),
        'the error',
    )
    assert 'Pwer' in verdicts.heard[-1].exit_status.message
    verdicts.close()


def test_topics_are_limited_and_removed(monkeypatch: pytest.MonkeyPatch) -> None:
    reporter, statuses = Reporter(), dict[str, EvaluationStatus]()
    node = reporter._node
    warnings: list[str] = []
    monkeypatch.setattr(node.get_logger(), 'warning', warnings.append)
    running = EvaluationStatus('power', POWER, EvaluationPhase.RUNNING, started=1)
    statuses |= {'1': running, '2': replace(running, name='speed')}
    VerdictPublishers(node, lambda: statuses, lambda: 1)
    reporter.until(lambda: topics(reporter.client) == {'power'}, 'one topic')
    assert warnings
    assert 'the verdicts of speed' in warnings[0]
    assert "'verdict_topic_limit'" in warnings[0]
    del statuses['1']
    reporter.until(lambda: topics(reporter.client) == {'speed'}, 'room for the other one')
    statuses.clear()
    reporter.until(lambda: not topics(reporter.client), 'no topic')
    reporter.close()
