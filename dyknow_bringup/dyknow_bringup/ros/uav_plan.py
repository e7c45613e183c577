"""A simulated vehicle executes a plan, and DyKnow monitors it: which action went wrong, and why.

Ends by itself; the exit code is 0 only when no formula was violated and every action succeeded.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.utilities import remove_ros_args

from dyknow_bringup.demonstration.plan_table import plan_table, verdict_line
from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.resources import plan_path, scenario_path
from dyknow_bringup.ros.uav_demo import Demonstration
from dyknow_bringup.simulation.missions import Mission, load_mission
from dyknow_bringup.simulation.scenario import Scenario, load_scenario
from dyknow_common import SECOND_NS, DyKnowError, Verdict
from dyknow_coordinator import PlanOutcome, PlanVerdict
from dyknow_coordinator.ros import FormulaClient, PlanMonitor


class MonitoredMission(Demonstration):
    """One flight of a mission, through a scenario in which the vehicle does what the plan says.

    Args:
        folder: for the configuration of the fleet.
    """

    def __init__(
        self,
        mission: Mission,
        scenario: Scenario,
        scenario_file: Path,
        launcher: Launcher,
        folder: Path,
    ) -> None:
        super().__init__(scenario, scenario_file, 2, launcher, folder, markers=False)
        self._mission = mission

    def _monitor(self) -> bool:
        with FormulaClient(self._node) as client:
            monitor = client.monitor_plan(self._mission.plan, on_verdict=self._tell)
            self._start_simulation()
            execution = self._executor.create_task(self._execute, client, monitor)
            while not execution.done():
                self._spin()
            succeeded, outcome = execution.result()
        self._console.print(plan_table(outcome))
        if outcome.error is not None:
            raise outcome.error
        return succeeded and not outcome.violations

    async def _execute(
        self, client: FormulaClient, monitor: PlanMonitor
    ) -> tuple[bool, PlanOutcome]:
        """Reports the actions as they go, and returns whether all succeeded, and the outcome."""
        going_well = True
        for task in self._mission.tasks:
            if not going_well:
                # It will not be begun.
                await monitor.failed(task.action)
                continue
            self._console.print(f'[bold]{task.action}[/] starts')
            await monitor.started(task.action)
            reached = await client.evaluate(task.goal, timeout=task.within / SECOND_NS)
            going_well = reached.verdict is Verdict.TRUE
            if going_well:
                await monitor.succeeded(task.action)
                self._console.print(f'[bold]{task.action}[/] succeeded')
            else:
                await monitor.failed(task.action)
                why = reached.error or reached.explanation
                self._console.print(f'[bold red]{task.action} failed[/]: {why}')
        return going_well, await monitor.outcome

    def _tell(self, verdict: PlanVerdict) -> None:
        self._console.print(verdict_line(verdict, self._start or 0))


def options(arguments: Sequence[str]) -> argparse.Namespace:
    """The options on the command line."""
    parser = argparse.ArgumentParser(
        prog='uav_plan', description='Monitors a simulated vehicle that executes a plan.'
    )
    parser.add_argument(
        '--plan', default='delivery', help='delivery, or a YAML file (default: delivery)'
    )
    parser.add_argument(
        '--scenario',
        default='delivery',
        help='delivery, windy_delivery, or a YAML file (default: delivery)',
    )
    parser.add_argument('--log-level', default='info', help='of the nodes (default: info)')
    return parser.parse_args(arguments)


def main() -> int:
    """The executable uav_plan."""
    chosen = options(remove_ros_args(sys.argv)[1:])
    with tempfile.TemporaryDirectory(prefix='uav_plan_') as temporary:
        folder = Path(temporary)
        try:
            mission = load_mission(plan_path(chosen.plan))
            path = scenario_path(chosen.scenario)
            scenario = load_scenario(path)
            rclpy.init()
            with Launcher(folder, log_level=chosen.log_level) as launcher:
                flight = MonitoredMission(mission, scenario, path, launcher, folder)
                return 0 if flight.run() else 1
        except DyKnowError as error:
            print(f'uav_plan: {error}', file=sys.stderr)  # noqa: T201 - there is no node yet
            return 1
        except (KeyboardInterrupt, ExternalShutdownException):
            return 130
        finally:
            rclpy.try_shutdown()
