"""Time to notice dead nodes, and the cost of heartbeats.

python benchmarks/liveliness.py [--json] [--quick] [--only deaths|idle]
"""

from __future__ import annotations

import statistics
import time
from typing import Any

from parts import measure
from processes import use_private_domain
from running_system import RunningSystem

from dyknow_common.ros import NodeAdapter, RemoteNode

VICTIM = 'semantic_matching_engine'


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


def idle(*, quick: bool) -> Any:
    """Measure the share of a core of each node, while a fleet of one vehicle publishes at 1 Hz."""
    with RunningSystem(1, 1.0) as system:
        system.wait(5.0)
        costs = system.costs(10.0 if quick else 40.0)
    shares = {name: cost['share'] for name, cost in costs.items()}
    return {'all': round(sum(shares.values()), 3), **shares}


if __name__ == '__main__':
    use_private_domain()
    measure(__doc__, deaths, idle)
