"""Run DyKnow for long under a load; judge all answers, and the memory and the ends of the nodes.

python benchmarks/soak.py LOAD [--minutes 10] [--seed 1] [--composition] [--logs FOLDER] [--json]
python benchmarks/soak.py hostile [--clients 2] [--rows ROW ...] [--each]

- faults: clients send random formulas ten times a second, some are killed; topics are silent, late,
  repeated or out of order; nodes are killed and stopped. There are two engines, and two batteries
  of each vehicle.
- steady: the same, but no node fails: shows how memory grows.
- hostile: beside normal clients, which are timed, hostile ones perform rows of harmful requests and
  messages at random, and are killed in the middle. With --each, each row is performed alone, by a
  system of its own, for --minutes.
- streams: 500 messages a second, stamped late, for 30 streams; others are created and destroyed.

The exit code is 1 if an answer of a normal client is wrong, lost, late or an error that is not due;
if a hostile request has no answer; if samples are lost; if a node dies, logs a fault or grows; or
if something is left over after the last answer.
"""

from __future__ import annotations

import argparse
import random
import re
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dyknow_interfaces.msg import EvaluationStatus, EvaluationStatusArray
from dyknow_interfaces.srv import FormulaGroupDestroy
from faults import Faults
from hostile_processes import HostileProcesses
from hostile_rows import ROWS
from lives import Lives
from parts import end, print_report
from processes import use_private_domain_without_shared_memory
from running_system import COORDINATOR, REASONER, RunningSystem
from soak_requests import DEFECTS, LONGEST_S, Clients
from stream_load import StreamLoad

from dyknow_common.ros import LATCHED

VEHICLES = 3
RATE = 20.0
STEP_S = 0.05
CLEANUP_TIMEOUT_S = 60.0
"""Time from the last answer until everything unused must be gone."""

_STATES = 'sample_period = 50 ms, sample_period_deviation = 20 ms'


@dataclass(frozen=True)
class Load:
    """What a system has to bear.

    Args:
        max_delay: of the streams of the fleet; long if they are late only where a node is busy.
        request_period_s: between two formulas of normal clients.
        rows: of hostile clients.
        max_growth: of the memory of a node, MB per minute.
    """

    max_delay: str = '2 s'
    request_period_s: float = 0.2
    rows: tuple[str, ...] = ()
    max_growth: float = 0.5
    doubles: bool = False
    """True for a second battery of each vehicle and a second engine."""
    topics_fail: bool = False
    nodes_fail: bool = False
    has_streams: bool = False
    """True for messages and streams in place of normal clients."""


_FAULTS = Load('300 ms', 0.1, ('killed_client',), doubles=True, topics_fail=True, nodes_fail=True)
LOADS = {
    'faults': _FAULTS,
    'steady': replace(_FAULTS, nodes_fail=False),
    'hostile': Load(rows=tuple(ROWS), max_growth=float('inf')),
    'streams': Load(max_growth=0.25, has_streams=True),
}


