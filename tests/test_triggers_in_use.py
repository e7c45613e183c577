"""Triggers as users start them: `dyknow up` and `dyknow monitor` with one robot.yaml."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from dyknow_interfaces.action import MonitorFormula
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.qos import QoSProfile
from rclpy.task import Future
from std_msgs.msg import String
from std_srvs.srv import SetBool

from commands import command, dyknow_up
from system import private_environment
from test_rover import Rover

SET_BOOL = 'std_srvs/srv/SetBool'
MONITOR = 'dyknow_interfaces/action/MonitorFormula'
NOISE = 'head -c 10000000 /dev/zero; head -c 10000000 /dev/zero >&2'

TRIGGERS = {
    'tell': {
        'publish': {
            'topic': '/faults',
            'type': 'std_msgs/msg/String',
            'message': {'data': 'message {name} {event}'},
        }
    },
    'call': {'call': {'service': '/alarm', 'type': SET_BOOL, 'request': {'data': True}}},
    'send': {'send_goal': {'action': '/dock', 'type': MONITOR, 'goal': {'name': '{name} {event}'}}},
    'cancel': {'cancel_goal': '/dock'},
    'run': {'run': ['sh', '-c', 'echo "$@" >> "$0"', 'LOG', 'command {name} {event}']},
    'once': {'run': ['true'], 'min_interval': '1 h'},
    'unanswered': {
        'call': {'service': '/silent', 'type': SET_BOOL},
        'timeout': '500 ms',
        'retries': 1,
    },
    'late': {'call': {'service': '/late', 'type': SET_BOOL}, 'timeout': '500 ms', 'retries': 10},
    'rejected': {'send_goal': {'action': '/rejecting', 'type': MONITOR}},
    'hangs': {'run': ['sleep', '1000'], 'timeout': '500 ms'},
    'prints': {'run': ['sh', '-c', NOISE], 'timeout': '60 s'},
    'lacks': {'publish': {'topic': '/nobody', 'type': 'std_msgs/msg/String'}},
}
ALL = ['tell', 'call', 'send', 'cancel', 'run']
FAILING = {
    'unanswered': 'service /silent has not answered within 500 ms',
    'rejected': 'action /rejecting rejects the goal',
    'hangs': 'the command has not ended: it was killed within 500 ms',
    'lacks': 'no node is known to subscribe to /nobody',
}
"""The triggers that fail, and why."""

ROBOT = """\
objects: {Rover: [rover1]}
features:
  Charge: {of: {r: Rover}, from: {topic: '/{r}/battery', field: percentage, max_delay: 500 ms,
    max_gap: 2 s}}
  Speed: {of: {r: Rover}, from: {topic: '/{r}/odom', field: twist.twist.linear.x, max_delay: 5 s}}
