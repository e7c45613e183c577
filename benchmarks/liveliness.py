"""Time to notice dead nodes, healthy nodes that look dead, and the cost of heartbeats.

python benchmarks/liveliness.py [--json] [--quick] [--only deaths|load|idle]
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from contextlib import ExitStack
from typing import Any

from parts import measure
from processes import use_private_domain
from running_system import RunningSystem

from dyknow_common.ros import NodeAdapter, RemoteNode

VICTIM = 'semantic_matching_engine'
BUSY_PROCESSES = 20


def deaths(*, quick: bool) -> Any:
    """Measure the time from the kill of a node (SIGKILL) until another one notices its death."""
    found = []
    with RunningSystem(1, 1.0) as system:
        remote = RemoteNode(NodeAdapter(system.client.node), VICTIM)
        for _ in range(3 if quick else 10):
            system.client.spin_until(lambda: remote.alive, 'the node')
            system.wait(1.0)
            begun = time.monotonic()
            system.kill(VICTIM)
            system.client.spin_until(lambda: not remote.alive, 'its death')
            found.append(round(time.monotonic() - begun, 2))
            system.start(VICTIM)
    return {
        'median_s': statistics.median(found),
        'least_s': min(found),
        'most_s': max(found),
        'count': len(found),
    }


def load(*, quick: bool) -> Any:
    """Count the healthy nodes that look dead, beside processes that keep all cores busy."""
    seconds = 20.0 if quick else 180.0
    losses: list[str] = []
    with RunningSystem(3, 10.0) as system, ExitStack() as stack:
        adapter = NodeAdapter(system.client.node)
        remotes = [RemoteNode(adapter, name) for name in system.pids]
        system.client.spin_until(lambda: all(each.alive for each in remotes), 'all nodes')
        for remote in remotes:
            remote.on_lost.append(lambda name=remote.name: losses.append(name))
        for _ in range(BUSY_PROCESSES):
            busy = subprocess.Popen([sys.executable, '-c', 'while True: pass'])
            stack.callback(busy.kill)
        system.wait(seconds)
    return {
        'nodes': len(remotes),
        'seconds': seconds,
        'busy_processes': BUSY_PROCESSES,
        'dead_by_mistake': losses,
    }


def idle(*, quick: bool) -> Any:
    """Measure the share of a core of each node, while a fleet of one vehicle publishes at 1 Hz."""
    with RunningSystem(1, 1.0) as system:
        system.wait(5.0)
        costs = system.costs(10.0 if quick else 40.0)
    shares = {name: cost['share'] for name, cost in costs.items()}
    return {'all': round(sum(shares.values()), 3), **shares}


if __name__ == '__main__':
    use_private_domain()
    measure(__doc__, deaths, load, idle)
