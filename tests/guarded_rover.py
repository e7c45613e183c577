"""The rover of the example behind a guard: it drives as it is commanded, towards an obstacle."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from geometry_msgs.msg import Twist

from fake_robots import FOLDER, simulate
from system import Client

LIMIT_M = 0.6
"""The distance at which the guard stops the rover."""

GUARD = f"""
guards:
  - name: base_guard
    input: /cmd_vel_in
    output: /cmd_vel
    type: geometry_msgs/msg/Twist
    timeout: 600 ms
    formulas:
      - 'forall r in Rover: Ahead[r] > {LIMIT_M} m'
"""
STEP_S = 0.02
PLANNED_SPEED = 0.5


def write_guarded_robot(folder: Path) -> Path:
    """Write the robot.yaml of the example with a guard, and return its path."""
    path = folder / 'robot.yaml'
    text = (FOLDER / 'rover' / 'robot.yaml').read_text(encoding='utf-8')
    path.write_text(text + GUARD, encoding='utf-8')
    return path


class CommandedRover(simulate.fake_robot('rover')):  # type: ignore[misc]
    """The fake rover, which follows commands: its brakes need 0.25 s for 0.5 m/s."""

    ACCELERATION = 2.0

    def __init__(self, ahead: float) -> None:
        super().__init__()
        self.ahead = ahead
        """The distance to the obstacle, in m."""
        self.command = 0.0

    @property
    def speed(self) -> float:
        """The present speed, in m/s."""
        return float(self._speed)

    def _drive(self) -> None:
        change = self.ACCELERATION * STEP_S
        self._speed += min(max(self.command - self._speed, -change), change)
        self._x += self._speed * STEP_S
        self.ahead -= self._speed * STEP_S

    def _scan(self) -> Any:
        scan = super()._scan()
        scan.ranges[45] = self.ahead
        return scan


class GuardedDrive:
    """The rover, and a planner that never sees the obstacle: it always commands 0.5 m/s.

    Args:
        client: of the system.
        ahead: the distance to the obstacle at the start, in m.
    """

    TIMEOUT_S = 0.5
    """The time without a command after which the base stops."""

    def __init__(self, client: Client, ahead: float) -> None:
        self.rover = CommandedRover(ahead)
        self.closest = ahead
        self.decided: float | None = None
        """The monotonic time of the publication of the first scan below the limit."""
        self.commands: list[tuple[float, float]] = []
        """The times and the speeds of what the base has received."""
        self._client = client
        node = client.node
        topics = {name: each for name, each in self.rover.TOPICS.items() if name != '/cmd_vel'}
        self._topics = {
            name: node.create_publisher(each, name, 10) for name, each in topics.items()
        }
        self._planner = node.create_publisher(Twist, '/cmd_vel_in', 10)
        node.create_subscription(Twist, '/cmd_vel', self._on_command, 100)
        node.create_timer(STEP_S, self._step)

    @property
    def has_stopped(self) -> bool:
        """True after the obstacle was seen, when the rover stands."""
        return self.decided is not None and self.rover.speed == 0.0

    @property
    def delay(self) -> float:
        """The time from the deciding scan to the first safe message after it, in s."""
        return self._reaction() - self.decision

    @property
    def was_closed_before(self) -> bool:
        """True if the guard was already closed when the deciding scan came, as it was late."""
        decided = self.decision
        return any(decided - 0.3 < at <= decided for at, speed in self.commands if not speed)

    @property
    def driving_after(self) -> list[float]:
        """The speeds of commands that were passed after the first safe message."""
        reaction = self._reaction()
        return [speed for at, speed in self.commands if at > reaction and speed]

    def approach(self, ahead: float) -> None:
        """Remove the obstacle, and put it at a distance ahead of the rover."""
        self.rover.ahead = self.closest = ahead
        self.decided = None
        self.commands.clear()

    @property
    def decision(self) -> float:
        """The monotonic time of the publication of the deciding scan."""
        assert self.decided is not None
        return self.decided

    def _reaction(self) -> float:
        return next(at for at, speed in self.commands if at > self.decision and not speed)

    def _on_command(self, message: Twist) -> None:
        self.rover.command = message.linear.x
        self.commands.append((time.monotonic(), message.linear.x))

    def _step(self) -> None:
        if not self.commands or time.monotonic() - self.commands[-1][0] > self.TIMEOUT_S:
            self.rover.command = 0.0
        command = Twist()
        command.linear.x = PLANNED_SPEED
        self._planner.publish(command)
        stamp = self._client.node.get_clock().now().to_msg()
        # The scan is the last one: nothing delays this process then when the guard answers it.
        for topic, message in sorted(self.rover.step(), key=lambda each: each[0]):
            if topic in self._topics:
                message.header.stamp = stamp
                if topic == '/scan' and self.decided is None and self.rover.ahead <= LIMIT_M:
                    self.decided = time.monotonic()
                self._topics[topic].publish(message)
        self.closest = min(self.closest, self.rover.ahead)
