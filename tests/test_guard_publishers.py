"""Guards of messages alone, without a running DyKnow: their publishers, and guards in a row."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from dyknow_interfaces.msg import GuardStatus
from geometry_msgs.msg import Twist
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2

from commands import command, running
from dyknow_common.ros import LATCHED_HISTORY
from system import Client, private_environment
from typed_publisher import publishing

TWIST = 'geometry_msgs/msg/Twist'
POSE = 'geometry_msgs/msg/Pose'
CLOUD = 'sensor_msgs/msg/PointCloud2'
SLOW = {'linear': {'x': 0.2}}
MEGABYTES = 1_000_000


class MessageGuards:
    """Guards as processes, their reports, and what comes out of the last one.

    Args:
        environment: of the processes.
        folder: for the robot.yaml.
        guards: the text of the guards.
        output: the topic of the last one, and its class.
    """

    def __init__(
        self, environment: dict[str, str], folder: Path, guards: str, output: tuple[str, Any]
    ) -> None:
        self.environment = environment
        self.client = Client(environment)
        self.received: list[Any] = []
        self.statuses: dict[str, Any] = {}
        self.path = folder / 'robot.yaml'
        self.path.write_text(guards, encoding='utf-8')
        topic, class_ = output
        profile = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
        self.client.node.create_subscription(class_, topic, self.received.append, profile)

    def start(self, name: str) -> Any:
        """Return a context in which a guard runs."""
        self.client.node.create_subscription(
            GuardStatus,
            f'/{name}/status',
            lambda status: self.statuses.update({name: status}),
            LATCHED_HISTORY,
        )
        return running(command('dyknow', 'guard', str(self.path), name), self.environment)

    def publishing(self, *arguments: Any, **options: Any) -> Any:
        """Return a context in which a publisher runs."""
        return publishing(self.environment, *arguments, **options)

    def wait_for_output(self, speed: float) -> None:
        """Wait for a message of a speed, from now on."""
        begin = len(self.received)
        self.client.spin_until(
            lambda: any(each.linear.x == speed for each in self.received[begin:]),
            f'a message of {speed} m/s',
            instead=lambda: (self.received[-3:], self.statuses),
        )

    def wait_for(self, name: str, state: int, reason: str = '') -> None:
        """Wait until a guard reports a state, with a reason that has some words."""
        self.client.spin_until(
            lambda: (
                name in self.statuses
                and self.statuses[name].state == state
                and reason in self.statuses[name].reason
            ),
            f'{name} is {state} because of {reason}',
            instead=lambda: self.statuses,
        )


def guard_text(name: str, topics: str, formula: str, *lines: str) -> str:
    """Return a guard in YAML, given `input -> output`."""
    source, _, output = topics.partition(' -> ')
    keys = (f'input: {source}', f'output: {output}', f"formulas: '{formula}'", *lines)
    return '\n    '.join((f'  - name: {name}', *keys)) + '\n'


@contextmanager
def guards(
    folder: Path, *texts: str, output: tuple[str, Any] = ('/cmd_vel', Twist)
) -> Iterator[MessageGuards]:
    """Running guards."""
    text = 'guards:\n' + ''.join(texts)
    found = MessageGuards(private_environment(), folder, text, output)
    names = [each.partition('name: ')[2].partition('\n')[0] for each in texts]
    with ExitStack() as stack:
        stack.callback(found.client.close)
        for name in names:
            stack.enter_context(found.start(name))
        yield found


BELOW = guard_text('base_guard', '/cmd_vel_in -> /cmd_vel', '"/cmd_vel_in".linear.x < 0.5')
TYPED = guard_text(
    'base_guard', '/cmd_vel_in -> /cmd_vel', '"/cmd_vel_in".linear.x < 0.5', f'type: {TWIST}'
)


def test_guards_in_a_row(tmp_path: Path) -> None:
    """The second one has its type from the first one, and guards also its safe messages."""
    second = guard_text('second', '/between -> /cmd_vel', '"/between".linear.x < 0.3')
    first = guard_text(
        'first',
        '/cmd_vel_in -> /between',
        '"/cmd_vel_in".linear.x < 0.5',
        f'type: {TWIST}',
        'safe: {linear: {x: 0.1}}',
    )
    with guards(tmp_path, second, first) as row:
        for speed, passed in ((0.2, 0.2), (0.4, 0.0), (0.7, 0.1)):
            with row.publishing('/cmd_vel_in', TWIST, {'linear': {'x': speed}}):
                row.wait_for_output(passed)
        assert {each.linear.x for each in row.received} == {0.2, 0.0, 0.1}
        assert {each.state for each in row.statuses.values()} == {GuardStatus.OPEN}


def test_publishers_that_change(tmp_path: Path) -> None:
    with guards(tmp_path, BELOW) as base:
        for number, reliable in enumerate((False, True, False)):
            speed = 0.1 + 0.1 * number
            values = {'linear': {'x': speed}}
            with base.publishing('/cmd_vel_in', TWIST, values, reliable=reliable) as process:
                base.wait_for_output(speed)
                if number == 1:
                    process.kill()
        assert base.statuses['base_guard'].refused == 0


@pytest.mark.parametrize('text', [BELOW, TYPED], ids=['type of the publisher', 'type stated'])
def test_a_publisher_of_a_wrong_type_that_leaves(tmp_path: Path, text: str) -> None:
    with guards(tmp_path, text) as base:
        with base.publishing('/cmd_vel_in', POSE):
            base.wait_for('base_guard', GuardStatus.CLOSED, 'geometry_msgs/msg/Pose')
        if text is TYPED:
            base.wait_for('base_guard', GuardStatus.OPEN)
        else:
            base.wait_for('base_guard', GuardStatus.CLOSED, 'nobody publishes /cmd_vel_in')
        with base.publishing('/cmd_vel_in', TWIST, SLOW):
            base.wait_for_output(0.2)
            with base.publishing('/cmd_vel_in', POSE):
                base.wait_for('base_guard', GuardStatus.CLOSED, 'several types')
            base.wait_for('base_guard', GuardStatus.OPEN)
            base.wait_for_output(0.2)


def test_large_messages(tmp_path: Path) -> None:
    text = guard_text('eyes', '/cloud_in -> /cloud', '"/cloud_in".width < 10', f'type: {CLOUD}')
    with guards(tmp_path, text, output=('/cloud', PointCloud2)) as eyes:
        with eyes.publishing('/cloud_in', CLOUD, {'width': 5}, period=0.01, size=2 * MEGABYTES):
            eyes.client.spin_until(
                lambda: sum(len(each.data) for each in eyes.received) > 20 * MEGABYTES,
                'large messages',
                instead=lambda: eyes.statuses,
            )
        assert {len(each.data) for each in eyes.received} == {2 * MEGABYTES}
