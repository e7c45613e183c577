"""Cost of evaluations by all nodes of DyKnow, compared with a chain of bare rclpy nodes.

python benchmarks/coordinator.py [--json] [--quick]
    [--only grounding|verdict|composition|standby|deaths]
"""

from __future__ import annotations

import random
import statistics
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from functools import partial
from typing import Any

from dyknow_interfaces.msg import FormulaResult
from parts import measure
from processes import (
    Client,
    proportional_memory,
    ratios,
    summary,
    tell,
    use_private_domain,
    wait_until_begun,
    worker,
)
from running_system import AT_ONCE, RunningSystem, ask, timed
from workers import CHAIN, EVALUATE_SERVICE, all_in_one

import robots
from dyknow_common import SECOND_NS
from dyknow_common.ros import NodeAdapter, RemoteNode, time_to_nanoseconds

UNSTAMPED = 'always "/robot/level".data < 5'
STAMPED = 'always "/uav1/battery".current < 5'
LEVELS = {'unstamped': (robots.ROBOT, UNSTAMPED), 'stamped': ('uav1', STAMPED)}
"""The topics that make these formulas false."""

HIGH = 9.0
"""A level that makes these formulas false."""

EVER = 'always Power[uav1] < 5'
VICTIM = 'semantic_matching_engine'

chance = random.Random(1)  # noqa: S311


def grounding(*, quick: bool) -> Any:
    """Measure the time from a call to the verdict of the first state: three vehicles at 100 Hz."""
    number = 20 if quick else 100
    with RunningSystem(3, 100.0) as system:
        # An empty formula makes the client and the coordinator discover each other.
        refused = system.ask('')
        system.client.spin_until(refused.done, 'the refusal of an empty formula')
        delays = []
        for _ in range(number):
            begun = time.time_ns()
            future = system.ask(AT_ONCE)
            ended = timed(future)
            system.client.spin_until(lambda: bool(ended), 'the answer')  # noqa: B023
            answer = future.result()
            assert answer.verdict == FormulaResult.TRUE, answer
            decided = time_to_nanoseconds(answer.decided_at)
            assert decided > begun - SECOND_NS // 10, (decided - begun, answer)
            delays.append(ended[0] - begun)
            # Start evaluations at random times between two messages.
            system.client.wait(chance.uniform(0.05, 0.1))
    return {'first_us': round(delays[0] / 1e3), **summary(delays[1:])}


def verdict(*, quick: bool) -> Any:
    """Measure the time from a sample that makes a formula false to the answer.

    The nodes of DyKnow run in one process, then in a process each; so do bare nodes.
    """
    number = 10 if quick else 100
    rows: dict[str, Any] = {name: {} for name in LEVELS}
    for nodes, composition in (('one_process', True), ('processes', False)):
        for name, delays in _verdict_delays(number, composition=composition).items():
            rows[name][nodes] = summary(delays)
    for name, (topic, _) in LEVELS.items():
        for nodes, bare, roles in (
            ('processes', 'bare_processes', CHAIN),
            ('one_process', 'bare_one_process', (all_in_one,)),
        ):
            rows[name][bare] = summary(_bare_delays(topic, number, roles))
            for ratio, value in ratios(rows[name][nodes], rows[name][bare]).items():
                rows[name][f'{nodes}_{ratio}'] = value
    return rows


def _verdict_delays(number: int, *, composition: bool) -> dict[str, list[int]]:
    with RunningSystem(1, 20.0, progress_period=0.2, composition=composition) as system:
        found = {}
        for name, (topic, formula) in LEVELS.items():
            decide = partial(_decide, system.client, system.fleet, topic)
            found[name] = [decide(system.ask_running(formula)) for _ in range(number)]
        return found


def composition(*, quick: bool) -> Any:
    """Measure memory, idle processor time and the time from the start to the first verdict."""
    rows = []
    for name, is_composed in (('one_process', True), ('processes', False)):
        # Discovery makes some starts much slower than others.
        starts = [_start_to_first_verdict_s(is_composed) for _ in range(2 if quick else 10)]
        with RunningSystem(1, 20.0, composition=is_composed) as system:
            system.warm_up()
            idle = system.costs(5.0 if quick else 30.0)
            rows.append(
                {
                    'nodes': name,
                    'start_to_first_verdict_s': round(statistics.median(starts), 2),
                    'slowest_start_to_first_verdict_s': round(max(starts), 2),
                    'pss_mb': round(sum(map(proportional_memory, system.pids.values())), 1),
                    'idle_share': round(sum(each['share'] for each in idle.values()), 3),
                }
            )
    return rows


