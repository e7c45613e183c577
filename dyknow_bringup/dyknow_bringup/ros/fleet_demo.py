"""The demonstration of several hosts: a fleet, its base station, and a link that fails.

The base station is in the ROS domain of the command, so `dyknow federation`, `dyknow evaluations`
and `dyknow dashboard` show it; each carrier has a domain after that.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

from dyknow_interfaces.srv import ListSemanticSpecifications
from rich.console import Group
from rich.live import Live
from rich.text import Text
from std_msgs.msg import String

from dyknow_bringup.demonstration import summary
from dyknow_bringup.monitored_formula import MonitoredFormula, formula_table
from dyknow_bringup.processes.composition import composed
from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.processes import (
    FEDERATION,
    Process,
    SystemConfiguration,
    carrier_simulation,
    dyknow_processes,
)
from dyknow_bringup.processes.robot import with_robot
from dyknow_bringup.resources import host_path
from dyknow_bringup.ros.formula_monitor import FormulaMonitor
from dyknow_bringup.ros.scenario_run import SystemRun
from dyknow_bringup.simulation.link import FailingLink, free_port
from dyknow_common import SECOND_NS, round_time, with_readable_times
from dyknow_common.ros import LATCHED, RemoteNode
from dyknow_configuration import RequestedFormula, read_robot
from dyknow_federation.report import FederationReport, federation_table

FLEET: Final = 'fleet'
"""The name of the scenario."""

BASE: Final = 'basestation'
CARRIERS: Final = ('carrier1', 'carrier2', 'carrier3')
"""The first one has the link that fails."""

SHARED: Final = len(('X', 'Y', 'Charge')) * len(CARRIERS)
"""The streams that the base station finds."""

BASE_PORT: Final = '7447'
"""The port of the base station in its robot.yaml; here, it has any free one."""

DOMAINS: Final = 102
"""ROS domains from 0 on; higher ones have ports that Linux gives to outgoing connections."""

RADIUS_M: Final = 2.0
"""The radius of the first carrier's circle, and the distance between two circles."""

HOSTS_TIMEOUT_S: Final = 120.0
VERDICT_TIMEOUT_S: Final = 120.0
BEFORE_S: Final = 1.0
"""From the first state to the failure of the link."""

OUTAGE_S: Final = 10.0

SOON: Final = RequestedFormula(
    'forall c in Carrier: always[0 s, 5 s] Charge[c] > 0.2',
    name='charged_for_5_s',
    description='No battery is empty within 5 s.',
)
"""The formula whose window is within the outage."""


