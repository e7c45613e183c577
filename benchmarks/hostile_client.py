"""A hostile client: requests and messages that harm the nodes if these have no limits.

python benchmarks/hostile_client.py SEED ROW...

It performs the rows at random until it is killed, and prints a line of JSON for each outcome.
"""

from __future__ import annotations

import json
import os
import random
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from dyknow_interfaces.msg import ExitStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future

from dyknow_configuration import PACKAGES

ANSWER_TIMEOUT_S = 10.0
"""Time after which a request counts as unanswered."""

SERVICE_TIMEOUT_S = 5.0
"""Time to find a service."""

MATCH_TIMEOUT_S = 1.0
"""Time to find the subscribers of a topic, which may have none."""

DISCOVERY_S = 1.0
PAUSE_S = 0.3

REQUESTS = QoSProfile(depth=10_000)
"""Its own queue loses no request."""

ANY_SUBSCRIBER = QoSProfile(
    depth=1000,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""Quality of service that matches every subscriber."""

NODES = tuple(PACKAGES)


class HostileClient:
    """A node for hostile requests, which counts the answers."""

    def __init__(self, seed: int) -> None:
        rclpy.init()
        self.node = rclpy.create_node(f'hostile_{os.getpid()}')
        self.chance = random.Random(seed)  # noqa: S311
        self._row = ''
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._clients: dict[str, Any] = {}
        self._open: set[Future] = set()

    def ask(self, kind: Any, service: str, request: Any = None, **fields: Any) -> Future | None:
        """Send a request and return the future of its answer, or None if there is no service."""
        client = self._clients.get(service)
        if client is None:
            client = self.node.create_client(kind, service, qos_profile=REQUESTS)
            self._clients[service] = client
        if not self.spin_until(client.service_is_ready, SERVICE_TIMEOUT_S):
            self.count('no service')
            return None
        future = client.call_async(request if request is not None else kind.Request(**fields))
        self.watch(future)
        return future

    def watch(self, future: Future) -> None:
        """Count the answer of a future when it is done."""
        begun = time.monotonic()
        self._open.add(future)

        def end(done: Future) -> None:
            if done not in self._open:
                return  # It counts as unanswered already.
            self._open.discard(done)
            status = getattr(done.result(), 'exit_status', None)
            outcome = 'answered' if status is None else f'code {status.code}'
            if status is not None and status.code == ExitStatus.INTERNAL_ERROR:
                outcome = f'INTERNAL_ERROR: {status.message[:300]}'
            self.count(outcome, seconds=time.monotonic() - begun)

        future.add_done_callback(end)

    def call(self, kind: Any, service: str, **fields: Any) -> Any:
        """Send a request and return its answer, None if there is none in time."""
        future = self.ask(kind, service, **fields)
        self.wait_for_answers()
        return future.result() if future is not None and future.done() else None

    def spin_until(self, condition: Callable[[], bool], limit: float) -> bool:
        """Run callbacks until a condition holds, and return True if it does in time."""
        end = time.monotonic() + limit
        while not condition():
            if time.monotonic() > end:
                return False
            self._executor.spin_once(timeout_sec=0.02)
        return True

    def wait(self, seconds: float) -> None:
        """Run callbacks for a time."""
        self.spin_until(lambda: False, seconds)

    def wait_for_answers(self) -> None:
        """Wait for the answers of all requests, and count those that do not come in time."""
        self.spin_until(lambda: not self._open, ANSWER_TIMEOUT_S)
        if self._open:
            self.count('unanswered', len(self._open))
            self._open.clear()

    def count(self, outcome: str, number: int = 1, seconds: float = 0.0) -> None:
        """Report outcomes of the row, at once: this client may be killed at any moment."""
        line = {'row': self._row, 'outcome': outcome, 'number': number, 'seconds': seconds}
        print(json.dumps(line), flush=True)

    def publish(
        self,
        kind: Any,
        topic: str,
        messages: Sequence[Any],
        pause: float = 0.0,
        quality: QoSProfile = ANY_SUBSCRIBER,
    ) -> None:
        """Publish messages, or bytes as messages, to all subscribers of a topic."""
        publisher = self.node.create_publisher(kind, topic, quality)
        self.spin_until(lambda: publisher.get_subscription_count() > 0, MATCH_TIMEOUT_S)
        published = 0
        for message in messages:
            try:
                publisher.publish(message)
                published += 1
            except rclpy_implementation.RCLError:
                # The middleware of the client refuses some bytes itself.
                self.count('not published')
            self.wait(pause)
        self.count('published', published)
        self.wait(0.1)
        self.node.destroy_publisher(publisher)

    def perform(self, name: str, row: Callable[[HostileClient], None]) -> None:
        """Perform a row, and wait for its answers."""
        self._row = name
        self.count('begun')
        try:
            row(self)
        except Exception:  # noqa: BLE001 - a fault of this program is reported, not hidden
            self.count(f'fault: {traceback.format_exc()}')
        self.wait_for_answers()
        self.count('completed')


def main() -> None:
    """Perform rows at random until this process is killed."""
    from hostile_rows import ROWS  # noqa: PLC0415 - it imports this module

    seed, *names = sys.argv[1:]
    os.nice(10)  # The nodes are to be judged, not the share of the machine that this client takes.
    client = HostileClient(int(seed))
    client.wait(DISCOVERY_S)
    while True:
        name = client.chance.choice(names)
        client.perform(name, ROWS[name])
        client.wait(client.chance.uniform(0.0, PAUSE_S))


if __name__ == '__main__':
    main()
