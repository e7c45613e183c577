"""Formulas that are asked at every state: episodes, in feedback, reports and diagnostics."""

from __future__ import annotations

import json
import os
import subprocess
from functools import partial

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from dyknow_interfaces.msg import ExitStatus, FormulaEpisodes, FormulaResult
from rclpy.qos import QoSProfile

from commands import command
from dyknow_common.ros import LATCHED_HISTORY
from evaluations import Evaluations, Monitored, Spares
from system import SOON_NOTICED, SPARES, Batteries, SharedSystem, System

INVARIANT = 'forall u in UAV: Power[u] < 150'
RESPONSE = 'Power[uav1] > 150 -> eventually[0 s, 2 s] Power[uav1] < 150'
NAME = 'power'

pytestmark = pytest.mark.usefixtures('calm')


class Diagnostics:
    """The latest diagnosis of the formula."""

    def __init__(self, system: System) -> None:
        self.level: int | None = None
        system.client.node.create_subscription(
            DiagnosticArray, '/diagnostics', self._hear, QoSProfile(depth=10)
        )

    def _hear(self, array: DiagnosticArray) -> None:
        for each in array.status:
            if each.name.endswith(f': {NAME}'):
                self.level = each.level


@pytest.fixture(scope='module')
def system(shared_system: SharedSystem) -> System:
    return shared_system.get(parameters=SOON_NOTICED, spares=SPARES, composition=True)


def latest(monitored: Monitored) -> FormulaEpisodes:
    return monitored.feedback[-1].episodes if monitored.feedback else FormulaEpisodes()


def test_an_invariant_is_violated_twice_and_cleared(
    system: System, batteries: Batteries, evaluations: Evaluations
) -> None:
    diagnostics = Diagnostics(system)
    topic = 'stream_reasoning_engine/episodes'
    reports = system.client.collect(FormulaEpisodes, topic, LATCHED_HISTORY)
    monitored = Monitored(system.client, INVARIANT, every_state=True, margin=True, name=NAME)
    wait = partial(system.client.spin_until, instead=monitored.told)
    wait(lambda: latest(monitored).holds > 0, 'states from which it holds')
    wait(lambda: diagnostics.level == DiagnosticStatus.OK, 'the diagnosis OK')
    for number in (1, 2):
        batteries.power['uav2'] = 240.0
        wait(lambda: latest(monitored).is_violated, 'a violation')
        wait(lambda: diagnostics.level == DiagnosticStatus.ERROR, 'the diagnosis ERROR')
        (status,) = evaluations.running
        assert status.every_state
        assert status.episodes.is_violated
        batteries.power['uav2'] = 140.0
        wait(lambda: not latest(monitored).is_violated, 'the end of the violation')
        wait(lambda: diagnostics.level == DiagnosticStatus.OK, 'the diagnosis OK again')
        assert latest(monitored).episode_count == number
    worst = latest(monitored).latest_episodes[0].worst
    wait(lambda: monitored.feedback[-1].margin == worst, 'the least margin of all states')
    result = monitored.end()
    assert result.exit_status.code == ExitStatus.CANCELLED
    assert result.verdict == FormulaResult.FALSE
    episodes = result.episodes
    assert (episodes.episode_count, episodes.is_violated) == (2, False)
    assert sum(each.states for each in episodes.latest_episodes) == episodes.fails > 0
    assert all(each.has_ended for each in episodes.latest_episodes)
    assert 'for u = uav2: Power[uav2] = 240' in episodes.latest_episodes[0].explanation
    assert (worst.lower, worst.upper, worst.unit) == (-90.0, -90.0, 'W')
    assert result.margin == worst == episodes.latest_episodes[0].worst
    violations = [each for each in monitored.events if each.startswith('violated from')]
    ends = [each for each in monitored.events if each.startswith('holds again')]
    assert (len(violations), len(ends)) == (2, 2)
    assert {each.formula_name for each in reports} == {reports[0].formula_name}


