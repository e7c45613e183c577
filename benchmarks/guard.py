"""Delays of a guard: of a message that passes, and from an event to the safe message.

python benchmarks/guard.py [--json] [--quick] [--only passing|rover|closing]

- passing: a message that passes is compared with one that a bare rclpy node relays, serialised as
  it is; both are sent alternately in the same run, so a busy computer delays both.
- rover: the time from a deciding sample to the safe message in a closed loop. The rover of
  examples/rover drives with 0.5 m/s until its guard stops it, which happens 0.6 m before an
  obstacle; then the obstacle is removed, and another one is put ahead of it. A bare rclpy node
  answers the same scan.
- closing: the time from each event that closes a guard, such as the end of a node, and from its
  repair, such as the start of the node, until messages pass again.

Each is measured with all nodes in one process, and with a process each.
"""

from __future__ import annotations

import random
import statistics
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dyknow_interfaces.msg import GuardStatus
from geometry_msgs.msg import Twist
from guard_closings import Closing, closings
from parts import measure
from processes import (
    Client,
    percentile,
    use_private_domain_without_shared_memory,
    wait_until_begun,
    worker,
)
from std_msgs.msg import Float64
from workers import STOP_DISTANCE_M

from commands import command, running
from dyknow_common.ros import LATCHED
from guarded_rover import GuardedDrive, write_guarded_robot

ROBOT = """\
guards:
  - name: base_guard
    input: /cmd_vel_in
    output: /cmd_vel
    type: geometry_msgs/msg/Twist
    formulas: '"/level".data < 5'
    period: 1 min
    timeout: 2 s
"""
PERIOD_S = 0.02
LEVEL = 1.0
COMPOSITIONS: dict[str, tuple[str, ...]] = {'processes': ('--processes',), 'one_process': ()}
CLEAR_M = 3.0
CLOSEST_M = 0.3
"""The distance that the formula `distance` of the example demands."""


@contextmanager
def running_guard(write: Callable[[Path], Path], options: Sequence[str]) -> Iterator[Client]:
    """Run DyKnow with a guard, and the bare node; yield a client.

    Args:
        write: writes the robot.yaml to a folder.
        options: of `dyknow up`.
    """
    with tempfile.TemporaryDirectory() as folder, worker('raw_relay') as bare, Client() as client:
        wait_until_begun(bare)
        with running(command('dyknow', 'up', str(write(Path(folder))), *options), {}):
            yield client


def summary(milliseconds: Sequence[float]) -> dict[str, float]:
    """Return the median and the 99th percentile."""
    return {
        'median_ms': round(statistics.median(milliseconds), 3),
        'p99_ms': round(percentile(milliseconds, 99), 3),
    }


def passing(*, quick: bool) -> dict[str, Any]:
    """Measure messages that pass a guard, and those that pass the bare relay."""
    found = {}
    for name, options in COMPOSITIONS.items():
        with running_guard(_write_robot, options) as client:
            guard, bare = map(summary, _delays(client, 100 if quick else 1000))
        ratio = round(guard['median_ms'] / bare['median_ms'], 2)
        found[name] = {'passing': guard, 'bare_relay': bare, 'ratio': ratio}
    return found


def _write_robot(folder: Path) -> Path:
    path = folder / 'robot.yaml'
    path.write_text(ROBOT, encoding='utf-8')
    return path


def _delays(client: Client, messages: int) -> list[list[float]]:
    """Return the delays of messages in ms, those of the guard and those of the bare relay."""
    node, states = client.node, client.collect(GuardStatus, '/base_guard/status', LATCHED)
    ways = [
        (node.create_publisher(Twist, into, 10), client.collect(Twist, out))
        for into, out in (('/cmd_vel_in', '/cmd_vel'), ('/bare_in', '/bare_out'))
    ]
    level = node.create_publisher(Float64, '/level', 10)
    node.create_timer(PERIOD_S, lambda: level.publish(Float64(data=LEVEL)))

    def have_both_passed() -> bool:
        for publisher, _ in ways:
            publisher.publish(Twist())
        client.wait(0.05)
        is_open = bool(states) and states[-1].state == GuardStatus.OPEN
        return is_open and all(received for _, received in ways)

    client.spin_until(have_both_passed, 'the guard is open, and both relays are connected')
    client.wait(0.5)
    delays: list[list[float]] = [[], []]
    for _ in range(messages):
        for (publisher, received), found in zip(ways, delays, strict=True):
            received.clear()
            begun = time.monotonic()
            publisher.publish(Twist())
            client.spin_until(lambda: bool(received), 'a message', 5.0)  # noqa: B023
            found.append(1e3 * (time.monotonic() - begun))
            client.wait(0.002)
    return delays


def rover(*, quick: bool) -> dict[str, Any]:
    """Measure approaches of a rover to obstacles."""
    found = {}
    for name, options in COMPOSITIONS.items():
        with running_guard(write_guarded_robot, options) as client:
            found[name] = _approaches(client, 5 if quick else 100)
    return found


def _approaches(client: Client, count: int) -> dict[str, Any]:
    """Let the rover drive towards obstacles.

    Raises:
        AssertionError: if a command that drives the rover was passed after the safe message, or the
            rover came too close.
    """
    drive, bare = GuardedDrive(client, CLEAR_M), list[float]()
    client.node.create_subscription(
        Twist, '/bare_stop', lambda _: bare.append(time.monotonic()), 10
    )
    delays: list[float] = []
    bare_delays: list[float] = []
    closed_before, closest = 0, CLEAR_M
    while len(delays) < count:
        drive.approach(CLEAR_M)
        client.spin_until(lambda: drive.rover.speed > 0.4, 'the rover drives')  # noqa: PLR2004
        # The phase of the scans is random.
        drive.approach(STOP_DISTANCE_M + random.uniform(0.2, 0.3))  # noqa: S311
        client.spin_until(lambda: drive.has_stopped, f'the rover stops {drive.rover.ahead}')
        assert not drive.driving_after, f'passed after the safe message: {drive.driving_after}'
        assert drive.closest > CLOSEST_M, f'the rover came as close as {drive.closest} m'
        closest = min(closest, drive.closest)
        if drive.was_closed_before:
            closed_before += 1
            continue
        delays.append(1e3 * drive.delay)
        stopped = next(at for at in bare if at > drive.decision)
        bare_delays.append(1e3 * (stopped - drive.decision))
    return {
        'guard': summary(delays),
        'bare_node': summary(bare_delays),
        'approaches_with_the_guard_closed_before': closed_before,
        'closest_m': closest,
    }


def closing(*, quick: bool) -> dict[str, Any]:
    """Measure each way of closing."""
    return {
        name: _closing(2 if quick else 20, composition=not options)
        for name, options in COMPOSITIONS.items()
    }


def _closing(rounds: int, *, composition: bool) -> dict[str, Any]:
    times: defaultdict[str, list[Closing]] = defaultdict(list)
    for each in closings(rounds, composition=composition):
        times[each.way].append(each)
    return {
        way: {
            **summary([each.closed for each in found]),
            'max_ms': round(max(each.closed for each in found), 3),
            'reopened_median_ms': round(statistics.median(each.reopened for each in found)),
            'reopened_max_ms': round(max(each.reopened for each in found)),
            'rounds': len(found),
        }
        for way, found in times.items()
    }


if __name__ == '__main__':
    use_private_domain_without_shared_memory()
    measure(__doc__, passing, rover, closing)
