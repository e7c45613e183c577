"""Each way in which a guard closes, with the times until it has closed and until it opens again.

The first is the time from the event to the first safe message, the second that from the repair,
such as the start of a node that was killed, to the first message that passes again. The guard has
the timeout of 0.3 s that it has by default. The topic of its formula comes 5 times a second, as in
the system tests.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

from processes import ENGINE

from dyknow_bringup.processes.composition import NODES
from dyknow_reactions.ros.guard.guard import WATCHED
from guards import GuardedBase, guarded_base, is_zero
from system import System
from test_sim_time_jumps import Simulation

TIMEOUT_MS: Final = 300
FORMULA = "['Power[uav1] < 150']"
SETTLING_S = 0.6
LATE_NS = 20_000_000
MINUTE_NS = 60_000_000_000


class Closing(NamedTuple):
    """The times of a closing, in ms.

    Args:
        way: the event that has closed the guard.
        closed: from the event to the first safe message.
        reopened: from the repair to the first message that passes again; 0 if it passed before.
    """

    way: str
    closed: float
    reopened: float


Event = Callable[[], AbstractContextManager[None]]
"""Makes the event; its end repairs the system."""


def closings(rounds: int, *, composition: bool) -> Iterator[Closing]:
    """Yield the times of each way of closing; each round has all ways.

    Raises:
        AssertionError: if a command has passed while the guard was closed.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if not composition:
            with System(folder, use_sim_time=True) as system:
                yield from _closings(system, folder, rounds, _jumps(Simulation(system)))
        with System(folder, composition=composition) as system:
            system.batteries.reset()
            ways = _ways(system, composition=composition)
            yield from _closings(system, folder, rounds, ways)


def _closings(
    system: System, folder: Path, rounds: int, ways: Mapping[str, Event]
) -> Iterator[Closing]:
    with guarded_base(system, folder, FORMULA, timeout=f'{TIMEOUT_MS} ms') as base:
        _wait_until_settled(base, 'its start')
        for _ in range(rounds):
            for way, event in ways.items():
                yield _times_of(base, way, event)


def _jumps(simulation: Simulation) -> dict[str, Event]:
    """Return jumps of simulated time."""

    @contextmanager
    def jump(step: int) -> Iterator[None]:
        simulation.jump(step)
        yield

    return {
        'jump forwards': partial(jump, MINUTE_NS),
        'jump backwards': partial(jump, -MINUTE_NS),
    }


def _ways(system: System, *, composition: bool) -> dict[str, Event]:
    """Return changes of the batteries, and the ends of nodes."""
    batteries = system.batteries

    @contextmanager
    def changed(change: Callable[[], object]) -> Iterator[None]:
        change()
        yield
        batteries.reset()

    def falsify() -> None:
        # The deciding sample comes at once, rather than after the rest of the period.
        batteries.silent |= set(system.vehicles)
        stamp = batteries.stamp + batteries.PERIOD
        for each in system.vehicles:
            batteries.publish(each, stamp, 200.0)

    def violate() -> None:
        batteries.publish('uav1', batteries.stamp + LATE_NS)

    ways: dict[str, Event] = {
        'false': partial(changed, falsify),
        'violation': partial(changed, violate),
        'silence': partial(changed, lambda: batteries.silent.add('uav1')),
    }
    for node in (NODES,) if composition else (*WATCHED, ENGINE):
        for way, event in ('SIGSTOP', system.stopped), ('SIGKILL', system.killed):
            ways[f'{way} {node}'] = partial(_ended, system, event, node)
    return ways


@contextmanager
def _ended(system: System, event: Any, node: str) -> Iterator[None]:
    with event(node):
        yield
    system.client.wait_for_coordinator()
    system.client.spin_until(lambda: system.streams() >= system.fleet_streams, 'streams', pause=0.1)
    system.batteries.reset()


def _times_of(base: GuardedBase, way: str, event: Event) -> Closing:
    """Wait for an event, and for its repair, and return their times."""
    begin = time.monotonic()
    with event():
        base.client.spin_until(lambda: bool(_safe_since(base, begin)), f'closed by {way}')
        first = _safe_since(base, begin)[0]
        base.client.wait(SETTLING_S / 2)
        repair = time.monotonic()
    base.assert_nothing_passed_while_closed()
    _wait_until_settled(base, way)
    closed = _safe_since(base, begin)[-1]
    passed = next(at for at, each in base.received if at > closed and not is_zero(each))
    return Closing(way, 1e3 * (first - begin), 1e3 * max(passed - repair, 0.0))


def _wait_until_settled(base: GuardedBase, way: str) -> None:
    """Wait until the guard has been open for a while."""

    def is_open() -> bool:
        now = time.monotonic()
        return len(base.received) > 0 and not _safe_since(base, now - SETTLING_S)

    base.client.spin_until(
        is_open, f'the guard stays open after {way}', 60.0, lambda: (base.state, base.reason)
    )


def _safe_since(base: GuardedBase, begin: float) -> list[float]:
    return [at for at, message in base.received if at > begin and is_zero(message)]