"""


def robot_file(folder: Path, log: Path) -> Path:
    """Write a robot.yaml with a formula for each pair of events."""
    triggers = json.loads(json.dumps(TRIGGERS).replace('LOG', str(log)))
    formulas = [
        {
            'name': 'charged',
            'formula': 'forall r in Rover: Charge[r] > 0.2',
            'severity': 'error',
            'every_state': True,
            'on': {'false': ALL, 'clear': ALL},
        },
        {
            'name': 'slow',
            'formula': 'forall r in Rover: always[0 s, 1 s] Speed[r] < 5',
            'on': {'true': [*ALL, 'late', 'prints', *FAILING]},
        },
        {
            'name': 'known',
            'formula': 'forall r in Rover: always Charge[r] > -1',
            'on': {'violation': [*ALL, 'once'], 'clear': ALL},
        },
    ]
    path = folder / 'robot.yaml'
    document = f'triggers: {json.dumps(triggers)}\nformulas: {json.dumps(formulas)}\n'
    path.write_text(ROBOT + document, encoding='utf-8')
    return path


class Surroundings:
    """The rover, the servers of its triggers, what they receive, and /diagnostics."""

    def __init__(self, rover: Rover) -> None:
        self.rover, self.node = rover, rover.client.node
        self.received = Counter[str]()
        self.statuses: dict[str, DiagnosticStatus] = {}
        self._silence: Future = Future()
        group = ReentrantCallbackGroup()
        node = self.node
        node.create_subscription(String, '/faults', self._hear, 10)
        node.create_subscription(
            DiagnosticArray, '/diagnostics', self._diagnose, QoSProfile(depth=100)
        )
        node.create_service(SetBool, '/alarm', self._alarm)
        node.create_service(SetBool, '/silent', self._keep_silent, callback_group=group)
        ActionServer(
            node, MonitorFormula, '/dock', self._dock, callback_group=group,
            goal_callback=self._accept, cancel_callback=self._cancel,
        )  # fmt: skip
        ActionServer(
            node, MonitorFormula, '/rejecting', self._dock, goal_callback=self._reject
        )  # fmt: skip

    def offer_late(self) -> None:
        self.node.create_service(SetBool, '/late', self._alarm)

    def status_of(self, name: str) -> DiagnosticStatus | None:
        """Return the status of a use of a trigger, by the end of its name."""
        found = (each for key, each in self.statuses.items() if key.endswith(name))
        return next(found, None)

    def wait_for_status(self, name: str, level: bytes, text: str) -> DiagnosticStatus:
        def is_there() -> bool:
            found = self.status_of(name)
            return found is not None and found.level == level and text in found.message

        self.rover.client.spin_until(
            is_there, f'{name}: {text}', instead=lambda: self.status_of(name)
        )
        found = self.status_of(name)
        assert found is not None
        return found

    def _hear(self, text: String) -> None:
        self.received[text.data] += 1

    def _diagnose(self, array: DiagnosticArray) -> None:
        self.statuses |= {each.name: each for each in array.status if ': on ' in each.name}

    def _alarm(self, _: Any, response: Any) -> Any:
        self.received['call'] += 1
        response.success = True
        return response

    async def _keep_silent(self, _: Any, response: Any) -> Any:
        await self._silence
        return response

    def _accept(self, goal: Any) -> GoalResponse:
        self.received[f'goal {goal.name}'] += 1
        return GoalResponse.ACCEPT

    def _reject(self, _: Any) -> GoalResponse:
        return GoalResponse.REJECT

    def _cancel(self, _: Any) -> CancelResponse:
        self.received['cancelled'] += 1
        return CancelResponse.ACCEPT

    async def _dock(self, goal: Any) -> Any:
        while not goal.is_cancel_requested:
            await self._pause()
        goal.canceled()
        return MonitorFormula.Result()

    async def _pause(self) -> None:
        over: Future = Future()

        def end() -> None:
            self.node.destroy_timer(timer)
            over.set_result(None)

        timer = self.node.create_timer(0.05, end)
        await over


@pytest.fixture
def surroundings(tmp_path: Path) -> Iterator[tuple[Surroundings, subprocess.Popen[str], Path]]:
    """DyKnow and a monitor that one robot.yaml describes, and what the monitor acts on."""
    environment, log = private_environment(), tmp_path / 'log'
    path = robot_file(tmp_path, log)
    with dyknow_up(environment, str(path), '--no-monitor'):
        rover = Rover(environment)
        found = Surroundings(rover)
        rover.client.wait_for_coordinator()
        with subprocess.Popen(
            command('dyknow', 'monitor', str(path), '--retry', '--json'),
            env={**os.environ, **environment},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        ) as monitor:
            try:
                yield found, monitor, log
            finally:
                monitor.kill()
                rover.close()


def test_each_trigger_follows_each_event(
    surroundings: tuple[Surroundings, subprocess.Popen[str], Path],
) -> None:
    found, monitor, log = surroundings
    rover, spin_until = found.rover, found.rover.client.spin_until

    def wait_for(name: str, event: str) -> None:
        """Wait until all triggers of an event have run."""
        ends = [f'{name}: on {event}: {trigger}' for trigger in ALL]

        def has_run() -> bool:
            assert monitor.poll() is None, monitor.communicate()[0]
            states = [found.status_of(each) for each in ends]
            return all(each is not None and 'done in' in each.message for each in states)

        spin_until(has_run, f'{name}: {event}', instead=lambda: found.statuses, limit=60.0)
        for kind in ('message', 'goal'):
            assert found.received[f'{kind} {name} {event}'] >= 1, found.received
        assert f'command {name} {event}\n' in log.read_text(encoding='utf-8')

    wait_for('slow', 'true')
    for name, reason in FAILING.items():
        end = f'slow: on true: {name}'
        status = found.wait_for_status(end, DiagnosticStatus.ERROR, reason)
        values = {each.key: each.value for each in status.values}
        assert (values['runs'], values['failures']) == ('1', '1')
    found.wait_for_status('slow: on true: prints', DiagnosticStatus.OK, 'done in attempt 1')
    found.wait_for_status('slow: on true: late', DiagnosticStatus.WARN, 'is not available')
    found.offer_late()
    found.wait_for_status('slow: on true: late', DiagnosticStatus.OK, 'done in attempt')

    rover.tell(charge=0.1)
    wait_for('charged', 'false')
    rover.tell(charge=0.9)
    wait_for('charged', 'clear')

    rover.tell(publishes_battery=False)
    wait_for('known', 'violation')
    rover.tell(publishes_battery=True)
    wait_for('known', 'clear')
    # With --retry, the formula ends with an error again and again.
    status = found.status_of('known: on violation: once')
    assert status is not None
    values = {each.key: each.value for each in status.values}
    assert (values['runs'], values['ignored events']) == ('1', '0')
    assert found.received['call'] >= 5
    assert found.received['cancelled'] >= 5

    monitor.send_signal(signal.SIGINT)
    spin_until(lambda: monitor.poll() is not None, 'the end of the monitor')
    output = monitor.communicate()[0]
    assert monitor.returncode in {1, 2}, output
    assert 'Traceback' not in output
    assert 'no node is known to subscribe to /nobody' in output
