"""Correctness of all answers under load, while nodes and topics fail at random.

python benchmarks/soak_coordinator.py [--minutes 20] [--seed 1] [--steady] [--logs FOLDER] [--json]
"""

from __future__ import annotations

import argparse
import random
import re
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import random_requests
from dyknow_interfaces.msg import EvaluationStatus, EvaluationStatusArray
from dyknow_interfaces.srv import FormulaGroupDestroy
from faults import NODES, Faults
from lives import Lives
from parts import end, print_report
from processes import summary, use_private_domain, wait_for_line, worker
from random_requests import RandomRequests
from running_system import COORDINATOR, REASONER, RunningSystem

from dyknow_common.ros import LATCHED

VEHICLES = 3
RATE = 20.0
CONSTRAINTS = 'with max_delay = 300 ms, sample_period = 50 ms, sample_period_deviation = 20 ms'
REQUEST_PERIOD_S = 0.1

CLIENT_PERIOD_S = 15.0
"""Time between two clients that are killed."""

MAX_DELAY_S = 10.0
"""Maximum time from the timeout of a request to its answer: it takes some seconds to notice an
engine that is stopped for long, and to ask another one."""

MAX_GROWTH = 0.5
"""Maximum growth of the memory of a node, MB per minute."""

CLEANUP_TIMEOUT_S = 60.0
"""Time from the last answer until everything unused must be gone."""


def soak(arguments: argparse.Namespace, report: Callable[[dict[str, Any]], None]) -> None:
    """Send requests and inject faults, then report the results."""
    chance = random.Random(arguments.seed)  # noqa: S311
    evaluations: list[Any] = []
    with RunningSystem(VEHICLES, RATE, 2, CONSTRAINTS, far=True, logs=arguments.logs) as system:
        system.client.node.create_subscription(
            EvaluationStatusArray, f'{COORDINATOR}/evaluations', evaluations.append, LATCHED
        )
        requests = RandomRequests(system.client, list(system.sources), chance)
        lives = Lives(system, arguments.logs)
        faults = Faults(system, chance, () if arguments.steady else NODES)
        end = time.monotonic() + arguments.minutes * 60
        while time.monotonic() < end:
            _run_with_killed_client(system, requests, faults, lives)
            evaluations[:] = evaluations[-1:]
        faults.repair_all()
        _wait_for_answers(system, requests)
        left = _left(system, evaluations)
        high = system.high_levels()
        codes, nodes = system.stop(), lives.report()
        growth = [each['growth_mb_per_minute'] or 0.0 for each in nodes.values()]
        report(
            {
                'minutes': arguments.minutes,
                'seed': arguments.seed,
                'steady': arguments.steady,
                'faults': dict(sorted(faults.injected.items())),
                **_summary(requests, high),
                'left_behind': left,
                'exit_codes': codes,
                'deaths': lives.deaths,
                'nodes': nodes,
                'flat': all(each < MAX_GROWTH for each in growth),
            }
        )


def _run_with_killed_client(
    system: RunningSystem,
    requests: RandomRequests,
    faults: Faults,
    lives: Lives,
) -> None:
    """Continue for a while, with a client that is killed before it gets its answers."""
    end = time.monotonic() + CLIENT_PERIOD_S
    with worker(10.0, program=random_requests.PROGRAM) as client:
        wait_for_line(client)
        while time.monotonic() < end:
            requests.send()
            faults.step()
            lives.step()
            system.wait(REQUEST_PERIOD_S)
            if time.monotonic() > end - CLIENT_PERIOD_S * 0.7:
                client.kill()


def _wait_for_answers(system: RunningSystem, requests: RandomRequests) -> None:
    longest = max(kind.timeout for kind in random_requests.KINDS.values()) + MAX_DELAY_S
    with suppress(AssertionError):
        system.client.spin_until(lambda: not requests.open, 'the last answers', longest)


def _left(system: RunningSystem, evaluations: Sequence[Any]) -> dict[str, Any]:
    """Return the streams, groups and evaluations that are left over."""

    def left() -> dict[str, Any]:
        statuses = evaluations[-1].evaluations if evaluations else []
        return {
            'streams': sorted(system.streams() ^ {f'{name}_power' for name in system.batteries}),
            'groups': groups_of(system),
            'evaluations': sum(each.phase != EvaluationStatus.ENDED for each in statuses),
        }

    with suppress(AssertionError):
        system.client.spin_until(
            lambda: not any(left().values()), 'nothing is left', CLEANUP_TIMEOUT_S
        )
    return left()


def groups_of(system: RunningSystem) -> list[str]:
    """Return the formula groups, which the engine names when it refuses to destroy another one."""
    answer = system.client.call(
        FormulaGroupDestroy, f'{REASONER}/formula_group_destroy', formula_group_id=-1
    )
    there_are = answer.exit_status.message.partition('there are')[2]
    return re.findall(r'\d+', there_are)


def _summary(requests: RandomRequests, high: dict[str, list[int]]) -> dict[str, Any]:
    faults = [(each, each.fault(high, MAX_DELAY_S)) for each in requests.asked]
    answered = [each for each in requests.asked if each.ended is not None]
    at_once = [
        round((each.ended - each.begun) * 1e9)
        for each in answered
        if each.name == 'true at once' and each.outcome == 'true' and each.ended is not None
    ]
    return {
        'asked': len(requests.asked),
        'answered': len(answered),
        'outcomes': requests.outcomes,
        'faulty_answers': [f'{each.name}: {fault}' for each, fault in faults if fault],
        'true_at_once': summary(at_once) if at_once else None,
    }


def main() -> None:
    """Run and print; the exit code is 1 if a requirement is not met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--minutes', type=float, default=20.0)
    parser.add_argument('--seed', type=int, default=1, help='of the requests and faults')
    parser.add_argument(
        '--steady', action='store_true', help='no node fails: measures the growth of memory'
    )
    parser.add_argument('--logs', type=Path, help='an existing folder for the logs of the nodes')
    parser.add_argument('--json', action='store_true', help='print one JSON object')
    arguments = parser.parse_args()
    use_private_domain()

    def report(found: dict[str, Any]) -> None:
        print_report(found, as_json=arguments.json)
        end(_is_wrong(found))

    soak(arguments, report)


def _is_wrong(found: dict[str, Any]) -> bool:
    wrong = (
        found['faulty_answers'],
        found['deaths'],
        any(found['left_behind'].values()),
        any(found['exit_codes'].values()),
        not found['flat'],
    )
    return any(wrong)


if __name__ == '__main__':
    main()