class FleetDemonstration(SystemRun):
    """A run in which a verdict at the base station waits for a link.

    Args:
        launcher: starts the base station.
        folder: the folder for the files and the logs of the hosts.
        log_level: the log level of the nodes.
    """

    def __init__(self, launcher: Launcher, folder: Path, log_level: str) -> None:
        self._folder = folder
        domain = int(os.environ.get('ROS_DOMAIN_ID') or 0)
        self._hosts = {BASE: launcher}
        for number, name in enumerate(CARRIERS, 1):
            logs = folder / name
            logs.mkdir()
            variables = {'ROS_DOMAIN_ID': str((domain + number) % DOMAINS)}
            self._hosts[name] = Launcher(logs, log_level=log_level, environment=variables)
        super().__init__(*self._hosts.values())
        self._report = FederationReport(BASE)
        self._monitor: FormulaMonitor | None = None
        self._live: Live | None = None
        self._start = 0

    def _work(self) -> bool:
        self._node.create_subscription(String, f'{FEDERATION}/federation', self._on_report, LATCHED)
        port = free_port()
        for each in host_path(BASE).parent.glob('*.json5'):  # All hosts read them.
            (self._folder / each.name).write_bytes(each.read_bytes())
        with ExitStack() as stack:
            link = stack.enter_context(FailingLink(port))
            for name, launcher in self._hosts.items():
                stack.enter_context(launcher)
                end = link.port if name == CARRIERS[0] else port
                launcher.start_all(self._processes(name, end))
            with self._console.status('starting four hosts'):
                remote = RemoteNode(
                    self._node, 'stream_semantics_manager', patience_s=HOSTS_TIMEOUT_S
                )
                self._wait_for(lambda: self._knows_all(remote), 'the fleet', HOSTS_TIMEOUT_S)
            with self._monitored() as soon:
                problems = self._fail(link, soon)
            self._console.print()
            self._console.print(summary(FLEET, problems))
        return not problems

    def _processes(self, name: str, port: int) -> Iterator[Process]:
        """Yield the processes of a host, which listens at a port or connects to it."""
        path = host_path(name)
        robot = self._folder / path.name
        robot.write_text(path.read_text(encoding='utf-8').replace(BASE_PORT, str(port)), 'utf-8')
        configuration = with_robot(SystemConfiguration(), robot, monitor=False)
        yield from composed(dyknow_processes(configuration), os.environ)
        if name != BASE:
            yield carrier_simulation(name, RADIUS_M * (1 + CARRIERS.index(name)))

    def _knows_all(self, remote: RemoteNode) -> bool:
        listed = self._answer(remote, ListSemanticSpecifications, 'the base station')
        return len(listed.ssl_statements) == SHARED

    @contextmanager
    def _monitored(self) -> Iterator[MonitoredFormula]:
        """Monitor formulas on a live table in a block; yield the formula that is decided soon."""
        formulas = (*read_robot(host_path(BASE)).formulas, SOON)
        monitor = self._monitor = FormulaMonitor(formulas, lambda _: None, retries=True)
        self._executor.add_node(monitor)
        self._start = self._node.now()
        try:
            with Live(console=self._console, refresh_per_second=4) as self._live:
                yield monitor.formulas[-1]
                self._update()
        finally:
            self._live = None
            self._executor.remove_node(monitor)
            monitor.destroy_node()

    def _fail(self, link: FailingLink, soon: MonitoredFormula) -> dict[str, str]:
        """Let the link fail for some time; return how the verdict differs from the expected one."""
        self._tell(f'asked: {SOON.text}')
        self._wait_for(lambda: soon.has_states, 'the first state', HOSTS_TIMEOUT_S)
        self._spin_for(BEFORE_S)
        link.cut()
        self._tell(f'the link to {CARRIERS[0]} is cut')
        self._spin_for(OUTAGE_S)
        has_waited = not soon.is_decided
        self._tell('the verdict waits' if has_waited else 'the verdict has not waited')
        link.restore()
        self._tell('the link is back')
        self._wait_for(lambda: soon.is_decided, 'the verdict', VERDICT_TIMEOUT_S)
        reason = with_readable_times(soon.explanation, self._start)
        self._tell(f'{soon.outcome}: {reason}')
        if has_waited and soon.outcome == 'true':
            return {}
        when = 'after' if has_waited else 'before'
        return {soon.name: f'{soon.outcome} {when} the end of the outage instead of true after it'}

    def _spin(self) -> None:
        super()._spin()
        self._update()

    def _spin_for(self, duration_s: float) -> None:
        end = self._node.now() + round(duration_s * SECOND_NS)
        while self._node.now() < end:
            self._spin()

    def _update(self) -> None:
        if self._live is not None and self._monitor is not None:
            elapsed = self._node.now() - self._start
            table = formula_table(self._monitor.formulas, self._start, elapsed)
            self._live.update(Group(table, federation_table(self._report)))

    def _tell(self, text: str) -> None:
        elapsed = round_time(self._node.now() - self._start)
        self._console.print(Text(f'{elapsed:>9}  {text}'), soft_wrap=True)

    def _on_report(self, message: String) -> None:
        self._report = FederationReport.of(json.loads(message.data))
