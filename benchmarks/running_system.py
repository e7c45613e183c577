"""All nodes of DyKnow for a fleet, each in a process of its own, and their costs."""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

from dyknow_interfaces.msg import FormulaProgress, FormulaResult
from dyknow_interfaces.srv import EvaluateFormula, ListStreams
from processes import ENGINE, MANAGER, Client, costs, tell
from rclpy.task import Future

import robots
from dyknow_bringup.processes.composition import composed
from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.processes import SystemConfiguration, dyknow_processes
from dyknow_bringup.processes.robot import fleet_configuration
from dyknow_bringup.simulation.vehicle import vehicle_names
from dyknow_common.ros import nanoseconds_to_duration

COORDINATOR = 'stream_reasoning_coordinator'
REASONER = 'stream_reasoning_engine'
SECOND_ENGINE = f'{ENGINE}_2'
EVALUATE = f'{COORDINATOR}/evaluate_formula'

AT_ONCE = 'forall u in UAV: Power[u] > 0'
"""A formula that the first state decides."""

WARM_UP_LIMIT_S = 60.0


class RunningSystem:
    """The nodes, a fleet and a client; a context manager that stops them.

    Its `folder` has the files of the configuration, its `launcher` the nodes.

    Args:
        batteries: the number for each vehicle.
        constraints: of the streams of the fleet, such as `with max_delay = 1 s`.
        progress_period: seconds between two reports of the reasoning engine on a formula.
        engines: the number of stream processing engines.
        logs: a folder for the logs of the nodes; None: they are deleted.
        composition: True for one process with all nodes but further engines.
    """

    def __init__(
        self,
        vehicles: int,
        rate: float,
        batteries: int = 1,
        constraints: str = '',
        progress_period: float = 1.0,
        *,
        engines: int = 1,
        logs: Path | None = None,
        composition: bool = False,
    ) -> None:
        self.sources = {
            name: (name, *(f'{name}_spare{number}' for number in range(1, batteries)))
            for name in vehicle_names(vehicles)
        }
        self.running: set[tuple[int, int]] = set()
        self.fleet: Any = None
        self.pids: dict[str, int] = {}
        self.folder = Path()
        self.started_at = 0.0
        self._rate = rate
        self._constraints = constraints
        self._progress_period = progress_period
        self._logs = logs
        self._engines = engines
        self._composition = composition
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        self.folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory()))
        self.client = self._stack.enter_context(Client())
        self.fleet = self._stack.enter_context(robots.fleet(self._rate, *self.batteries))
        nodes = dyknow_processes(self._configuration())
        self._processes = {
            each.name: each
            for each in (composed(nodes, os.environ) if self._composition else nodes)
        }
        self.launcher = self._stack.enter_context(Launcher(self._logs or self.folder))
        self.started_at = time.monotonic()
        for node in self._processes:
            self.start(node)
        self.client.wait_for_coordinator()
        self.client.spin_until(
            lambda: self.streams() == self.fleet_streams, 'just the streams of the fleet'
        )
        self.running = running_formulas(self.client)
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _configuration(self) -> SystemConfiguration:
        """Write a configuration with the power of each vehicle from each of its batteries."""
        annotations, streams = (self.folder / f'fleet.{each}' for each in ('ssl', 'streams'))
        annotations.write_text(
            ''.join(
                f'stream {name}_power contains Power[{vehicle}] = power;\n'
                for vehicle, names in self.sources.items()
                for name in names
            ),
            encoding='utf-8',
        )
        streams.write_text(
            ''.join(
                f'stream {name}_power = select current as power from "/{name}/battery" '
                f'{self._constraints}; sink {name}_power;\n'
                for name in self.batteries
            ),
            encoding='utf-8',
        )
        return SystemConfiguration(
            ontologies=fleet_configuration(list(self.sources)).ontologies,
            annotations=(annotations,),
            streams=(streams,),
            engines=self._engines,
            parameters={
                REASONER: {'progress_period': self._progress_period},
                MANAGER: {'memory': str(self.folder / 'streams.memory')},
                'ontology_manager': {'allow_download': True, 'load_limit': 5.0},
            },
        )

    def start(self, node: str) -> None:
        """Start a node."""
        self.pids[node] = self.launcher.start(self._processes[node]).pid

    @property
    def batteries(self) -> list[str]:
        """The names of all batteries."""
        return [name for names in self.sources.values() for name in names]

    @property
    def fleet_streams(self) -> set[str]:
        """The names of the streams of the fleet."""
        return {f'{name}_power' for name in self.batteries}

    def command(self, *words: object) -> str:
        """Send a command to the fleet and return its answer."""
        return tell(self.fleet, *words)

    def high_levels(self) -> dict[str, list[int]]:
        """Return the stamps of the high levels of each vehicle, of any of its batteries."""
        found = json.loads(self.command('high'))
        return {
            vehicle: [stamp for name in names for stamp in found.get(name, ())]
            for vehicle, names in self.sources.items()
        }

    def ask(self, formula: str, timeout: float = 600.0, **fields: Any) -> Future:
        """Send a formula to the coordinator and return the future of the answer."""
        return ask(self.client, EVALUATE, formula, timeout, **fields)

    def warm_up(self) -> None:
        """Ask for a verdict until there is one: nodes that discover each other lose requests."""
        futures: list[Future] = []

        def is_warm() -> bool:
            if not futures or futures[-1].done():
                if futures and futures[-1].result().verdict:
                    return True
                futures.append(self.ask(AT_ONCE, 10.0))
            return False

        self.client.spin_until(is_warm, 'the first verdict', WARM_UP_LIMIT_S)

    def streams(self) -> set[str]:
        """Return the names of the streams that the manager knows."""
        return set(self.client.call(ListStreams, f'{MANAGER}/list_streams').stream_names)

    def ask_running(self, formula: str, timeout: float = 600.0) -> Future:
        """Send a formula to the coordinator, and wait until it has had a state."""
        known = len(self.running)
        future = self.ask(formula, timeout)
        self.client.spin_until(lambda: len(self.running) > known, 'a state', 60.0)
        return future

    def costs(self, seconds: float) -> dict[str, dict[str, float]]:
        """Return the share of a core and the memory in MB of each node over a time."""
        return costs(self.pids, self.client.wait, seconds)


def running_formulas(client: Client) -> set[tuple[int, int]]:
    """Return the set of formulas that have had a state, which grows from now on."""
    found: set[tuple[int, int]] = set()

    def on_progress(report: Any) -> None:
        if report.states_progressed:
            found.add((report.formula_group_id, report.formula_id))

    client.node.create_subscription(FormulaProgress, f'{REASONER}/progress', on_progress, 1000)
    return found


def outcome_of(answer: Any) -> str:
    """Return the outcome of an `EvaluateFormula` in a word or two; None for no answer."""
    if answer is None:
        return 'lost'
    if answer.exit_status.code:
        return f'error {answer.exit_status.code}'
    verdicts = {FormulaResult.TRUE: 'true', FormulaResult.FALSE: 'false'}
    return verdicts.get(answer.verdict, 'undecided')


def ask(client: Client, service: str, formula: str, timeout: float, **fields: Any) -> Future:
    """Call a service with a formula and return the future of the answer."""
    limit = nanoseconds_to_duration(round(timeout * 1e9))
    return client.request(EvaluateFormula, service, formula=formula, timeout=limit, **fields)


def timed(future: Future, clock: Callable[[], int] = time.time_ns) -> list[int]:
    """Return a list that gets the time at which a future is done, nanoseconds."""
    times: list[int] = []
    future.add_done_callback(lambda _: times.append(clock()))
    return times