def test_a_response_that_comes_too_late(system: System, batteries: Batteries) -> None:
    wait = system.client.spin_until
    monitored = Monitored(system.client, RESPONSE, every_state=True, timeout=30)
    wait(lambda: latest(monitored).holds > 0, 'states from which it holds')
    batteries.power['uav1'] = 240.0
    wait(lambda: latest(monitored).undecided > 0, 'states from which it is undecided')
    wait(lambda: latest(monitored).is_violated, 'a violation')
    batteries.power['uav1'] = 140.0
    wait(lambda: not latest(monitored).is_violated, 'the end of the violation')
    (episode,) = latest(monitored).latest_episodes
    assert 'Power[uav1] < 150' in episode.explanation
    monitored.end()


def test_a_stream_that_fails_in_between(
    system: System, batteries: Batteries, evaluations: Evaluations, spares: Spares
) -> None:
    """The violation that has begun before the gap ends after it."""
    wait = system.client.spin_until
    spares.power('uav1_spare_power', 'spare1', of='uav1')
    monitored = Monitored(system.client, 'Power[uav1] < 150', every_state=True)
    wait(lambda: latest(monitored).holds > 0, 'states from which it holds')
    batteries.power['uav1'] = 240.0
    wait(lambda: latest(monitored).is_violated, 'a violation')
    batteries.silent.add('uav1')
    evaluations.wait_for_event('uav1_battery', 'uav1_spare_power')
    wait(lambda: not latest(monitored).is_violated, 'the end of the violation')
    assert latest(monitored).episode_count == 1
    batteries.power['spare1'] = 240.0
    wait(lambda: latest(monitored).is_violated, 'another violation')
    assert monitored.end().episodes.episode_count == 2


def test_the_timeout_ends_it_with_what_is_known(system: System) -> None:
    monitored = Monitored(system.client, INVARIANT, every_state=True, timeout=8)
    result = monitored.result()
    assert result.exit_status.code == ExitStatus.SUCCESS
    assert result.verdict == FormulaResult.TRUE
    assert result.explanation.startswith('holds from ')
    assert result.episodes.holds > 0


def test_the_command(system: System) -> None:
    options = ('--every-state', '--timeout', '8 s', '--json')
    process = subprocess.Popen(
        command('dyknow', 'evaluate', INVARIANT, *options),
        env={**os.environ, **system.environment},
        stdout=subprocess.PIPE,
        text=True,
    )
    system.client.spin_until(lambda: process.poll() is not None, 'the command ends')
    answer = json.loads(process.communicate()[0])
    assert (process.returncode, answer['verdict']) == (0, 'true')
    assert answer['every_state']['holds'] > 0
    assert answer['every_state']['latest_episodes'] == []


def test_what_is_undecided_at_the_timeout(system: System, batteries: Batteries) -> None:
    batteries.power['uav1'] = 140.0
    formula = 'Power[uav1] > 130 -> eventually[0 s, 100 s] Power[uav1] < 110'
    monitored = Monitored(system.client, formula, every_state=True, timeout=8)
    system.client.spin_until(lambda: latest(monitored).undecided > 0, 'undecided states')
    result = monitored.result()
    assert result.exit_status.code == ExitStatus.TIMEOUT
    assert result.verdict == FormulaResult.UNDECIDED
    assert 'within 8 s' in result.exit_status.message
    assert result.episodes.undecided > 0


@pytest.mark.parametrize(
    ('formula', 'answer'),
    [
        ('1 < 2', 'it is true, whatever the states are'),
        ('eventually[1 s, 2 s] true', 'no state has come: the formula depends on no feature'),
    ],
)
def test_a_formula_without_states_is_answered(system: System, formula: str, answer: str) -> None:
    result = Monitored(system.client, formula, timeout=2.0, every_state=True).result()
    assert answer in f'{result.explanation}{result.exit_status.message}'
