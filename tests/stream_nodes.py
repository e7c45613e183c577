"""Stream managers and any number of engines for tests, by names and in namespaces of one's own."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces import srv
from dyknow_interfaces.msg import ExitStatus, Sample, StreamSpec, StreamStatusArray
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float64

from commands import command, started
from system import LIMIT, PATIENCE, Client, private_environment

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TANK = '/tank/level'


class StreamNodes:
    """Nodes of streams by their full names, a tank that publishes its level, and a client.

    Args:
        folder: for what the nodes print.
    """

    def __init__(self, folder: Path) -> None:
        self.environment = private_environment()
        self.client = Client(self.environment, self._check_running)
        self.report = StreamStatusArray()
        self.status = DiagnosticStatus()
        self._folder = folder
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._samples: dict[str, int] = {}
        node = self.client.node
        node.create_subscription(StreamStatusArray, '/stream_manager/streams', self._hear, LATCHED)
        node.create_subscription(
            DiagnosticStatus, '/stream_manager/_status', self._hear_status, LATCHED
        )
        self._tank = node.create_publisher(Float64, TANK, 10)
        self._timer = node.create_timer(0.02, lambda: self._tank.publish(Float64(data=0.5)))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close()
        for running in self._running.values():
            running.send_signal(signal.SIGCONT)
            running.terminate()
        codes = {name: running.wait(LIMIT) for name, running in self._running.items()}
        printed = {log.name: log.read_text() for log in self._folder.glob('*.log')}
        assert set(codes.values()) <= {0}, f'exit codes of the nodes: {codes}; {printed}'

    def start(self, name: str, executable: str = 'stream_processing_engine', **given: Any) -> None:
        """Starts a node by its full name, with parameters."""
        namespace, _, own = name.rpartition('/')
        arguments = ['--ros-args', '-r', f'__node:={own}', '-r', f'__ns:={namespace or "/"}']
        for parameter, value in given.items():
            arguments += ['-p', f'{parameter}:={value}']
        with (self._folder / f'{own}.log').open('ab') as log:
            self._running[name] = started(
                command(executable, *arguments), self.process_environment(),
                stdout=log, start_new_session=True,
            )  # fmt: skip

    def process_environment(self) -> dict[str, str]:
        """The variables of a process in the domain of these nodes."""
        return {**os.environ, **self.environment}

    def start_manager(self, **given: Any) -> None:
        """Starts the stream manager, and waits until it speaks."""
        self.report = StreamStatusArray()
        self.start('/stream_manager', 'stream_manager', **given)
        begun = self.client.node.get_clock().now().nanoseconds
        self.until(
            lambda: self.report.stamp.sec * 10**9 + self.report.stamp.nanosec > begun,
            'the manager speaks',
        )

    def kill(self, name: str) -> None:
        """Ends a node without warning."""
        running = self._running.pop(name)
        running.kill()
        running.wait()

    def end(self, name: str) -> int:
        """Waits until a node has ended by itself, and returns its exit code."""
        return self._running.pop(name).wait(LIMIT)

    def signal(self, name: str, number: signal.Signals) -> None:
        """Sends a node a signal."""
        self._running[name].send_signal(number)

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Waits for a condition."""
        self.client.spin_until(
            condition, what, instead=lambda: f'{self.report}\n{self.status} of the manager'
        )

    def wait_for_engines(self, *names: str) -> None:
        """Waits until the manager knows just these engines."""
        self.until(lambda: list(self.report.engines) == sorted(names), f'engines {names}')

    def create(self, name: str, text: str, node: str = '/stream_manager') -> Any:
        """Has a stream made; its exit status must be a success."""
        answer = self.call(
            node, srv.StreamCreateFromSpec, spec=StreamSpec(name=name, specification=text)
        )
        assert answer.exit_status.code == ExitStatus.SUCCESS, answer.exit_status.message
        return answer

    def request(self, node: str, service_type: Any, **fields: Any) -> Any:
        """The future of an answer."""
        return self.client.request(service_type, f'{node}/{_snake(service_type)}', **fields)

    def call(self, node: str, service_type: Any, **fields: Any) -> Any:
        """The answer of a node that lives; a killed one of its name may be asked in vain.

        A request must not be repeated while the manager waits for an engine that does not answer.
        """
        end = time.monotonic() + LIMIT
        while True:
            future = self.request(node, service_type, **fields)
            again = time.monotonic() + 5 * PATIENCE
            self.until(lambda: future.done() or time.monotonic() > again, 'an answer')  # noqa: B023
            if future.done():
                return future.result()
            assert time.monotonic() < end, f'{node} does not answer'

    def listen(self, *topics: str) -> None:
        """Counts the samples of topics from now on."""
        for topic in topics:
            self._samples[topic] = 0
            self.client.node.create_subscription(
                Sample, topic, lambda _, topic=topic: self._count(topic), 100
            )

    def wait_for_samples(self) -> None:
        """Waits until each topic that is listened to has new samples."""
        before = dict(self._samples)
        self.until(
            lambda: all(count >= before[topic] + 3 for topic, count in self._samples.items()),
            f'samples beyond {before}',
        )

    def engines_of(self) -> dict[str, str]:
        """The engine of each stream that flows, as the manager says."""
        return {
            each.name: each.engine for each in self.report.streams if each.state == each.FLOWING
        }

    def wait_until_flowing(self, *names: str, off: str = '') -> None:
        """Waits until streams are made, by other engines than one."""
        self.until(
            lambda: (
                self.engines_of().keys() >= set(names) and off not in self.engines_of().values()
            ),
            f'{names} flow, none of them from {off or "nowhere"}',
        )

    def _check_running(self) -> None:
        for name, running in self._running.items():
            assert running.poll() is None, f'{name} ended with exit code {running.returncode}'

    def _count(self, topic: str) -> None:
        self._samples[topic] += 1

    def _hear(self, report: Any) -> None:
        self.report = report

    def _hear_status(self, status: Any) -> None:
        self.status = status


def _snake(service_type: Any) -> str:
    name = service_type.__name__
    return ''.join(f'_{c.lower()}' if c.isupper() else c for c in name).lstrip('_')
