"""Memory of the nodes while clients send long formulas and are killed: does it end growing?

python benchmarks/client_memory.py [--clients 1000] [--round 100] [--characters 990000] [--json]

A client asks for a verdict and sends a goal, both with a formula of that length, and is killed
before their answers. After each round, the script waits until no formula group or stream is left.
The exit code is 1 if a node has grown by more than MAX_GROWTH_MB in the second half of the rounds.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import signal
import time
from contextlib import suppress
from typing import Any

import rclpy
from dyknow_interfaces.action import MonitorFormula
from dyknow_interfaces.srv import EvaluateFormula
from parts import print_report
from processes import avoid_shared_memory, resident_memory, use_private_domain
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from running_system import COORDINATOR, EVALUATE, RunningSystem
from soak_coordinator import groups_of

from dyknow_common.ros import SERVICE, nanoseconds_to_duration

VEHICLES = 2
RATE = 10.0
MAX_GROWTH_MB = 30.0
ANSWER_S = 0.5
"""The time between the requests of a client and its death."""

LEASE_S = 21.0
"""The time after which the middleware forgets a killed participant."""

CLEANUP_S = 60.0
PARALLEL = 2
PADDING = '# a comment that makes the text of a formula long\n'


def kill_client(characters: int, number: int) -> None:
    """Send formulas of a length, and be killed before their answers."""
    rclpy.init()
    node = rclpy.create_node(f'killed_{os.getpid()}')
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    text = f'always Power[uav1] < {2000 + number}\n'
    text += PADDING * ((characters - len(text)) // len(PADDING))
    timeout = nanoseconds_to_duration(60 * 10**9)
    client = node.create_client(EvaluateFormula, EVALUATE, qos_profile=SERVICE)
    goals = ActionClient(node, MonitorFormula, f'{COORDINATOR}/monitor_formula')
    end = time.monotonic() + 10.0
    while not (client.service_is_ready() and goals.server_is_ready()) and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)
    client.call_async(EvaluateFormula.Request(formula=text, timeout=timeout))
    goals.send_goal_async(MonitorFormula.Goal(formula=text, timeout=timeout))
    end = time.monotonic() + ANSWER_S
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)
    os.kill(os.getpid(), signal.SIGKILL)


def _run_clients(system: RunningSystem, first: int, count: int, characters: int) -> None:
    """Run clients, some at a time."""
    context = multiprocessing.get_context('forkserver')
    running: list[Any] = []
    numbers = iter(range(first, first + count))
    left = count
    while left or running:
        running = [each for each in running if each.is_alive()]
        while left and len(running) < PARALLEL:
            running.append(context.Process(target=kill_client, args=(characters, next(numbers))))
            running[-1].start()
            left -= 1
        system.wait(0.05)


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Run all rounds; return the memory of each node in MB after each round."""
    memory: dict[str, list[float]] = {}
    with RunningSystem(VEHICLES, RATE) as system:
        system.warm_up()
        for first in range(0, arguments.clients, arguments.round):
            _run_clients(system, first, arguments.round, arguments.characters)
            system.wait(LEASE_S)
            with suppress(TimeoutError):
                system.client.spin_until(
                    lambda: system.has_fleet_streams_only() and not groups_of(system),
                    'nothing is left',
                    CLEANUP_S,
                )
            for name, pid in system.pids.items():
                memory.setdefault(name, []).append(round(resident_memory(pid), 1))
            print(json.dumps({name: found[-1] for name, found in memory.items()}), flush=True)
        left = sorted(system.streams()), groups_of(system)
        codes = system.stop()
    return {'memory_mb': memory, 'left': left, 'exit_codes': codes}


def main() -> None:
    """Run and print; the exit code is 1 if a node grows without end."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--clients', type=int, default=1000)
    parser.add_argument('--round', type=int, default=100, help='clients between two measurements')
    parser.add_argument('--characters', type=int, default=990_000, help='of each formula')
    parser.add_argument('--json', action='store_true', help='print one JSON object')
    arguments = parser.parse_args()
    use_private_domain()
    avoid_shared_memory()
    multiprocessing.get_context('forkserver').set_forkserver_preload(['__main__', 'client_memory'])
    found = measure(arguments)
    for name, sizes in found['memory_mb'].items():
        growth = sizes[-1] - sizes[len(sizes) // 2]
        found.setdefault('late_growth_mb', {})[name] = round(growth, 1)
    print_report(found, as_json=arguments.json)
    raise SystemExit(any(each > MAX_GROWTH_MB for each in found['late_growth_mb'].values()))


if __name__ == '__main__':
    main()
