"""A running DyKnow for tests: real nodes in a private ROS domain."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces.msg import ExitStatus, StreamStatusArray
from dyknow_interfaces.srv import EvaluateFormula, ListStreams
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from batteries import Batteries
from domains import reserve_domain
from dyknow_bringup.processes.composition import NODES, composed
from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.processes import (
    Process,
    SystemConfiguration,
    dyknow_processes,
)
from dyknow_bringup.processes.robot import fleet_configuration, requested_streams
from dyknow_bringup.simulation.vehicle import vehicle_names
from dyknow_common.ros import (
    LATCHED,
    RUNNING,
    SERVICE,
    STARTED_AT,
    STATUS,
    nanoseconds_to_duration,
)
from dyknow_configuration import ParameterValue

PATIENCE = 3.0
"""Seconds after which a request that is not answered is sent again."""

LIMIT = 100.0
"""Seconds after which a wait has failed; on a machine with nothing else to do it takes a few."""

NOTICED = 15.0
"""Seconds after which callers know that a node is gone: 5 on an idle machine, and fewer than what
ends a wait otherwise, which is a timeout."""

POLL = 0.1
"""Seconds between two looks where a look is a request to a node: waits leave it the processor."""


def private_environment() -> dict[str, str]:
    """Variables for processes that nobody else on this machine or network shall hear."""
    return {
        'ROS_DOMAIN_ID': str(reserve_domain()),
        # A process that is killed may leave locks in shared memory, for which others wait then.
        # With the range LOCALHOST, rmw_fastrtps would add shared memory to any other transport.
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SYSTEM_DEFAULT',
        'FASTRTPS_DEFAULT_PROFILES_FILE': str(LOOPBACK),
    }


LOOPBACK = Path(__file__).with_name('loopback.xml')

SHORT_LEASE = """\
        <discovery_config>
          <leaseDuration><sec>5</sec></leaseDuration>
          <leaseAnnouncement><sec>1</sec></leaseAnnouncement>
        </discovery_config>
