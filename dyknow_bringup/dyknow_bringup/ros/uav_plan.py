"""A simulated vehicle executes a plan, which DyKnow monitors: which action went wrong, and why.

It ends by itself. Exit code 0: no violation and every action succeeded, 1: otherwise, 2: error.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.markup import escape

from dyknow_bringup.demonstration import plan_table, verdict_line
from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.resources import plan_path
from dyknow_bringup.ros.scenario_run import INSTEAD_OF_ROS_ARGUMENTS, ScenarioRun, run_scenario
from dyknow_bringup.simulation.missions import load_mission
from dyknow_common import SECOND_NS, Verdict
from dyknow_common.executables import describe
from dyknow_common.ros import command_main
from dyknow_coordinator import PlanOutcome
from dyknow_coordinator.ros import FormulaClient, PlanMonitor

VEHICLES = 2


class MonitoredMission(ScenarioRun):
    """A run in which a vehicle executes a plan.

    Args:
        plan: the name of a shipped plan, or the path of a YAML file.
        scenario: a scenario in which the vehicle flies as the plan says.
        launcher: starts the processes.
        folder: the folder for the files of the run.
    """

    def __init__(self, plan: str, scenario: str, launcher: Launcher, folder: Path) -> None:
        self._mission = load_mission(plan_path(plan))
        super().__init__(scenario, VEHICLES, launcher, folder, markers=False)

    def _monitor(self) -> bool:
        with FormulaClient(self._node) as client:
            monitor = client.monitor_plan(
                self._mission.plan,
                on_verdict=lambda each: self._console.print(verdict_line(each, self._start)),
            )
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
        """Execute and report the actions; return True if all succeeded, and the outcome."""
        succeeded = True
        for task in self._mission.tasks:
            if not succeeded:
                # An action after a failed one is never started.
                await monitor.failed(task.action)
                continue
            action = escape(task.action)
            self._console.print(f'[bold]{action}[/] starts')
            await monitor.started(task.action)
            answer = await client.evaluate(task.goal, timeout=task.within / SECOND_NS)
            succeeded = answer.verdict is Verdict.TRUE
            if succeeded:
                await monitor.succeeded(task.action)
                self._console.print(f'[bold]{action}[/] succeeded')
            else:
                await monitor.failed(task.action)
                reason = answer.error or answer.explanation
                self._console.print(f'[bold red]{action} failed[/]: {escape(str(reason))}')
        return succeeded, await monitor.outcome


def plan(options: argparse.Namespace) -> int:
    """Execute a plan; the exit code is 0 if no rule was violated and every action succeeded."""
    return run_scenario(
        lambda launcher, folder: MonitoredMission(options.plan, options.scenario, launcher, folder),
        options.log_level,
    )


def add_plan_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.set_defaults(command=plan, instead_of_ros_arguments=INSTEAD_OF_ROS_ARGUMENTS)
    describe(
        parser,
        'Monitor a simulated vehicle that executes a plan.',
        ('uav_plan', 'uav_plan --scenario windy_delivery'),
        '0 if nothing was violated and every action succeeded, 1 otherwise, 2 for an error',
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


def main() -> int:
    """Run the executable uav_plan."""
    return command_main('uav_plan', add_plan_options)
