"""Guards of a real system: each way of closing, and of refusing a command."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from dyknow_interfaces.msg import GuardStatus
from dyknow_interfaces.srv import ConceptCreate, ConceptDestroy, InstanceCreate, InstanceDestroy
from geometry_msgs.msg import Twist

from dyknow_bringup.processes.processes import Process
from evaluations import Evaluations, Spares
from guards import GuardedBase, guarded_base, is_zero
from system import Batteries, System

TIMEOUT_S = 0.6
"""The timeout of the guards: states come each 0.2 s, on a busy computer."""

IMMEDIATE_S = 0.1
POWER = "['Power[uav1] < 150 W']"
COMMAND = '"/cmd_vel_in".linear.x'


@pytest.fixture
def base(system: System, tmp_path: Path) -> Iterator[GuardedBase]:
    system.batteries.reset()
    with guarded_base(system, tmp_path, POWER) as running:
        running.wait_until_open()
        yield running


def guarded(system: System, folder: Path, formulas: str, options: str = '') -> Any:
    system.batteries.reset()
    return guarded_base(system, folder, formulas, options)


def test_a_formula_that_is_false(system: System, base: GuardedBase) -> None:
    event = time.time()
    system.batteries.power['uav1'] = 200.0
    base.assert_safe_after(event, Batteries.PERIOD / 1e9 + IMMEDIATE_S)
    base.wait_for(GuardStatus.CLOSED, 'is not < 150 W')
    system.batteries.power['uav1'] = 100.0
    base.wait_until_open()


def test_a_silent_topic(system: System, base: GuardedBase) -> None:
    event = time.time()
    system.batteries.silent.add('uav1')
    base.assert_safe_after(event, TIMEOUT_S)
    base.wait_for(GuardStatus.CLOSED)
    assert not base.reason.startswith('stream_'), base.reason
    system.batteries.silent.clear()
    system.batteries.reset()
    base.wait_until_open()


def test_a_violation(system: System, base: GuardedBase) -> None:
    """A sample that is stamped 50 ms too early breaks sample_period_deviation.

    The guard asks anew 0.5 s later, and opens with the states after the violation.
    """
    event = time.time()
    system.batteries.publish_after_latest('uav1', 20_000_000)
    base.assert_safe_after(event, Batteries.PERIOD / 1e9 + IMMEDIATE_S, reopens=True)
    assert any('sample_period is' in each for each in base.reasons()), base.reasons()
    system.batteries.reset()
    base.wait_until_open()


def test_a_violation_of_former_states(
    system: System, evaluations: Evaluations, tmp_path: Path
) -> None:
    """The stream of the violation is gone when the guard continues, perhaps with its message.

    A guard that is killed and started again first reads the states of the former process's
    evaluation, while its own is prepared.
    """

    def ends() -> int:
        ended = evaluations.ended(f'/base_guard: {POWER[2:-2]}')
        return sum('sample_period is' in each.exit_status.message for each in ended)

    system.batteries.reset()
    for _ in range(2):
        with guarded_base(system, tmp_path, POWER, timeout='5 s') as base:
            base.wait_until_open()
            reported, before = len(base.statuses), ends()
            base.process.send_signal(signal.SIGSTOP)
            system.batteries.publish_after_latest('uav1', 20_000_000)
            system.client.spin_until(
                lambda count=before: ends() > count, 'the end', instead=evaluations.told
            )
            base.process.send_signal(signal.SIGCONT)
            system.client.spin_until(
                lambda at=reported: any('sample_period is' in each for each in base.reasons(at)),
                'the guard has closed because of the violation',
                instead=lambda at=reported: base.reasons(at),
            )
            base.wait_until_open()


def test_objects_that_change(system: System, spares: Spares, tmp_path: Path) -> None:
    """Without objects, the formula is false, and no state comes; the guard does not wait for it."""

    def ontology(service: Any, name: str, **fields: Any) -> None:
        answer = system.client.call(service, f'ontology_manager/{name}', **fields)
        assert not answer.exit_status.code, answer.exit_status.message

    names = {'instance_name': 'uav3', 'concept_names': ['Scout']}
    ontology(ConceptCreate, 'concept_create', concept_name='Scout', parent_concepts=['UAV'])
    ontology(InstanceCreate, 'instance_create', **names)
    spares.power('uav3_power', 'uav1', of='uav3')
    formula = "['exists s in Scout: Power[s] < 150 W']"
    system.batteries.reset()
    with guarded_base(system, tmp_path, formula, timeout='20 s') as base:
        base.wait_until_open()
        reported = len(base.statuses)
        ontology(InstanceDestroy, 'instance_destroy', instance_name='uav3')
        base.wait_for(GuardStatus.CLOSED, 'it is false at any state')
        assert not any('older than' in each for each in base.reasons(reported))
        ontology(InstanceCreate, 'instance_create', **names)
        base.wait_until_open()
    spares.clear()
    ontology(InstanceDestroy, 'instance_destroy', instance_name='uav3')
    ontology(ConceptDestroy, 'concept_destroy', concept_name='Scout')


def test_without_commands_the_safe_message_is_repeated(system: System, base: GuardedBase) -> None:
    base.is_commanding = False
    system.batteries.power['uav1'] = 200.0
    base.wait_for(GuardStatus.CLOSED)
    # The last command that was let through may arrive after the status.
    base.client.spin_until(lambda: is_zero(base.received[-1][1]), 'a safe message')
    begin = len(base.received)
    base.client.spin_until(lambda: len(base.received) > begin + 5, 'safe messages')
    assert all(is_zero(message) for _, message in base.received[begin:])


def test_a_guard_that_is_stopped_passes_nothing_stale(system: System, base: GuardedBase) -> None:
    base.process.send_signal(signal.SIGSTOP)
    base.client.wait(1.0)
    begin, event = len(base.received), time.time()
    base.process.send_signal(signal.SIGCONT)
    base.client.spin_until(lambda: len(base.received) > begin, 'the guard goes on')
    base.wait_until_open()
    passed = [message for _, message in base.received[begin:] if not is_zero(message)]
    assert all(message.linear.y > event for message in passed)
    assert system.running  # The states went on.


@pytest.mark.parametrize(
    ('node', 'reason'),
    [
        ('stream_reasoning_coordinator', 'stream_reasoning_coordinator: the latest sign of life'),
        ('stream_reasoning_engine', 'stream_reasoning_engine: the latest sign of life'),
        ('stream_manager', 'stream_manager: the latest sign of life'),
        ('stream_processing_engine', 'Power[uav1] < 150 W: the latest state'),
    ],
)
@pytest.mark.parametrize('end', ['SIGSTOP', 'SIGKILL'])
def test_the_end_of_a_node(
    system: System, base: GuardedBase, node: str, reason: str, end: str
) -> None:
    context = system.stopped(node) if end == 'SIGSTOP' else system.killed(node)
    event = time.time()
    with context:
        base.assert_safe_after(event, TIMEOUT_S)
        assert base.state == GuardStatus.CLOSED
        # On a busy computer, the guard may learn of the end of a node from another one first.
        reasons = (
            reason,
            f'node {node} is gone',
            'the guard itself was stopped or had no processor',
        )
        assert any(each in base.reason for each in reasons), base.reason
    system.client.wait_for_coordinator()
    system.client.spin_until(lambda: system.streams() >= system.fleet_streams, 'the streams')
    system.batteries.reset()
    base.wait_until_open()


def test_a_latch(system: System, tmp_path: Path) -> None:
    system.batteries.reset()
    # On a busy machine, states may be late: that would close the guard for good, too.
    with guarded_base(system, tmp_path, POWER, '    latch: true\n', timeout='5 s') as base:
        base.wait_until_open()
        system.batteries.power['uav1'] = 200.0
        base.wait_for(GuardStatus.LATCHED, 'Power[uav1] = 200.0')
        answer = base.reset()
        assert (answer.success, base.state) == (False, GuardStatus.LATCHED)
        assert 'Power[uav1]' in answer.message
        system.batteries.power['uav1'] = 100.0
        begin = system.batteries.stamp
        base.client.spin_until(
            lambda: system.batteries.stamp > begin + 3 * Batteries.PERIOD, 'states that hold'
        )
        assert base.state == GuardStatus.LATCHED
        assert is_zero(base.received[-1][1])
        base.client.spin_until(lambda: base.reset().success, 'the latch is released')
        base.wait_until_open()


def test_a_command_that_would_violate_a_formula(system: System, tmp_path: Path) -> None:
    formulas = (
        f"['{COMMAND} < 0.5', 'forall u in UAV: {COMMAND} > 0.3 -> Power[u] < 150', "
        f"'{COMMAND} > 0.45 -> previous {COMMAND} > 0.35']"
    )
    safe = '    safe: {linear: {x: -0.1}}\n'
    with guarded(system, tmp_path, formulas, safe) as base:
        base.wait_until_open()
        for speed in (0.7, float('nan')):
            base.speed = speed
            base.wait_for_message(lambda message: message.linear.x == -0.1, 'the safe message')
            assert base.state == GuardStatus.OPEN
        system.batteries.power['uav2'] = 200.0
        base.speed = 0.2
        base.wait_for_message(lambda message: message.linear.x == 0.2, 'a slow command')
        base.speed = 0.4
        base.wait_for_message(lambda message: message.linear.x == -0.1, 'no fast command')
        system.batteries.power['uav2'] = 100.0
        base.wait_for_message(lambda message: message.linear.x == 0.4, 'a fast command')
        base.speed = 0.47
        base.wait_for_message(lambda message: message.linear.x == 0.47, 'a small step')
        base.speed = 0.2
        base.wait_for_message(lambda message: message.linear.x == 0.2, 'a slow command')
        base.speed = 0.47
        base.wait_for_message(lambda message: message.linear.x == -0.1, 'no large step')
        begin = len(base.received)
        system.batteries.silent.add('uav1')
        base.wait_for(GuardStatus.CLOSED)
        assert all(message.linear.x != 0.47 for _, message in base.received[begin:])


SECOND_GUARD = """\
guards:
  - name: wheel_guard
    input: /cmd_vel
    output: /wheels
    timeout: 600 ms
    formulas: ['Power[uav2] < 150']
