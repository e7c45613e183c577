"""Nodes of DyKnow started by hand, and a client that knows of them only what is documented."""

from __future__ import annotations

import re
import signal
import subprocess
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces.msg import ExitStatus
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float64

from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.processes import Process
from dyknow_configuration import PACKAGES
from system import LIMIT, Client, private_environment

LATCHED = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Late subscribers receive the last message, too."""

SERVICES = {
    'stream_processing_engine': {'StreamCreateFromSpec', 'StreamDestroy', 'ListStreams'},
    'stream_manager': {
        'StreamCreateFromSpec', 'StreamDestroy', 'ListStreams', 'StreamRegister', 'StreamGetTopic',
    },
    'ontology_manager': {
        'ConceptCreate', 'ConceptGetInstances', 'ConceptDestroy', 'InstanceCreate',
        'InstanceGetConcepts', 'InstanceDestroy', 'OntologyLoad', 'OntologyQuery',
    },
    'stream_semantics_manager': {
        'AddSemanticSpecification', 'RemoveSemanticSpecification', 'ListSemanticSpecifications',
    },
    'semantic_matching_engine': {'FindAllMatchingStreams'},
    'stream_reasoning_engine': {
        'FormulaGroupCreate', 'FormulaGroupAddFormula', 'FormulaGroupEvaluate',
        'FormulaGroupExtractSymbols', 'FormulaGroupRemoveFormula', 'FormulaGroupDestroy',
    },
    'stream_reasoning_coordinator': {'CancelEvaluation', 'EvaluateFormula', 'ReportPlanAction'},
}  # fmt: skip
"""The types of the services of each node."""


def service_name(node: str, service_type: str) -> str:
    """`StreamGetTopic` of a node is `/node/stream_get_topic`."""
    return f'/{node}/' + re.sub(r'\B([A-Z])', r'_\1', service_type).lower()


def nanoseconds(time: Any) -> int:
    """Of a Time or a Duration."""
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


def time_of(nanoseconds: int) -> Time:
    """A Time."""
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    return Time(sec=seconds, nanosec=rest)


def assert_refused(status: Any, code: int, *words: str) -> None:
    """Asserts that a request was refused, with a message that says what matters."""
    assert status.code == code, status
    for word in words:
        assert word in status.message
    if '^' in words:
        *_, line, caret = status.message.splitlines()
        assert caret.strip() == '^'
        assert len(caret) <= len(line) + 1


class Nodes:
    """Nodes in processes of their own, in a private ROS domain, and a client.

    Args:
        folder: for what they print.
        executables: the nodes, each with its parameters.
    """

    def __init__(self, folder: Path, **executables: dict[str, Any]) -> None:
        environment = private_environment()
        self._launcher = Launcher(folder, environment=environment)
        self.client = Client(environment, self._launcher.check_running)
        self.environment = environment
        self._folder = folder
        self._subscriptions: list[Any] = []
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        for executable, parameters in executables.items():
            self.start(executable, parameters)

    def __enter__(self) -> Self:
        with ExitStack() as undoing:
            undoing.push(self)
            heard = [
                self.collect(DiagnosticStatus, f'/{node}/_status', LATCHED)
                for node in self.processes
            ]
            self.client.spin_until(lambda: all(heard), 'all nodes are up')
            undoing.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close()
        codes = self._launcher.stop_all(LIMIT)
        assert set(codes.values()) <= {0}, f'exit codes of the nodes: {codes}'

    def start(self, node: str, parameters: Mapping[str, Any] | None = None) -> None:
        """Starts a node, also one that was killed."""
        process = Process(PACKAGES[node], node, parameters or {})
        self.processes[node] = self._launcher.start(process)

    def log(self, node: str) -> list[str]:
        """The lines that a node has logged so far."""
        return (self._folder / f'{node}.log').read_text().splitlines()

    def kill(self, node: str) -> None:
        """Ends a node without warning."""
        self._launcher.kill(node)

    def stop(self, number: signal.Signals) -> dict[str, int]:
        """Sends a signal to each process, and returns their exit codes."""
        for process in self.processes.values():
            process.send_signal(number)
        return {name: process.wait(LIMIT) for name, process in self.processes.items()}

    def collect(self, message_type: Any, topic: str, quality_of_service: Any = 100) -> list[Any]:
        """The messages of a topic, as they come."""
        messages: list[Any] = []
        self._subscriptions.append(
            self.client.node.create_subscription(
                message_type, topic, messages.append, quality_of_service
            )
        )
        return messages

    def stop_collecting(self) -> None:
        """End the collection of all topics."""
        while self._subscriptions:
            self.client.node.destroy_subscription(self._subscriptions.pop())

    def request(self, node: str, service_type: Any, **fields: Any) -> Any:
        """The future of the response of a service."""
        name = service_name(node, service_type.__name__)
        return self.client.request(service_type, name, **fields)

    def call(self, node: str, service_type: Any, **fields: Any) -> Any:
        """The response of a service, whatever its exit status."""
        future = self.request(node, service_type, **fields)
        response = self.client.result(future, f'answer of {node}')
        assert response.exit_status.message or not response.exit_status.code
        return response

    def obtain(self, node: str, service_type: Any, **fields: Any) -> Any:
        """The response of a service, which must be a success."""
        response = self.call(node, service_type, **fields)
        assert response.exit_status.code == ExitStatus.SUCCESS, response.exit_status.message
        return response


class Telemetry:
    """Publishes an odometry with a header and a level without, fifty times a second."""

    def __init__(self, client: Client) -> None:
        self.altitudes: dict[int, float] = {}
        self._node = client.node
        self._odometry = client.node.create_publisher(Odometry, '/robot/odometry', 10)
        self._level = client.node.create_publisher(Float64, '/tank/level', 10)
        self._timer = client.node.create_timer(0.02, self._publish)

    def stop(self) -> None:
        """Falls silent."""
        self._timer.cancel()

    def _publish(self) -> None:
        now = self._node.get_clock().now()
        message = Odometry()
        message.header.stamp = now.to_msg()
        message.pose.pose.position.z = self.altitudes[now.nanoseconds] = len(self.altitudes) / 2
        self._odometry.publish(message)
        self._level.publish(Float64(data=0.5))