def _start_to_first_verdict_s(composition: bool) -> float:  # noqa: FBT001
    with RunningSystem(1, 20.0, composition=composition) as system:
        system.warm_up()
        return time.monotonic() - system.started_at


def _bare_delays(topic: str, number: int, roles: Iterable[Callable[..., None]]) -> list[int]:
    with ExitStack() as stack:
        for role in roles:
            wait_until_begun(stack.enter_context(worker(role.__name__)))
        fleet = stack.enter_context(robots.fleet(20.0, 'uav1'))
        client = stack.enter_context(Client())

        def asked() -> Any:
            future = ask(client, EVALUATE_SERVICE, 'any', 60.0)
            client.wait(0.2)
            return future

        found = asked()
        while not found.done():  # The nodes may not have discovered each other yet.
            tell(fleet, 'send', topic, HIGH)
            client.wait(0.2)
        return [_decide(client, fleet, topic, asked()) for _ in range(number)]


def _decide(client: Client, fleet: Any, topic: str, future: Any) -> int:
    """Publish the sample that decides a formula, and return the delay of its answer, ns."""
    ended = timed(future)
    client.wait(chance.uniform(0.0, 0.05))
    assert not future.done(), future.result()
    sent = int(tell(fleet, 'send', topic, HIGH))
    client.spin_until(lambda: bool(ended), 'the answer')
    answer = future.result()
    assert answer.verdict == FormulaResult.FALSE, answer
    decided = time_to_nanoseconds(answer.decided_at)
    assert sent <= decided <= ended[0], (sent, decided, answer)
    return ended[0] - sent


def standby(*, quick: bool) -> Any:
    """Measure the cost of a stand-in that is kept ready, at 100 states a second."""
    rows = []
    seconds, rounds = (5.0, 2) if quick else (20.0, 6)
    for name, composition in (('one_process', True), ('processes', False)):
        with RunningSystem(1, 100.0, 2, composition=composition) as system:
            system.warm_up()
            found: dict[str, list[tuple[float, float]]] = {}
            for _ in range(rounds):
                for formula in (EVER, 'always uav1_power.power < 5'):
                    answer = system.ask_running(formula, seconds + 10.0)
                    ready = 1 + (formula == EVER)
                    system.client.spin_until(
                        lambda: sum('states_' in each for each in system.streams()) == ready,  # noqa: B023
                        'the stand-in',
                        pause=0.1,
                    )
                    costs = system.costs(seconds).values()
                    share = sum(each['share'] for each in costs)
                    memory = sum(each['memory_mb'] for each in costs)
                    found.setdefault(formula, []).append((share, memory))
                    system.client.spin_until(answer.done, 'the end of the formula')
            (share, memory), (bare, bare_memory) = (
                map(statistics.median, zip(*each, strict=True)) for each in found.values()
            )
            rows.append(
                {
                    'nodes': name,
                    'us_per_state': round((share - bare) / 100.0 * 1e6),
                    'us_per_state_without': round(bare / 100.0 * 1e6),
                    'memory_mb': round(memory - bare_memory, 2),
                }
            )
    return rows


def deaths(*, quick: bool) -> Any:
    """Measure the time from the kill of a node until another one notices its death."""
    found = []
    with RunningSystem(1, 1.0) as system:
        remote = RemoteNode(NodeAdapter(system.client.node), VICTIM)
        for _ in range(3 if quick else 10):
            system.client.spin_until(lambda: remote.alive, 'the node')
            system.client.wait(1.0)
            begun = time.monotonic()
            system.launcher.kill(VICTIM)
            system.client.spin_until(lambda: not remote.alive, 'its death')
            found.append(round(time.monotonic() - begun, 2))
            system.start(VICTIM)
    return {
        'median_s': statistics.median(found),
        'least_s': min(found),
        'most_s': max(found),
        'count': len(found),
    }


if __name__ == '__main__':
    use_private_domain()
    measure(__doc__, grounding, verdict, composition, standby, deaths)
