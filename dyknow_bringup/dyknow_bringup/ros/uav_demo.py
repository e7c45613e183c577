"""The demonstration: a simulated UAV fleet, all nodes of DyKnow, and a live table of verdicts.

It ends by itself. Exit code 0: every verdict is what the scenario says, 1: one is not, 2: error.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.live import Live

from dyknow_bringup.demonstration import summary, unexpected
from dyknow_bringup.monitored_formula import formula_table
from dyknow_bringup.resources import scenario_names, scenario_path
from dyknow_bringup.ros.fleet_demo import FLEET, FleetDemonstration
from dyknow_bringup.ros.formula_monitor import FormulaMonitor
from dyknow_bringup.ros.scenario_run import INSTEAD_OF_ROS_ARGUMENTS, ScenarioRun, run_scenario
from dyknow_bringup.simulation.recording import write_flight_report
from dyknow_common import SECOND_NS
from dyknow_common.executables import describe
from dyknow_common.ros import command_main
from dyknow_configuration import RequestedFormula
from dyknow_recordings import Judgement, MonitoringFiles, PictureFiles
from dyknow_recordings.reporting.outputs import check_place, optional_library

SETTLING_NS = SECOND_NS
"""Time after the end of the scenario in which verdicts may still come."""


class Demonstration(ScenarioRun):
    """A run in which the formulas of the demonstration are monitored.

    Args:
        page: the file to write about the formulas over the flight; None for none.
        **settings: see `ScenarioRun`.
    """

    def __init__(self, *, page: Path | None, **settings: Any) -> None:
        if page is not None:
            check_place('--report', page)
        self._page = page
        self._pictures = PictureFiles(page, None, Judgement.AUTO)
        super().__init__(**settings)

    def _monitor(self) -> bool:
        monitor = FormulaMonitor(on_change=lambda _: None)
        self._executor.add_node(monitor)
        try:
            self._wait_for(lambda: monitor.is_running, 'the coordinator')
            self._start_simulation()
            self._show(monitor)
            return self._report(monitor)
        finally:
            self._executor.remove_node(monitor)
            monitor.destroy_node()

    def _show(self, monitor: FormulaMonitor) -> None:
        duration = self._scenario.duration + SETTLING_NS
        with Live(console=self._console, refresh_per_second=4) as live:
            while (elapsed := self._node.now() - self._start) < duration:
                self._spin()
                live.update(formula_table(monitor.formulas, self._start, elapsed))
        monitor.cancel_all()
        self._wait_for(lambda: monitor.has_ended, 'the end of the evaluations')

    def _report(self, monitor: FormulaMonitor) -> bool:
        problems = unexpected(monitor.formulas, self._scenario.expected, self._start)
        self._console.print()
        self._console.print(summary(self._scenario.name, problems))
        if self._page is not None:
            self._write_page(self._page, [each.formula for each in monitor.formulas])
        return not problems

    def _write_page(self, page: Path, formulas: Sequence[RequestedFormula]) -> None:
        """Check the formulas over a recording of the same flight."""
        configuration = self._configuration
        files = MonitoringFiles(
            configuration.ontologies, configuration.annotations, configuration.streams
        )
        with self._console.status('writing the report'):
            write_flight_report(
                self._scenario,
                self._vehicles,
                self._start,
                files,
                formulas,
                self._folder,
                self._pictures,
            )
        self._console.print(f'Report, to open in a browser: {page.resolve()}', soft_wrap=True)


def demo(options: argparse.Namespace) -> int:
    """Run the demonstration; the exit code is 0 if every verdict is what the scenario says."""
    if options.scenario == FLEET:
        optional_library('zenoh', f'the scenario {FLEET}', 'eclipse-zenoh')
        return run_scenario(
            lambda launcher, folder: FleetDemonstration(launcher, folder, options.log_level),
            options.log_level,
            options.logs,
        )
    scenario_path(options.scenario, FLEET)
    return run_scenario(
        lambda launcher, folder: Demonstration(
            page=options.report,
            scenario=options.scenario,
            vehicles=options.uavs,
            launcher=launcher,
            folder=folder,
            markers=options.markers,
            processes=options.processes,
        ),
        options.log_level,
        options.logs,
    )


def add_demo_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.set_defaults(command=demo, instead_of_ros_arguments=INSTEAD_OF_ROS_ARGUMENTS)
    describe(
        parser,
        'Monitor a simulated UAV fleet with DyKnow.',
        (
            'dyknow demo',
            'dyknow demo --scenario near_miss --uavs 5 --report report.html',
            'dyknow demo --processes --logs log/demo',
            'dyknow demo --scenario fleet',
        ),
        '0 if every verdict is what the scenario says, 1 if one is not, 2 for an error',
    )
    parser.add_argument(
        '--scenario',
        default='power_surge',
        help=f'{", ".join(scenario_names())}, or a YAML file; {FLEET}: four hosts and a link that '
        'fails (default: power_surge)',
    )
    parser.add_argument('--uavs', type=int, default=3, help='number of vehicles (default: 3)')
    parser.add_argument('--markers', action='store_true', help='show formulas in rviz2 or Foxglove')
    parser.add_argument(
        '--report', type=Path, metavar='FILE', help='write a page about the flight at the end'
    )
    parser.add_argument(
        '--processes',
        action='store_true',
        help='run each node in a process of its own (default: all in one)',
    )
    parser.add_argument('--log-level', default='info', help='of the nodes (default: info)')
    parser.add_argument(
        '--logs', type=Path, help='folder for the logs of the nodes (default: a temporary one)'
    )


def main() -> int:
    """Run the executable uav_demo."""
    return command_main('uav_demo', add_demo_options)