"""


def short_lease_of(folder: Path) -> dict[str, str]:
    """Variables for processes whose end the middleware notices within 5 s rather than 20 s."""
    profile = folder / 'short_lease.xml'
    before, builtin, after = LOOPBACK.read_text(encoding='utf-8').partition('<builtin>\n')
    profile.write_text(f'{before}{builtin}{SHORT_LEASE}{after}', encoding='utf-8')
    return {'FASTRTPS_DEFAULT_PROFILES_FILE': str(profile)}


@contextmanager
def spinning(node: Node, executor: Any) -> Iterator[None]:
    """Run the callbacks of a node in a thread that ends before its executor.

    A callback that is running would meet a guard condition that was destroyed.
    """
    executor.add_node(node)
    has_ended = threading.Event()

    def spin() -> None:
        while not has_ended.is_set():
            executor.spin_once(timeout_sec=POLL)

    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    try:
        yield
    finally:
        has_ended.set()
        thread.join()
        executor.shutdown()


class Client:
    """A node in the test's own process.

    Args:
        environment: variables of its processes.
        check: raises an error if a process has ended by itself: then no wait is of use any more.
    """

    def __init__(
        self, environment: dict[str, str], check: Callable[[], None] = lambda: None
    ) -> None:
        os.environ.update(environment)
        self._check = check
        self.context = Context()
        rclpy.init(context=self.context, domain_id=int(environment['ROS_DOMAIN_ID']))
        self.node = Node('test_client', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._clients: dict[str, Any] = {}

    def close(self) -> None:
        """Leaves the ROS graph."""
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def spin_until(
        self,
        condition: Callable[[], bool],
        what: str,
        limit: float = LIMIT,
        instead: Callable[[], object] | None = None,
        pause: float = 0.0,
    ) -> None:
        """Run callbacks until a condition holds; fail the test if it does not within a limit.

        Args:
            condition: is evaluated after each callback.
            what: names the condition.
            limit: seconds.
            instead: describes what there is as long as the condition does not hold.
            pause: seconds between two evaluations of a condition that costs much.
        """
        end = time.monotonic() + limit
        next_check = time.monotonic() + POLL
        while not condition():
            now = time.monotonic()
            if now > end:
                found = '' if instead is None else f'; there is {instead()}'
                raise AssertionError(f'not within {limit} s: {what}{found}')
            if now > next_check:
                self._check()
                next_check = now + POLL
            self.executor.spin_once(timeout_sec=0.05)
            while time.monotonic() < now + pause:
                self.executor.spin_once(timeout_sec=max(now + pause - time.monotonic(), 0.0))

    def wait(self, seconds: float) -> None:
        """Runs callbacks for a time."""
        end = time.monotonic() + seconds
        self.spin_until(lambda: time.monotonic() > end, 'time', seconds + LIMIT)

    def collect(self, message_type: Any, topic: str, quality_of_service: Any = 10) -> list[Any]:
        """The messages of a topic, as they come."""
        messages: list[Any] = []
        self.node.create_subscription(message_type, topic, messages.append, quality_of_service)
        return messages

    def request(self, service_type: Any, service: str, **fields: Any) -> Any:
        """Sends a request and returns the future of its response."""
        if service not in self._clients:
            self._clients[service] = self.node.create_client(
                service_type, service, qos_profile=SERVICE
            )
        client = self._clients[service]
        self.spin_until(client.service_is_ready, f'service {service}')
        return client.call_async(service_type.Request(**fields))

    def result(self, future: Any, what: str, limit: float = LIMIT) -> Any:
        """The result of a future, which `what` names."""
        self.spin_until(future.done, what, limit)
        return future.result()

    def call(self, service_type: Any, service: str, limit: float = LIMIT, **fields: Any) -> Any:
        """The response of a service."""
        future = self.request(service_type, service, **fields)
        return self.result(future, f'answer of {service}', limit)

    def wait_for_coordinator(self) -> None:
        """Waits until the coordinator has found all nodes that it needs."""
        said: list[str] = []
        listener = self.node.create_subscription(
            DiagnosticStatus,
            'stream_reasoning_coordinator/_status',
            lambda status: said.append(status.message),
            STATUS,
        )
        self.spin_until(lambda: said[-1:] == [RUNNING], f'the coordinator runs: {said}')
        self.node.destroy_subscription(listener)


SOON_NOTICED: Mapping[str, Mapping[str, ParameterValue]] = {
    'stream_reasoning_coordinator': {'silence_limit': 2.5},
    'stream_reasoning_engine': {'progress_period': 0.2},
    # On a busy computer, messages without stamps take longer than the default.
    'stream_processing_engine': {'default_transport_delay': 2.0},
}
"""Parameters with which silence and progress are reported sooner than by default."""

ALWAYS = 'forall u in UAV: always Power[u] < 150'
"""A formula that fails once a battery gives more."""

SOON = 'forall u in UAV: always[0 s, 500 ms] Power[u] < 150'
"""A formula that becomes true soon."""

SPARES = ('spare1', 'spare2', 'uav3')
"""Batteries that come into use while formulas are evaluated."""


class KillingLauncher(Launcher):
    """A launcher that also ends single processes, by the names of their nodes."""

    def kill(self, name: str) -> None:
        running = self._running.pop(name)
        os.killpg(running.pid, signal.SIGKILL)
        running.wait()

    def stop(self, name: str) -> int:
        """Stop a process, and return its exit code."""
        running = self._running.pop(name)
        with suppress(ProcessLookupError):
            os.killpg(running.pid, signal.SIGTERM)
        return running.wait(LIMIT)


class System:
    """All seven nodes of DyKnow, configured for a fleet, and a client.

    Args:
        folder: for configuration and logs.
        vehicles: how many.
        use_sim_time: whether time comes from /clock.
        parameters: of nodes, by their names, where they differ from the defaults.
        short_lease: whether it is noticed within seconds that a node was killed.
        spares: names of batteries beside those of the vehicles.
        composition: whether one process, `dyknow_nodes`, has all nodes; else tests may kill
            each of them.
    """

    def __init__(
        self,
        folder: Path,
        vehicles: int = 2,
        *,
        use_sim_time: bool = False,
        parameters: Mapping[str, Mapping[str, ParameterValue]] | None = None,
        short_lease: bool = False,
        spares: tuple[str, ...] = (),
        composition: bool = True,
    ) -> None:
        self.environment = private_environment()
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        self._parameters = parameters or {}
        self.vehicles = vehicle_names(vehicles)
        self.configuration = fleet_configuration(self.vehicles)
        self.launcher = KillingLauncher(
            folder,
            environment={**self.environment, **(short_lease_of(folder) if short_lease else {})},
            use_sim_time=use_sim_time,
        )
        self.client = Client(self.environment, self.launcher.check_running)
        self._spares = spares
        self._composition = composition

    @cached_property
    def batteries(self) -> Batteries:
        """The batteries of the vehicles and the spare ones, published from the first use on."""
        return Batteries(self.client, self.environment, (*self.vehicles, *self._spares))

    def __enter__(self) -> Self:
        for executable in self.processes:
            self.start(executable)
        try:
            self.client.wait_for_coordinator()
            self.wait_for_streams()
        except BaseException:
            self.client.close()
            self.launcher.stop_all()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        if 'batteries' in self.__dict__:
            self.batteries.close()
        self.client.close()
        for process in self.running.values():
            process.send_signal(signal.SIGCONT)
        codes = self.launcher.stop_all(LIMIT)
        assert set(codes.values()) <= {0}, f'exit codes of the nodes: {codes}'

    @cached_property
    def processes(self) -> dict[str, Process]:
        """The processes by the names of their executables."""
        nodes = [
            replace(each, parameters={**each.parameters, **self._parameters.get(each.name, {})})
            for each in dyknow_processes(self.configuration)
        ]
        processes = composed(nodes, {}) if self._composition else nodes
        return {each.executable: each for each in processes}

    def start(self, executable: str, **parameters: ParameterValue) -> None:
        """Starts a node."""
        process = self.processes[executable]
        process = replace(process, parameters={**process.parameters, **parameters})
        self.running[executable] = self.launcher.start(process)

    @contextmanager
    def stopped(self, *executables: str) -> Iterator[None]:
        """Nodes that do nothing for a while, and do not even notice."""
        for executable in executables:
            self.running[executable].send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            for executable in executables:
                self.running[executable].send_signal(signal.SIGCONT)

    def pause(self, executable: str, seconds: float) -> None:
        """Stop a node for some time, which does not become longer if this process has to wait."""
        node = self.running[executable].pid
        script = f'kill -STOP {node}; sleep {seconds}; kill -CONT {node}'
        with subprocess.Popen(['sh', '-c', script]) as pausing:
            self.client.spin_until(lambda: pausing.poll() is not None, f'the pause of {executable}')

    @contextmanager
    def killed(self, executable: str) -> Iterator[None]:
        """A node that is killed, and started again afterwards."""
        self.launcher.kill(executable)
        try:
            yield
        finally:
            self.restart(executable)

    def restart(self, executable: str, **parameters: ParameterValue) -> None:
        """Starts a node that was killed, and waits until it is heard of.

        For a while the services of the killed one still look ready.
        """
        begun = time.time_ns()
        births: list[int] = []

        def note(status: DiagnosticStatus) -> None:
            births.extend(int(each.value) for each in status.values if each.key == STARTED_AT)

        node = 'stream_reasoning_coordinator' if executable == NODES else executable
        listener = self.client.node.create_subscription(
            DiagnosticStatus, f'{node}/_status', note, STATUS
        )
        self.start(executable, **parameters)
        self.client.spin_until(lambda: max(births, default=0) > begun, f'{executable} is back')
        self.client.node.destroy_subscription(listener)

    def streams(self) -> set[str]:
        """The streams that flow.

        A request may go to a manager that was killed: then it is asked again.
        """
        end = time.monotonic() + LIMIT
        while True:
            answer = self.client.request(ListStreams, 'stream_manager/list_streams')
            again = time.monotonic() + PATIENCE
            self.client.spin_until(
                lambda: answer.done() or time.monotonic() > min(again, end),  # noqa: B023
                'a list of streams',
            )
            if answer.done():
                return set(answer.result().stream_names)
            assert time.monotonic() < end, f'the stream manager has not answered within {LIMIT} s'

    def engines(self) -> set[str]:
        """The stream processing engines that the stream manager knows."""
        heard: list[StreamStatusArray] = []
        listener = self.client.node.create_subscription(
            StreamStatusArray, 'stream_manager/streams', heard.append, LATCHED
        )
        self.client.spin_until(lambda: bool(heard), 'what the stream manager tells')
        self.client.node.destroy_subscription(listener)
        return set(heard[-1].engines)

    def wait_until_running(self, future: Any) -> None:
        """Waits until the state stream of an evaluation flows."""
        self.client.spin_until(
            lambda: future.done() or self.streams() > self.fleet_streams,
            'the state stream',
            pause=POLL,
        )
        assert not future.done(), f'answered already: {future.result()}'

    def wait_for_streams(self) -> None:
        """Waits until the streams of the fleet, and no others, are made."""
        self.client.spin_until(
            lambda: self.streams() == self.fleet_streams,
            'just the streams of the fleet',
            pause=POLL,
        )

    @property
    def fleet_streams(self) -> set[str]:
        """The streams that the configuration asks for."""
        return requested_streams(self.configuration)

    def evaluate(self, formula: str, timeout: float = LIMIT, **fields: Any) -> Any:
        """The coordinator's answer to a formula."""
        future = self.ask(formula, timeout, **fields)
        return self.client.result(future, f'answer to {formula}', timeout + LIMIT)

    def decided(self, future: Any, verdict: int) -> Any:
        """Wait for the answer to a formula, which must have a verdict; return it."""
        answer = self.client.result(future, 'the verdict')
        assert_decided(answer, verdict)
        return answer

    def ask(self, formula: str, timeout: float = LIMIT, **fields: Any) -> Any:
        """The future of the coordinator's answer to a formula."""
        return self.client.request(
            EvaluateFormula,
            'stream_reasoning_coordinator/evaluate_formula',
            formula=formula,
            timeout=nanoseconds_to_duration(round(timeout * 1e9)),
            **fields,
        )


def assert_decided(answer: Any, verdict: int) -> None:
    """Assert that an answer has a verdict, and no error."""
    assert answer.exit_status.code == ExitStatus.SUCCESS, answer.exit_status.message
    assert answer.verdict == verdict, answer


class SharedSystem:
    """The running system of this process, which successive test modules may share."""

    def __init__(self, make_folder: Callable[[str], Path]) -> None:
        self._make_folder = make_folder
        self._options: dict[str, Any] = {}
        self._system: System | None = None
        self.folder: Path | None = None
        """The folder of its configuration and logs."""

    def get(self, **options: Any) -> System:
        """Return a running system with these options: the present one if it has them."""
        if self._system is None or self._options != options:
            self.stop()
            self.folder = self._make_folder('system')
            self._system = System(self.folder, **options).__enter__()
            self._options = options
        return self._system

    def stop(self) -> None:
        """Stop the system, if one runs; all its nodes must end with exit code 0."""
        if self._system is not None:
            running, self._system = self._system, None
            running.__exit__(None, None, None)


__all__ = [
    'ALWAYS',
    'SOON',
    'Batteries',
    'Client',
    'SharedSystem',
    'System',
    'SystemConfiguration',
    'assert_decided',
    'private_environment',
]
