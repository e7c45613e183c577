"""The demonstration: a simulated UAV fleet, all nodes of DyKnow, and a live table of verdicts.

Ends by itself; the exit code is 0 only when every verdict is what the scenario says.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces.srv import ListStreams
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.utilities import remove_ros_args
from rich.console import Console
from rich.live import Live
from rich.table import Table

from dyknow_bringup.demonstration.expectations import MonitoredFormula, unexpected
from dyknow_bringup.demonstration.formula_table import formula_table, summary
from dyknow_bringup.errors import BringupError
from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.processes import (
    dyknow_processes,
    formula_markers,
    uav_simulation,
    write_fleet_configuration,
)
from dyknow_bringup.resources import scenario_names, scenario_path, uav_ontology_path
from dyknow_bringup.ros.formula_monitor import FormulaMonitor
from dyknow_bringup.simulation.fleet import fleet_specification, vehicle_names
from dyknow_bringup.simulation.scenario import Scenario, load_scenario
from dyknow_common import SECOND_NS, DyKnowError, ExitCode
from dyknow_common.ros import LATCHED, DyKnowNode, RemoteNode
from dyknow_stream_processing import parse_specification, specifications_by_sink

START_LIMIT = 30.0
"""Seconds that the nodes may take to start."""

SETTLING = SECOND_NS
"""Nanoseconds after the end of the scenario in which verdicts may still come."""

LOG_LINES = 15


class Demonstration:
    """One run of a scenario.

    Args:
        launcher: starts the processes.
        folder: for the configuration of the fleet.
        markers: whether formulas are shown in three-dimensional views.
    """

    def __init__(
        self,
        scenario: Scenario,
        scenario_file: Path,
        vehicles: int,
        launcher: Launcher,
        folder: Path,
        *,
        markers: bool,
    ) -> None:
        self._scenario = scenario
        self._vehicles = vehicle_names(vehicles)
        scenario.check_fleet(self._vehicles)
        self._fleet_streams = specifications_by_sink(
            parse_specification(fleet_specification(self._vehicles))
        )
        self._simulation = uav_simulation(scenario_file, vehicles)
        self._launcher = launcher
        self._processes = (
            *dyknow_processes(
                write_fleet_configuration(self._vehicles, uav_ontology_path(), folder)
            ),
            *([formula_markers()] if markers else []),
        )
        self._console = Console()
        self._start: int | None = None

    def run(self) -> bool:
        """Whether every verdict is what the scenario says."""
        self._launcher.start_all(self._processes)
        self._node = DyKnowNode('uav_demo')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        try:
            self._start_up()
            return self._monitor()
        finally:
            self._executor.shutdown()
            self._node.destroy_node()

    def _start_up(self) -> None:
        self._console.print(f'[bold]{self._scenario.name}[/]: {self._scenario.description}')
        coordinator = RemoteNode(self._node, 'stream_reasoning_coordinator')
        manager = RemoteNode(self._node, 'stream_manager', patience=START_LIMIT)
        with self._console.status('starting the nodes of DyKnow'):
            self._wait_for(lambda: coordinator.is_running, 'the coordinator')
            self._wait_for(lambda: self._streams_made(manager), 'the streams of the fleet')

    def _monitor(self) -> bool:
        monitor = FormulaMonitor(on_change=lambda _: None)
        self._executor.add_node(monitor)
        try:
            self._wait_for(lambda: monitor.is_running, 'the coordinator')
            self._start_simulation()
            self._fly(monitor)
            return self._report(monitor)
        finally:
            self._executor.remove_node(monitor)
            monitor.destroy_node()

    def _start_simulation(self) -> None:
        self._node.create_subscription(
            DiagnosticStatus, 'uav_simulation/status', self._note_start, LATCHED
        )
        self._launcher.start(self._simulation)
        with self._console.status('starting the simulation'):
            self._wait_for(lambda: self._start is not None, 'the simulation')

    def _streams_made(self, manager: RemoteNode) -> bool:
        listing = self._executor.create_task(manager.call, ListStreams)
        self._wait_for(listing.done, 'the stream manager')
        names = set(listing.result().stream_names)
        return names >= set(self._fleet_streams)

    def _note_start(self, status: DiagnosticStatus) -> None:
        for entry in status.values:
            if entry.key == 'start_time':
                self._start = int(entry.value)

    def _fly(self, monitor: FormulaMonitor) -> None:
        end = (self._start or 0) + self._scenario.duration + SETTLING
        with Live(console=self._console, refresh_per_second=4) as live:
            while self._node.now() < end:
                self._spin()
                live.update(self._table(monitor))
        self._wait_for(monitor.cancel_all().done, 'the end of the evaluations')

    def _table(self, monitor: FormulaMonitor) -> Table:
        elapsed = self._node.now() - (self._start or 0)
        return formula_table(monitor.formulas, self._start or 0, elapsed)

    def _report(self, monitor: FormulaMonitor) -> bool:
        problems = {
            monitored.formula.name: problem
            for monitored in monitor.formulas
            if (problem := self._unexpected(monitored)) is not None
        }
        self._console.print()
        self._console.print(summary(self._scenario.name, problems))
        return not problems

    def _unexpected(self, monitored: MonitoredFormula) -> str | None:
        expectation = self._scenario.expected.get(monitored.formula.name)
        return unexpected(monitored, expectation, self._start or 0)

    def _wait_for(self, condition: Callable[[], bool], what: str) -> None:
        end = self._node.get_clock().now().nanoseconds + round(START_LIMIT * SECOND_NS)
        while not condition():
            self._spin()
            if self._node.get_clock().now().nanoseconds > end:
                raise BringupError(
                    f'{what} did not come up within {START_LIMIT:g} s', ExitCode.TIMEOUT
                )

    def _spin(self) -> None:
        self._executor.spin_once(timeout_sec=0.05)
        for executable, code in self._launcher.ended().items():
            text = self._launcher.log(executable).read_text(errors='replace')
            tail = '\n'.join(text.splitlines()[-LOG_LINES:])
            raise BringupError(
                f'{executable} ended with exit code {code}:\n{tail}', ExitCode.UNAVAILABLE
            )


def options(arguments: Sequence[str]) -> argparse.Namespace:
    """The options on the command line."""
    parser = argparse.ArgumentParser(
        prog='uav_demo', description='Monitors a simulated UAV fleet with DyKnow.'
    )
    parser.add_argument(
        '--scenario',
        default='power_surge',
        help=f'{", ".join(scenario_names())}, or a YAML file (default: power_surge)',
    )
    parser.add_argument('--uavs', type=int, default=3, help='number of vehicles (default: 3)')
    parser.add_argument('--markers', action='store_true', help='show formulas in rviz2 or Foxglove')
    parser.add_argument('--log-level', default='info', help='of the nodes (default: info)')
    parser.add_argument(
        '--logs', type=Path, help='folder for the logs of the nodes (default: a temporary one)'
    )
    return parser.parse_args(arguments)


def main() -> int:
    """The executable uav_demo."""
    chosen = options(remove_ros_args(sys.argv)[1:])
    with tempfile.TemporaryDirectory(prefix='uav_demo_') as temporary:
        folder = Path(temporary)
        logs = chosen.logs or folder
        logs.mkdir(parents=True, exist_ok=True)
        try:
            path = scenario_path(chosen.scenario)
            scenario = load_scenario(path)
            rclpy.init()
            with Launcher(logs, log_level=chosen.log_level) as launcher:
                demonstration = Demonstration(
                    scenario, path, chosen.uavs, launcher, folder, markers=chosen.markers
                )
                return 0 if demonstration.run() else 1
        except DyKnowError as error:
            print(f'uav_demo: {error}', file=sys.stderr)  # noqa: T201 - there is no node yet
            return 1
        except (KeyboardInterrupt, ExternalShutdownException):
            return 130
        finally:
            rclpy.try_shutdown()