"""


@pytest.fixture
def wheels(system: System, base: GuardedBase, tmp_path: Path) -> Iterator[list[Any]]:
    """The messages that a second guard passes on, behind the first one."""
    path = tmp_path / 'second.yaml'
    path.write_text(SECOND_GUARD, encoding='utf-8')
    received: list[Any] = []
    subscription = base.client.node.create_subscription(Twist, '/wheels', received.append, 100)
    given = {'robot': str(path), 'guard': ''}
    system.launcher.start(Process('dyknow_reactions', 'guard', given, node='wheel_guard'))
    yield received
    system.launcher.kill('wheel_guard')
    base.client.node.destroy_subscription(subscription)


def test_guards_in_a_row(system: System, base: GuardedBase, wheels: list[Any]) -> None:
    """Each of them closes by its own formula; the second one passes the first one's messages."""

    def wait_for(speed: float) -> None:
        begin = len(wheels)
        base.client.spin_until(
            lambda: any(each.linear.x == speed for each in wheels[begin:]), f'{speed} m/s'
        )

    wait_for(base.speed)
    system.batteries.power['uav2'] = 200.0
    wait_for(0.0)
    base.wait_until_open()
    system.batteries.power['uav2'] = 100.0
    wait_for(base.speed)
    system.batteries.power['uav1'] = 200.0
    base.wait_for(GuardStatus.CLOSED, 'Power[uav1] = 200.0')
    wait_for(0.0)
    system.batteries.power['uav1'] = 100.0
    wait_for(base.speed)


def test_nothing_instead_of_a_safe_message(system: System, tmp_path: Path) -> None:
    with guarded(system, tmp_path, f"['{COMMAND} < 0.5']", '    safe: nothing\n') as base:
        base.wait_until_open()
        base.speed = 0.7
        refused = base.statuses[-1].refused
        base.client.spin_until(lambda: base.statuses[-1].refused > refused + 20, 'refusals')
        assert all(message.linear.x == 0.4 for _, message in base.received)
        assert all(each.state != GuardStatus.LATCHED for each in base.statuses)
