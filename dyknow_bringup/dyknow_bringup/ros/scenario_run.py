"""A run of a scenario with the simulation and all nodes of DyKnow; commands monitor it."""

from __future__ import annotations

import os
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces.srv import ListStreams
from rclpy.executors import SingleThreadedExecutor
from rich.markup import escape

from dyknow_bringup.errors import BringupError
from dyknow_bringup.processes.composition import composed
from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.processes import (
    dyknow_processes,
    formula_markers,
    uav_simulation,
)
from dyknow_bringup.processes.robot import fleet_configuration, requested_streams
from dyknow_bringup.resources import scenario_path
from dyknow_bringup.simulation.scenario import load_scenario
from dyknow_bringup.simulation.vehicle import vehicle_names
from dyknow_common import SECOND_NS, ExitCode
from dyknow_common.executables import FALSE, SUCCESS, interruptible
from dyknow_common.ros import LATCHED, DyKnowNode, RemoteNode, start_ros
from dyknow_common.tables import Terminal

START_TIMEOUT_S = 30.0
"""Time that the nodes may take to start."""

INSTEAD_OF_ROS_ARGUMENTS = 'a demonstration sets the names and parameters of all its nodes'


class SystemRun(ABC):
    """A node beside systems that launchers run; a subclass works with it.

    Args:
        launchers: the launchers of all processes that must not end by themselves.
    """

    def __init__(self, *launchers: Launcher) -> None:
        self._launchers = launchers
        self._console = Terminal()

    def run(self) -> bool:
        """Work with a node; return True if it ended as it should."""
        self._node = DyKnowNode('uav_demo')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        try:
            return self._work()
        finally:
            self._executor.shutdown()
            self._node.destroy_node()

    @abstractmethod
    def _work(self) -> bool:
        """Do the work; return True if it ended as it should."""

    def _answer(self, remote: RemoteNode, service_type: Any, what: str) -> Any:
        """Return the response of a node."""
        asked = self._executor.create_task(remote.call, service_type)
        self._wait_for(asked.done, what)
        return asked.result()

    def _wait_for(
        self, condition: Callable[[], bool], description: str, timeout_s: float = START_TIMEOUT_S
    ) -> None:
        """Spin until a condition holds, for a time at most."""
        end = self._node.now() + round(timeout_s * SECOND_NS)
        while not condition():
            self._spin()
            if self._node.now() > end:
                raise BringupError(
                    f'{description} did not come up within {timeout_s:g} s', ExitCode.TIMEOUT
                )

    def _spin(self) -> None:
        self._executor.spin_once(timeout_sec=0.05)
        for each in self._launchers:
            each.check_running()


class ScenarioRun(SystemRun):
    """A run of a scenario; a subclass monitors it.

    Args:
        scenario: the name of a shipped scenario, or the path of a YAML file.
        vehicles: the number of vehicles.
        launcher: starts the processes.
        folder: the folder for the files of the run.
        markers: True to show formulas in three-dimensional views.
        processes: True: each node of DyKnow has a process; False: one process has all nodes.

    Raises:
        BringupError: if there is no such scenario, or if the fleet cannot fly it.
    """

    def __init__(
        self,
        scenario: str,
        vehicles: int,
        launcher: Launcher,
        folder: Path,
        *,
        markers: bool = False,
        processes: bool = False,
    ) -> None:
        super().__init__(launcher)
        path = scenario_path(scenario)
        self._scenario = load_scenario(path)
        names = self._vehicles = vehicle_names(vehicles)
        self._scenario.check_fleet(names)
        self._simulation = uav_simulation(path, vehicles)
        self._launcher = launcher
        self._folder = folder
        self._configuration = fleet_configuration(names)
        self._fleet_streams = requested_streams(self._configuration)
        nodes = dyknow_processes(self._configuration)
        self._processes = list(nodes if processes else composed(nodes, os.environ))
        if markers:
            self._processes.append(formula_markers())
        self._start = 0

    def _work(self) -> bool:
        self._launcher.start_all(self._processes)
        self._console.print(
            f'[bold]{escape(self._scenario.name)}[/]: {escape(self._scenario.description)}'
        )
        coordinator = RemoteNode(self._node, 'stream_reasoning_coordinator')
        manager = RemoteNode(self._node, 'stream_manager', patience_s=START_TIMEOUT_S)
        with self._console.status('starting the nodes of DyKnow'):
            self._wait_for(lambda: coordinator.is_running, 'the coordinator')
            self._wait_for(lambda: self._has_streams(manager), 'the streams of the fleet')
        return self._monitor()

    @abstractmethod
    def _monitor(self) -> bool:
        """Start the simulation and monitor it; return True if it ended as it should."""

    def _start_simulation(self) -> None:
        """Start the simulation and wait until it has a start time."""
        self._node.create_subscription(
            DiagnosticStatus, 'uav_simulation/_status', self._on_status, LATCHED
        )
        self._launcher.start(self._simulation)
        with self._console.status('starting the simulation'):
            self._wait_for(lambda: self._start > 0, 'the simulation')

    def _on_status(self, status: DiagnosticStatus) -> None:
        for entry in status.values:
            if entry.key == 'start_time':
                self._start = int(entry.value)

    def _has_streams(self, manager: RemoteNode) -> bool:
        listed = self._answer(manager, ListStreams, 'the stream manager')
        return set(listed.stream_names) >= self._fleet_streams


def run_scenario(
    make_run: Callable[[Launcher, Path], SystemRun], log_level: str, logs: Path | None = None
) -> int:
    """Run a scenario and return the exit code: SUCCESS if it ended as it should, or else FALSE.

    Args:
        make_run: returns the run, given a launcher and a folder for its files.
        log_level: the log level of the nodes.
        logs: the folder for the logs of the nodes; None for a temporary one.
    """
    if logs is not None:
        logs.mkdir(parents=True, exist_ok=True)
    with (
        interruptible(),
        tempfile.TemporaryDirectory(prefix='dyknow_') as temporary,
        Launcher(logs or Path(temporary), log_level=log_level) as launcher,
    ):
        run = make_run(launcher, Path(temporary))
        start_ros()
        try:
            return SUCCESS if run.run() else FALSE
        finally:
            rclpy.try_shutdown()
