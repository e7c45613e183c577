"""All of DyKnow under load while nodes and topics fail at random: is each answer right?

python benchmarks/soak_coordinator.py [--minutes 20] [--seed 1] [--steady] [--logs FOLDER] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import questions
from dyknow_interfaces.msg import EvaluationStatus, EvaluationStatusArray
from dyknow_interfaces.srv import FormulaGroupDestroy
from faults import NODES, Faults
from processes import (
    growth_per_minute,
    resident_memory,
    summary,
    use_private_domain,
    wait_for_line,
    worker,
)
from questions import LATITUDE, Clientele
from whole import COORDINATOR, REASONER, Whole

from dyknow_common.ros import LATCHED

VEHICLES = 3
RATE = 20.0
CONSTRAINTS = 'with max_delay = 300 ms, sample_period = 50 ms, sample_period_deviation = 20 ms'
TURN = 0.1
"""Seconds between two questions."""

KILLED_CLIENTS = 15.0
"""Seconds between two clients that are killed."""

LIMIT = 0.5
"""MB per minute that the memory of a node may seem to grow."""

LONG = 300.0
"""Seconds that a node has to live for its growth to tell anything: it warms up for minutes."""

WARM_UP = 0.4
PATIENCE = 20.0
"""Seconds to leave the graph in."""

REST = 60.0
"""Seconds after the last answer in which what is not needed any more has to be gone."""


def soak(arguments: argparse.Namespace, tell: Callable[[dict[str, Any]], None]) -> None:
    """Asks and breaks, then tells what came of it."""
    chance = random.Random(arguments.seed)  # noqa: S311
    lives: dict[tuple[str, int], list[tuple[float, float]]] = {}
    evaluations: list[Any] = []
    with Whole(VEHICLES, RATE, 2, CONSTRAINTS, far=True, logs=arguments.logs) as whole:
        whole.client.node.create_subscription(
            EvaluationStatusArray, f'{COORDINATOR}/evaluations', evaluations.append, LATCHED
        )
        clientele = Clientele(whole.client, list(whole.sources), chance)
        faults = Faults(whole, chance, () if arguments.steady else NODES)
        end = time.monotonic() + arguments.minutes * 60
        while time.monotonic() < end:
            _one_client_is_killed(whole, clientele, faults, lives)
            evaluations[:] = evaluations[-1:]
        faults.heal()
        _wait_for_answers(whole, clientele)
        left = _left(whole, evaluations)
        high = json.loads(whole.order('high'))
        codes = whole.stop()
        tell(
            {
                'minutes': arguments.minutes,
                'seed': arguments.seed,
                'steady': arguments.steady,
                'faults': dict(sorted(faults.happened.items())),
                **_account(clientele, whole.sources, high),
                'left_behind': left,
                'exit_codes': codes,
                **_memory(lives),
            }
        )


def _one_client_is_killed(
    whole: Whole,
    clientele: Clientele,
    faults: Faults,
    lives: dict[tuple[str, int], list[tuple[float, float]]],
) -> None:
    """Goes on for a while, in which a client asks and does not live to hear the answers."""
    end = time.monotonic() + KILLED_CLIENTS
    with worker(10.0, program=questions.PROGRAM) as client:
        wait_for_line(client)
        while time.monotonic() < end:
            clientele.turn()
            faults.turn()
            whole.wait(TURN)
            if time.monotonic() > end - KILLED_CLIENTS * 0.7:
                client.kill()
    now = time.monotonic()
    for name, pid in whole.pids.items():
        with suppress(FileNotFoundError, ProcessLookupError):
            lives.setdefault((name, pid), []).append((now, resident_memory(pid)))


def _wait_for_answers(whole: Whole, clientele: Clientele) -> None:
    longest = max(kind.timeout for kind in questions.KINDS.values()) + LATITUDE
    with suppress(TimeoutError):
        whole.client.spin_until(lambda: not clientele.open, 'the last answers', longest)


def _left(whole: Whole, evaluations: Sequence[Any]) -> dict[str, Any]:
    """What is there though nobody asks for it any more."""

    def left() -> dict[str, Any]:
        statuses = evaluations[-1].evaluations if evaluations else []
        return {
            'streams': sorted(whole.streams() ^ {f'{name}_power' for name in whole.batteries}),
            'groups': _groups(whole),
            'evaluations': sum(each.phase != EvaluationStatus.ENDED for each in statuses),
        }

    with suppress(TimeoutError):
        whole.client.spin_until(lambda: not any(left().values()), 'nothing is left', REST)
    return left()


def _groups(whole: Whole) -> list[str]:
    """The formula groups that there are, as the refusal to destroy another one names them."""
    answer = whole.client.call(
        FormulaGroupDestroy, f'{REASONER}/formula_group_destroy', formula_group_id=-1
    )
    there_are = answer.exit_status.message.partition('there are')[2]
    return re.findall(r'\d+', there_are)


def _account(
    clientele: Clientele, sources: dict[str, tuple[str, ...]], high: dict[str, list[int]]
) -> dict[str, Any]:
    stamps = {
        vehicle: [stamp for name in names for stamp in high.get(name, ())]
        for vehicle, names in sources.items()
    }
    outcomes = Counter(f'{each.name}: {each.outcome}' for each in clientele.asked)
    faults = [(each, each.fault(stamps)) for each in clientele.asked]
    answered = [each for each in clientele.asked if each.ended is not None]
    at_once = [
        round((each.ended - each.begun) * 1e9)
        for each in answered
        if each.name == 'true at once' and each.outcome == 'true' and each.ended is not None
    ]
    return {
        'asked': len(clientele.asked),
        'answered': len(answered),
        'outcomes': dict(sorted(outcomes.items())),
        'faulty_answers': [f'{each.name}: {fault}' for each, fault in faults if fault],
        'true_at_once': summary(at_once) if at_once else None,
    }


def _memory(lives: dict[tuple[str, int], list[tuple[float, float]]]) -> dict[str, Any]:
    """How the memory of each node grew over the longest of its lives."""
    longest: dict[str, list[tuple[float, float]]] = {}
    for (name, _), found in lives.items():
        longest[name] = max(longest.get(name, []), found, key=len)
    growth = {
        name: growth_per_minute(found, WARM_UP)
        for name, found in longest.items()
        if found[-1][0] - found[0][0] > LONG
    }
    return {
        'memory_mb': {name: [found[0][1], found[-1][1]] for name, found in longest.items()},
        'growth_mb_per_minute': growth,
        'flat': all(each < LIMIT for each in growth.values()),
    }


def main() -> None:
    """Runs and prints; the exit code is 1 where anything is not as it should be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--minutes', type=float, default=20.0)
    parser.add_argument('--seed', type=int, default=1, help='of the questions and faults')
    parser.add_argument(
        '--steady', action='store_true', help='no node fails: tells how the memory of each grows'
    )
    parser.add_argument('--logs', type=Path, help='an existing folder for what the nodes print')
    parser.add_argument('--json', action='store_true', help='print one JSON object')
    arguments = parser.parse_args()
    use_private_domain()

    def tell(found: dict[str, Any]) -> None:
        if arguments.json:
            print(json.dumps(found), flush=True)
        else:
            for name, value in found.items():
                print(f'{name}: {value}', flush=True)
        # The middleware may wait for ever for a lock in shared memory that a killed process held.
        watch = threading.Timer(PATIENCE, os._exit, (_is_wrong(found),))
        watch.daemon = True
        watch.start()
        raise SystemExit(_is_wrong(found))

    soak(arguments, tell)


def _is_wrong(found: dict[str, Any]) -> bool:
    wrong = (
        found['faulty_answers'],
        any(found['left_behind'].values()),
        any(found['exit_codes'].values()),
        not found['flat'],
    )
    return any(wrong)


if __name__ == '__main__':
    main()
