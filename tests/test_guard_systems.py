"""Guards of other systems: of nodes in one process, by simulated time, and of a simulated rover."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from dyknow_interfaces.msg import GuardStatus
from geometry_msgs.msg import Twist
from sensor_msgs.msg import LaserScan

from commands import command, running
from dyknow_bringup.processes.composition import NODES
from guards import guarded_base
from system import Client, System, private_environment
from test_sim_time_jumps import Simulation

POWER = "['Power[uav1] < 150']"
TIMEOUT_S = 0.6


@pytest.fixture(scope='module')
def one_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    with System(tmp_path_factory.mktemp('system'), composition=True) as running:
        yield running


@pytest.mark.parametrize('end', ['false', 'SIGSTOP', 'SIGKILL'])
def test_the_end_of_the_process_of_all_nodes(one_process: System, tmp_path: Path, end: str) -> None:
    system = one_process
    system.batteries.reset()
    with guarded_base(system, tmp_path, POWER) as base:
        base.wait_until_open()
        event = time.monotonic()
        if end == 'false':
            system.batteries.power['uav1'] = 200.0
            base.assert_safe_after(event, TIMEOUT_S)
        else:
            with system.stopped(NODES) if end == 'SIGSTOP' else system.killed(NODES):
                base.assert_safe_after(event, TIMEOUT_S)
                base.wait_for(GuardStatus.CLOSED)
            system.client.wait_for_coordinator()
            system.client.spin_until(
                lambda: system.streams() >= system.fleet_streams, 'the streams', pause=0.1
            )
        system.batteries.reset()
        base.wait_until_open()


def test_a_clock_that_jumps(tmp_path_factory: pytest.TempPathFactory, tmp_path: Path) -> None:
    with System(tmp_path_factory.mktemp('system'), use_sim_time=True) as system:
        simulation = Simulation(system)
        with guarded_base(system, tmp_path, POWER) as base:
            base.wait_until_open()
            for jump in (60_000_000_000, -60_000_000_000):
                known = len(base.statuses)
                simulation.now += jump
                base.client.spin_until(
                    lambda: any(
                        each.state == GuardStatus.CLOSED
                        for each in base.statuses[known:]  # noqa: B023
                    ),
                    'the guard is closed',
                )
                reasons = {each.reason for each in base.statuses[known:]}
                assert reasons - {''}, reasons
                base.wait_until_open()
            known = len(base.statuses)
            simulation.speed = 0
            base.assert_safe_after(time.monotonic(), TIMEOUT_S)
            base.wait_for(GuardStatus.CLOSED, 'the latest state')
            simulation.speed = 1
            base.wait_until_open()


GUARD = """
guards:
  - name: base_guard
    input: /cmd_vel_in
    output: /cmd_vel
    type: geometry_msgs/msg/Twist
    timeout: 600 ms
    formulas:
      - 'forall r in Rover: Ahead[r] > 1.2 m'
"""


class DrivingRover:
    """The rover of the example, which drives as it is commanded towards an obstacle at 4 m.

    Its planner always commands 0.5 m/s; its base stops without a command within 0.5 s.
    """

    OBSTACLE_M = 4.0
    STEP_S = 0.05

    def __init__(self, client: Client) -> None:
        self.x = self.speed = 0.0
        self._commanded_at = 0.0
        self._client = client
        node = client.node
        self._scans = node.create_publisher(LaserScan, '/scan', 10)
        self._planner = node.create_publisher(Twist, '/cmd_vel_in', 10)
        node.create_subscription(Twist, '/cmd_vel', self._on_command, 10)
        node.create_timer(self.STEP_S, self._step)

    @property
    def ahead(self) -> float:
        """The distance to the obstacle."""
        return self.OBSTACLE_M - self.x

    def _on_command(self, message: Twist) -> None:
        self.speed, self._commanded_at = message.linear.x, time.monotonic()

    def _step(self) -> None:
        if time.monotonic() - self._commanded_at > 0.5:
            self.speed = 0.0
        self.x += self.speed * self.STEP_S
        ranges = [4.0] * 90
        ranges[45] = self.ahead
        scan = LaserScan(range_max=12.0, ranges=ranges)
        scan.header.stamp = self._client.node.get_clock().now().to_msg()
        self._scans.publish(scan)
        command = Twist()
        command.linear.x = 0.5
        self._planner.publish(command)


def test_a_rover_stops_before_an_obstacle(tmp_path: Path) -> None:
    """With `dyknow up`, which starts the guard of the file."""
    rover_yaml = Path(__file__).parents[1] / 'examples' / 'rover' / 'robot.yaml'
    path = tmp_path / 'robot.yaml'
    path.write_text(rover_yaml.read_text(encoding='utf-8') + GUARD, encoding='utf-8')
    environment = private_environment()
    with (
        running(command('dyknow', 'up', str(path)), environment),
        closing(Client(environment)) as client,
    ):
        rover = DrivingRover(client)
        client.spin_until(lambda: rover.x > 1.0, 'it drives', instead=lambda: rover.x)
        client.spin_until(lambda: rover.ahead < 1.2, 'it is near', instead=lambda: rover.x)
        client.spin_until(lambda: rover.speed == 0.0, 'it stops', instead=lambda: rover.x)
        stopped_at = rover.x
        end = time.monotonic() + 2.0
        client.spin_until(lambda: time.monotonic() > end, 'it stays')
    assert rover.x < stopped_at + 0.1
    assert rover.ahead > 0.2
