"""Hostile, buggy and normal clients together: all answers of the normal ones are judged.

python benchmarks/soak_clients.py [--minutes 20] [--seed 1] [--clients 2] [--rows ROW ...] [--each]
    [--p99 SECONDS] [--composition] [--logs FOLDER] [--domain N] [--list] [--json]

Hostile clients perform rows of harmful requests and messages at random, and are killed in the
middle. With --each, each row is performed alone, by a system of its own, for --minutes. The exit
code is 1 if a verdict was wrong or missing, a normal request was lost or failed, a hostile request
had no end, or a node died or logged a fault.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import hostile_client
from faults import Faults
from hostile_rows import ROWS
from lives import Lives
from normal_clients import DEFECTS, NormalClients
from parts import end, print_report
from processes import avoid_shared_memory, use_private_domain
from random_requests import KINDS, MAX_DELAY_S
from running_system import RunningSystem

VEHICLES = 3
RATE = 20.0
CONSTRAINTS = 'with max_delay = 2 s, sample_period = 50 ms, sample_period_deviation = 20 ms'
"""Streams are late only where a node is busy: the fleet has no faults."""

STEP_S = 0.05
KILL_PERIOD_S = 12.0
"""Time between two hostile clients that are killed."""

MAY_WAIT = 'random_requests'
"""The row whose formulas may have a long timeout; the requests of others end in 10 s."""


class HostileClients:
    """Processes of hostile clients, which are killed and started again.

    Args:
        number: of processes.
        rows: the names of the rows.
        chance: decides who is killed, and when.
        folder: for their files; the nodes may read it.
    """

    def __init__(
        self, number: int, rows: Sequence[str], chance: random.Random, folder: Path
    ) -> None:
        self._environment = {**os.environ, 'TMPDIR': str(folder)}
        self.faults: Counter[str] = Counter()
        self.internal_errors: Counter[str] = Counter()
        self.killed = 0
        self._rows = rows
        self._chance = chance
        self._outcomes: defaultdict[str, Counter[str]] = defaultdict(Counter)
        self._slowest: Counter[str] = Counter()
        self._running = [self._start() for _ in range(number)]
        self._next_kill = time.monotonic() + KILL_PERIOD_S

    def step(self) -> None:
        """Kill a client if one is due, and start the clients again that have ended."""
        now = time.monotonic()
        if self._running and now > self._next_kill:
            self._next_kill = now + self._chance.uniform(0.5, 1.5) * KILL_PERIOD_S
            self._chance.choice(self._running).kill()
            self.killed += 1
        for place, each in enumerate(self._running):
            if each.poll() is not None:
                if each.returncode > 0:
                    self.faults[f'a hostile client ended with exit code {each.returncode}'] += 1
                self._running[place] = self._start()

    def stop(self) -> None:
        """Kill all clients."""
        for each in self._running:
            each.kill()
            each.wait()

    def report(self) -> dict[str, dict[str, Any]]:
        """Return the outcomes of each row, and the time of its slowest answer in seconds."""
        return {
            name: {**self._outcomes[name], 'slowest_s': self._slowest[name]}
            for name in sorted(self._outcomes)
        }

    def _start(self) -> subprocess.Popen[str]:
        seed = self._chance.randrange(10**6)
        started = subprocess.Popen(
            [sys.executable, str(hostile_client.PROGRAM), str(seed), '100000', *self._rows],
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
            env=self._environment,
        )
        threading.Thread(target=self._read, args=(started,), daemon=True).start()
        return started

    def _read(self, client: subprocess.Popen[str]) -> None:
        for line in client.stdout or ():
            with suppress(ValueError):  # A line of a killed client may be cut.
                self._note(json.loads(line))

    def _note(self, found: dict[str, Any]) -> None:
        name = found['row']
        self._outcomes[name][found['outcome']] += found['number']
        self._slowest[name] = max(self._slowest[name], round(found.get('seconds', 0.0), 2))
        if 'fault' in found:
            self.faults[f'{name}: {found["fault"]}'] += 1
        if 'message' in found:
            self.internal_errors[f'{name}: {found["message"]}'] += 1


def soak(arguments: argparse.Namespace, rows: Sequence[str], logs: Path) -> dict[str, Any]:
    """Run all clients for a time and return the results."""
    chance = random.Random(arguments.seed)  # noqa: S311
    with RunningSystem(
        VEHICLES, RATE, 1, CONSTRAINTS, logs=logs, composition=arguments.composition
    ) as system:
        system.warm_up()
        nodes, normal = Lives(system, logs), NormalClients(system, chance)
        surges = Faults(system, chance, (), topics=False)
        hostile = HostileClients(arguments.clients, rows, chance, system.folder)
        try:
            _run(system, arguments.minutes * 60, nodes, normal, surges, hostile)
            high = system.high_levels()
            begun = time.monotonic()
            codes = system.stop()
            stopped = time.monotonic() - begun
        finally:
            hostile.stop()
        log_mb = sum(path.stat().st_size for path in logs.glob('*.log')) / 1e6
        return {
            'minutes': arguments.minutes,
            'seed': arguments.seed,
            'normal': normal.report(high),
            'deaths': nodes.deaths,
            'exit_codes': codes,
            'stopped_s': round(stopped, 1),
            'logged_faults': nodes.faults(),
            'log_mb': round(log_mb, 1),
            'surges': dict(surges.injected),
            'internal_errors': dict(hostile.internal_errors),
            'hostile_faults': dict(hostile.faults),
            'hostile_killed': hostile.killed,
            'hostile': hostile.report(),
            'nodes': nodes.report(),
        }


def _run(
    system: RunningSystem,
    seconds: float,
    nodes: Lives,
    normal: NormalClients,
    surges: Faults,
    hostile: HostileClients,
) -> None:
    """Run all clients for a time; then wait for the answers, beside the hostile clients."""
    end = time.monotonic() + seconds
    last = end + max(kind.timeout for kind in KINDS.values()) + MAX_DELAY_S
    while (now := time.monotonic()) < end or (now < last and not normal.is_answered):
        if now < end:
            normal.step()
        # A high level ends formulas that would else hold until their timeouts.
        surges.step()
        hostile.step()
        nodes.step()
        system.wait(STEP_S)


def defects(found: Mapping[str, Any], max_p99_s: float) -> list[str]:
    """Return the names of the requirements that a run did not meet.

    Args:
        found: the results.
        max_p99_s: of the latency of the formulas that the first state decides.
    """
    normal = found['normal']
    p99_s = normal['latency_ms']['evaluate_formula']['p99'] / 1e3
    checks = {
        **{f'normal requests: {kind}': normal[kind] for kind in DEFECTS},
        f'p99 of EvaluateFormula: {p99_s} s': p99_s > max_p99_s,
        'deaths of nodes': found['deaths'],
        'exit codes': any(found['exit_codes'].values()),
        'faults in logs': found['logged_faults'],
        'faults of hostile clients': found['hostile_faults'],
        'unanswered hostile requests': any(
            'unanswered' in outcomes
            for row, outcomes in found['hostile'].items()
            if row != MAY_WAIT
        ),
        'answers INTERNAL_ERROR': found['internal_errors'],
    }
    return [name for name, broken in checks.items() if broken]


def _run_rows(
    arguments: argparse.Namespace, rows: Sequence[str], logs: Path | None
) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        found = soak(arguments, rows, logs or Path(folder))
        return {**found, 'defects': defects(found, arguments.p99)}


def main() -> None:
    """Run and print; the exit code is 1 if a requirement is not met."""
    arguments = _arguments()
    if arguments.list:
        for name, row in ROWS.items():
            print(f'{name}: {(row.__doc__ or "").splitlines()[0]}')
        return
    use_private_domain(arguments.domain)
    avoid_shared_memory()
    if not arguments.each:
        found = _run_rows(arguments, arguments.rows, arguments.logs)
        print_report(found, as_json=arguments.json)
        end(bool(found['defects']))
    broken = False
    for row in arguments.rows:
        logs = arguments.logs and arguments.logs / row
        if logs:
            logs.mkdir(exist_ok=True)
        found = _run_rows(arguments, [row], logs)
        broken |= bool(found['defects'])
        print_report({'row': row, **found}, as_json=arguments.json)
    end(broken)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--minutes', type=float, default=20.0)
    parser.add_argument('--seed', type=int, default=1, help='of the requests')
    parser.add_argument('--clients', type=int, default=2, help='the number of hostile clients')
    parser.add_argument('--rows', nargs='+', choices=ROWS, default=list(ROWS), metavar='ROW')
    parser.add_argument(
        '--p99',
        type=float,
        default=math.inf,
        metavar='SECONDS',
        help='fail if the 99th percentile of the latency of a formula is higher',
    )
    parser.add_argument('--each', action='store_true', help='one row after the other, alone')
    parser.add_argument('--list', action='store_true', help='list the rows')
    parser.add_argument(
        '--composition', action='store_true', help='all nodes in one process, as "dyknow up" has it'
    )
    parser.add_argument('--logs', type=Path, help='an existing folder for the logs of the nodes')
    parser.add_argument('--domain', type=int, help='a ROS domain that nobody else uses')
    parser.add_argument('--json', action='store_true', help='print one JSON object a line')
    return parser.parse_args()


if __name__ == '__main__':
    main()
