"""A guarded rover that drives towards an obstacle: the delay until it is told to stop.

The rover of examples/rover drives with 0.5 m/s until its guard stops it, which happens 0.6 m
before the obstacle; then the obstacle is removed, and another one is put ahead of it.
"""

from __future__ import annotations

import random
import tempfile
import time
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from geometry_msgs.msg import Twist

from commands import command, running
from guarded_rover import LIMIT_M, GuardedDrive, write_guarded_robot
from system import Client

BARE_STOP = '/bare_stop'
"""The topic on which a bare node of rclpy says that a scan is too short."""

CLEAR_M = 3.0
CLOSEST_M = 0.3
"""The distance that the formula `distance` of the example demands."""


@dataclass
class Approaches:
    """The approaches of a rover.

    Args:
        delays: from the deciding scan to the safe message, in ms.
        bare_delays: from the same scan to the message of a bare node, in ms.
        closed_before: the number of further ones in which the guard had closed before the scan.
        closest: the least distance to an obstacle, in m.
    """

    delays: list[float] = field(default_factory=list)
    bare_delays: list[float] = field(default_factory=list)
    closed_before: int = 0
    closest: float = CLEAR_M


def approaches(environment: dict[str, str], count: int, *, composition: bool) -> Approaches:
    """Let a rover drive towards an obstacle a number of times.

    Raises:
        AssertionError: if a command that drives the rover was passed after the safe message, or the
            rover came too close.
    """
    found = Approaches()
    with tempfile.TemporaryDirectory() as folder:
        robot = write_guarded_robot(Path(folder))
        options = () if composition else ('--processes',)
        with (
            running(command('dyknow', 'up', str(robot), *options), environment),
            closing(Client(environment)) as client,
        ):
            drive, bare = GuardedDrive(client, CLEAR_M), list[float]()
            client.node.create_subscription(
                Twist, BARE_STOP, lambda _: bare.append(time.monotonic()), 10
            )
            while len(found.delays) < count:
                _approach(client, drive)
                found.closest = min(found.closest, drive.closest)
                if drive.was_closed_before:
                    found.closed_before += 1
                    continue
                found.delays.append(1e3 * drive.delay)
                stopped = next(at for at in bare if at > drive.decision)
                found.bare_delays.append(1e3 * (stopped - drive.decision))
    return found


def _approach(client: Client, drive: GuardedDrive) -> None:
    """Drive, and check that the rover was stopped."""
    drive.approach(CLEAR_M)
    client.spin_until(lambda: drive.rover.speed > 0.4, 'the rover drives')  # noqa: PLR2004
    drive.approach(LIMIT_M + random.uniform(0.2, 0.3))  # noqa: S311 - the phase of the scans
    client.spin_until(
        lambda: drive.has_stopped, 'the rover stops', instead=lambda: drive.rover.ahead
    )
    assert not drive.driving_after, f'passed after the safe message: {drive.driving_after}'
    assert drive.closest > CLOSEST_M, f'the rover came as close as {drive.closest} m'
