"""Two hosts for tests: a DyKnow each, in ROS domains of their own, that zenoh joins."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

from dyknow_interfaces.srv import EvaluateFormula, ListSemanticSpecifications
from rclpy.duration import Duration
from sensor_msgs.msg import BatteryState
from std_msgs.msg import String

from dyknow_bringup.processes.composition import composed
from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.processes import SystemConfiguration, dyknow_processes
from dyknow_bringup.processes.robot import with_robot
from dyknow_common import StreamConstraints
from dyknow_common.ros import LATCHED, constraints_to_message, nanoseconds_to_duration
from dyknow_coordinator import Grounding
from dyknow_federation.report import FederationReport, LinkState
from system import LIMIT, Client, private_environment

CARRIER = """\
objects: {{Carrier: [{name}]}}
features:
  Charge:
    of: {{c: Carrier}}
    from: {{topic: '/{{c}}/battery', field: percentage, max_delay: 5 s, max_gap: 20 s}}
  Voltage:
    of: {{c: Carrier}}
    unit: V
    from: {{topic: '/{{c}}/battery', field: voltage, max_delay: 5 s}}
federation:
  name: {name}
  {ends}
  share: [Charge, Voltage]
  peer_timeout: 8 s
  # A busy machine answers late.
  max_uncertainty: 2 s
  zenoh: zenoh.json5
"""

BASE = """\
sorts: {{Vehicle: }}
features: {{Level: {{of: {{v: Vehicle}}}}}}
bridges: base.bridges
federation:
  name: base
  {ends}
  compared: {{Voltage: 10}}
  peer_timeout: 8 s
  # A busy machine answers late.
  max_uncertainty: 2 s
  zenoh: zenoh.json5
"""

BRIDGES = 'Carrier into Vehicle; Charge equivalent Level;'
"""They lead from the words of the carriers, which the base knows once these have joined."""

ZENOH = """\
{
  scouting: {multicast: {enabled: false}},
  connect: {retry: {period_init_ms: 200, period_max_ms: 500}},
}
"""
"""A configuration with which nobody but the other host is found."""


class Host:
    """A host: its DyKnow, from a robot.yaml, and a client.

    Args:
        folder: for the files and logs.
        robot: the text of the robot.yaml.
        zenoh: the text of zenoh's configuration.
    """

    def __init__(self, folder: Path, robot: str, zenoh: str = ZENOH) -> None:
        folder.mkdir()
        path = folder / 'robot.yaml'
        path.write_text(robot)
        (folder / 'zenoh.json5').write_text(zenoh)
        (folder / 'base.bridges').write_text(BRIDGES)
        processes = dyknow_processes(with_robot(SystemConfiguration(), path))
        self.processes = {each.executable: each for each in composed(processes, {})}
        environment = private_environment()
        self.launcher = Launcher(folder, environment=environment)
        self.client = Client(environment, self.launcher.check_running)
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        self.percentage = 0.9
        self.battery_age_s = 0.0
        self.voltage = 12.0
        self.has_battery = True
        self.reports: list[FederationReport] = []
        self.client.node.create_subscription(
            String,
            'federation/federation',
            lambda message: self.reports.append(FederationReport.of(json.loads(message.data))),
            LATCHED,
        )

    def __enter__(self) -> Self:
        for executable in self.processes:
            self.start(executable)
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close()
        codes = self.launcher.stop_all(LIMIT)
        assert set(codes.values()) <= {0}, f'exit codes of the nodes: {codes}'

    def start(self, executable: str) -> None:
        """Start a node."""
        self.running[executable] = self.launcher.start(self.processes[executable])

    def publish_battery(self, name: str) -> None:
        """Publish the battery of a carrier from now on, while the client spins."""
        node = self.client.node
        topic = node.create_publisher(BatteryState, f'/{name}/battery', 10)

        def publish() -> None:
            if not self.has_battery:
                return
            message = BatteryState(percentage=self.percentage, voltage=self.voltage)
            age = Duration(seconds=self.battery_age_s)
            message.header.stamp = (node.get_clock().now() - age).to_msg()
            topic.publish(message)

        node.create_timer(0.05, publish)

    def link_to(self, peer: str) -> LinkState | None:
        """Return the state of the link to a peer, as last reported; None if there is none."""
        peers = self.reports[-1].peers if self.reports else ()
        return next((each.state for each in peers if each.name == peer), None)

    def ask(self, formula: str, *, here: bool = False) -> Any:
        """Return the future of an answer; `here`: samples cross, not verdicts of peers."""
        constraints = StreamConstraints(max_gap=10**15 if here else None)
        return self.client.request(
            EvaluateFormula,
            '/stream_reasoning_coordinator/evaluate_formula',
            formula=formula,
            grounding=int(Grounding.SEMANTIC),
            constraints=constraints_to_message(constraints),
            timeout=nanoseconds_to_duration(round(LIMIT * 1e9)),
        )


def wait_for(asker: Host, *others: Host, until: Callable[[], bool], what: str) -> None:
    """Spin the clients of all hosts until a condition holds."""

    def condition() -> bool:
        for each in others:
            each.client.executor.spin_once(timeout_sec=0.0)
        return until()

    asker.client.spin_until(condition, what, 2 * LIMIT)


def wait_for_streams(number: int, asker: Host, *others: Host) -> None:
    """Wait until a host knows this number of streams of peers."""
    service = '/stream_semantics_manager/list_semantic_specifications'
    asked = asker.client.request(ListSemanticSpecifications, service)

    def are_known() -> bool:
        nonlocal asked
        if not asked.done():
            return False
        if len(asked.result().ssl_statements) == number:
            return True
        asked = asker.client.request(ListSemanticSpecifications, service)
        return False

    wait_for(asker, *others, until=are_known, what=f'{number} streams of peers')
