"""A running guard of cmd_vel, whose commands a test publishes."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import dropwhile, pairwise
from math import inf
from pathlib import Path
from typing import Any

from dyknow_interfaces.msg import GuardStatus
from geometry_msgs.msg import Twist
from std_srvs.srv import Trigger

from dyknow_bringup.processes.processes import Process
from dyknow_common.ros import LATCHED_HISTORY, time_to_nanoseconds
from system import Client, System

TIMEOUT = '600 ms'
"""Twice the default: states come each 200 ms, on a busy computer."""

PERIOD_S = 0.02
SLACK_S = 1.0
"""By how much signs of life may be late on a busy computer."""


class GuardedBase:
    """A guard, the commands that it receives, and what the base of the robot receives.

    Args:
        system: DyKnow.
        folder: for the robot.yaml.
        formulas: of the guard, in YAML.
        options: further keys of the guard, in YAML.
        timeout: of the guard.
    """

    def __init__(
        self, system: System, folder: Path, formulas: str, options: str = '', timeout: str = TIMEOUT
    ) -> None:
        self.client: Client = system.client
        self.speed = 0.4
        self.is_commanding = True
        self.received: list[tuple[float, Any]] = []
        self.statuses: list[Any] = []
        self._system = system
        path = folder / 'robot.yaml'
        path.write_text(
            'guards:\n  - name: base_guard\n    input: /cmd_vel_in\n    output: /cmd_vel\n'
            f'    type: geometry_msgs/msg/Twist\n    timeout: {timeout}\n    formulas: {formulas}\n'
            f'{options}',
            encoding='utf-8',
        )
        node = self.client.node
        self._commands = node.create_publisher(Twist, '/cmd_vel_in', 10)
        self._listeners = [
            node.create_subscription(Twist, '/cmd_vel', self._on_output, 100),
            node.create_subscription(
                GuardStatus, '/base_guard/status', self.statuses.append, LATCHED_HISTORY
            ),
        ]
        self._timer = node.create_timer(PERIOD_S, self._command)
        self.process = system.launcher.start(
            Process(
                'dyknow_reactions', 'guard', {'robot': str(path), 'guard': ''}, node='base_guard'
            )
        )

    def close(self) -> None:
        """End the guard."""
        self.process.send_signal(signal.SIGCONT)
        self._system.launcher.kill('base_guard')
        node = self.client.node
        node.destroy_timer(self._timer)
        node.destroy_publisher(self._commands)
        for each in self._listeners:
            node.destroy_subscription(each)

    @property
    def state(self) -> int | None:
        """The latest one that the guard has published."""
        return self.statuses[-1].state if self.statuses else None

    @property
    def reason(self) -> str:
        """Why it is closed."""
        return self.statuses[-1].reason if self.statuses else ''

    def reasons(self, begin: int = 0) -> list[str]:
        """Why it was closed, in the reports from one on."""
        return [each.reason for each in self.statuses[begin:] if each.reason]

    def wait_for(self, state: int, reason: str = '') -> None:
        """Waits until the guard reports a state, with a reason that has some words."""
        self.client.spin_until(
            lambda: self.state == state and reason in self.reason,
            f'the guard is {state} because of {reason}',
            instead=lambda: (self.state, self.reason),
        )

    def wait_until_open(self) -> None:
        """Waits until commands pass."""
        self.wait_for(GuardStatus.OPEN)
        self.wait_for_message(lambda message: message.linear.x == self.speed, 'a command')

    def wait_for_message(self, condition: Any, what: str) -> None:
        """Waits until a message of the output satisfies a condition, from now on."""
        begin = len(self.received)
        self.client.spin_until(
            lambda: any(condition(message) for _, message in self.received[begin:]),
            what,
            instead=lambda: (self.state, self.reason),
        )

    def assert_safe_after(self, event: float, limit: float, *, reopens: bool = False) -> None:
        """Wait for the safe message; no command passes that was sent after a limit.

        Args:
            event: the time of what must close the guard.
            limit: seconds until the guard must be closed.
            reopens: whether the guard may open again by itself, at any time after it has closed.
        """
        self.wait_for_message(is_zero, 'the safe message')
        end = time.time() + 0.5
        self.client.spin_until(lambda: time.time() > end, 'more commands')
        opened = self._opened_after(event) if reopens else inf
        late = [sent - event for sent in self._passed() if event + limit + SLACK_S < sent < opened]
        assert not late, f'commands have passed that were sent {late} s after the event'
        self.assert_nothing_passed_while_closed()

    def _opened_after(self, event: float) -> float:
        """Return when the guard opened after it has closed after an event; inf if it did not."""
        after = [each for each in self.statuses if seconds(each.header.stamp) >= event]
        closed = dropwhile(lambda each: each.state == GuardStatus.OPEN, after)
        opened = (each for each in closed if each.state == GuardStatus.OPEN)
        return next((seconds(each.header.stamp) for each in opened), inf)

    def assert_nothing_passed_while_closed(self) -> None:
        """The guard has passed nothing from each report that it is closed to the next report."""
        for status, following in pairwise(self.statuses):
            is_closed = status.state != GuardStatus.OPEN
            assert following.passed == status.passed or not is_closed, (status, following)
        commands = len([each for _, each in self.received if not is_zero(each)])
        self.client.spin_until(lambda: self.statuses[-1].passed >= commands, 'a report')

    def _passed(self) -> list[float]:
        """Return the times at which the commands that have passed were sent."""
        return [message.linear.y for _, message in self.received if message.linear.y]

    def reset(self) -> Any:
        """Call the service that releases the latch."""
        return self.client.call(Trigger, '/base_guard/reset')

    def _command(self) -> None:
        if self.is_commanding:
            message = Twist()
            message.linear.x, message.linear.y = self.speed, time.time()
            self._commands.publish(message)

    def _on_output(self, message: Any) -> None:
        self.received.append((time.monotonic(), message))


def seconds(stamp: Any) -> float:
    """Return a Time as seconds."""
    return time_to_nanoseconds(stamp) / 1e9


def is_zero(message: Any) -> bool:
    """Return True for the default safe message."""
    return bool(message == Twist())


@contextmanager
def guarded_base(
    system: System, folder: Path, formulas: str, options: str = '', timeout: str = TIMEOUT
) -> Iterator[GuardedBase]:
    """A running guard."""
    base = GuardedBase(system, folder, formulas, options, timeout)
    try:
        yield base
    finally:
        base.close()