class Soak:
    """A run of a load.

    Args:
        arguments: of the command line.
        rows: of the hostile clients.
        logs: a folder for the logs of the nodes.
        stack: ends the run.
    """

    def __init__(
        self, arguments: argparse.Namespace, rows: Sequence[str], logs: Path, stack: ExitStack
    ) -> None:
        load = self._load = LOADS[arguments.load]
        chance = random.Random(arguments.seed)  # noqa: S311
        self._seconds = arguments.minutes * 60
        self._logs = logs
        self._evaluations: list[Any] = []
        system = self._system = stack.enter_context(
            RunningSystem(
                VEHICLES,
                RATE,
                1 + load.doubles,
                f'with max_delay = {load.max_delay}, {_STATES}',
                engines=1 + load.doubles,
                logs=logs,
                composition=arguments.composition,
            )
        )
        system.warm_up()
        system.client.node.create_subscription(
            EvaluationStatusArray, f'{COORDINATOR}/evaluations', self._on_evaluations, LATCHED
        )
        self._lives = Lives(system, logs)
        self._faults = Faults(system, chance, topics=load.topics_fail, nodes=load.nodes_fail)
        self._clients = Clients(system, chance, load.request_period_s, may_fail=load.topics_fail)
        number = arguments.clients if rows else 0
        self._hostile = HostileProcesses(number, rows, chance, system.folder)
        stack.callback(self._hostile.stop)
        self._streams = StreamLoad(system, self._seconds, stack) if load.has_streams else None
        self._steps = [
            self._faults.step,
            self._hostile.step,
            self._lives.step,
            self._clients.step if self._streams is None else self._streams.step,
        ]

    def run(self) -> dict[str, Any]:
        """Run for a time, wait for the answers beside the hostile clients, and report."""
        end = time.monotonic() + self._seconds
        while time.monotonic() < end:
            for each in self._steps:
                each()
            self._system.client.wait(STEP_S)
        self._faults.repair_all()
        last = time.monotonic() + LONGEST_S
        while time.monotonic() < last and not self._clients.is_answered:
            self._hostile.step()
            self._lives.step()
            self._system.client.wait(STEP_S)
        return self._report()

    def _report(self) -> dict[str, Any]:
        streams = {} if self._streams is None else self._streams.report()
        left = self._left() if self._load.topics_fail else {}
        high = self._system.high_levels()
        begun = time.monotonic()
        codes = self._system.launcher.stop_all()
        stopped, nodes = time.monotonic() - begun, self._lives.report()
        growth = {name: each['growth_mb_per_minute'] or 0.0 for name, each in nodes.items()}
        return {
            'normal': self._clients.report(high),
            **streams,
            'faults': dict(sorted(self._faults.injected.items())),
            'left_behind': left,
            'deaths': self._lives.deaths,
            'exit_codes': codes,
            'stopped_s': round(stopped, 1),
            'logged_faults': self._lives.faults(),
            'log_mb': round(sum(each.stat().st_size for each in self._logs.glob('*.log')) / 1e6, 1),
            'hostile': self._hostile.report(),
            'hostile_faults': self._hostile.faults(),
            'nodes': nodes,
            'growing': [name for name, each in growth.items() if each > self._load.max_growth],
        }

    def _left(self) -> dict[str, Any]:
        """Return the streams, groups and evaluations that are left over."""
        self._hostile.stop()

        def left() -> dict[str, Any]:
            statuses = self._evaluations[-1].evaluations if self._evaluations else []
            return {
                'streams': sorted(self._system.streams() ^ self._system.fleet_streams),
                'groups': _groups_of(self._system),
                'evaluations': sum(each.phase != EvaluationStatus.ENDED for each in statuses),
            }

        with suppress(AssertionError):
            self._system.client.spin_until(
                lambda: not any(left().values()), 'nothing is left', CLEANUP_TIMEOUT_S
            )
        return left()

    def _on_evaluations(self, report: Any) -> None:
        self._evaluations = [report]


def _groups_of(system: RunningSystem) -> list[str]:
    """Return the formula groups, which the engine names when it refuses to destroy another one."""
    answer = system.client.call(
        FormulaGroupDestroy, f'{REASONER}/formula_group_destroy', formula_group_id=-1
    )
    return re.findall(r'\d+', answer.exit_status.message.partition('there are')[2])


def defects(found: Mapping[str, Any]) -> list[str]:
    """Return the names of the requirements that a run did not meet."""
    checks = {
        **{f'normal requests: {kind}': found['normal'][kind] for kind in DEFECTS},
        'lost samples': found.get('samples_lost'),
        'left over': any(found['left_behind'].values()),
        'deaths of nodes': found['deaths'],
        'exit codes': any(found['exit_codes'].values()),
        'faults in logs': found['logged_faults'],
        'growth of memory': found['growing'],
        'answers to hostile clients': found['hostile_faults'],
    }
    return [name for name, broken in checks.items() if broken]


def main() -> None:
    """Run and print; the exit code is 1 if a requirement is not met."""
    arguments = _arguments()
    use_private_domain_without_shared_memory()
    rows = arguments.rows or LOADS[arguments.load].rows
    broken = False
    for some in [[each] for each in rows] if arguments.each else [rows]:
        with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
            logs = arguments.logs or Path(folder)
            logs.mkdir(parents=True, exist_ok=True)
            if arguments.each:
                logs /= some[0]
                logs.mkdir(exist_ok=True)
            found = Soak(arguments, some, logs, stack).run()
        found = {'load': arguments.load, 'rows': some, 'minutes': arguments.minutes, **found}
        found['defects'] = defects(found)
        broken |= bool(found['defects'])
        print_report(found, as_json=arguments.json)
    end(broken)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('load', choices=LOADS)
    parser.add_argument('--minutes', type=float, default=10.0)
    parser.add_argument('--seed', type=int, default=1, help='of the requests and faults')
    parser.add_argument('--clients', type=int, default=2, help='the number of hostile clients')
    parser.add_argument('--rows', nargs='+', choices=ROWS, metavar='ROW')
    parser.add_argument('--each', action='store_true', help='one row after the other, alone')
    parser.add_argument('--composition', action='store_true', help='all nodes in one process')
    parser.add_argument('--logs', type=Path, help='an existing folder for the logs of the nodes')
    parser.add_argument('--json', action='store_true', help='print one JSON object a line')
    return parser.parse_args()


if __name__ == '__main__':
    main()
