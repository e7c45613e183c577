"""Bytes and latency between two hosts: shared features, beside the same topics bridged raw.

python benchmarks/federation_link.py [--json] [--quick] [--robots 3]

Both ways cross zenoh on loopback at the same time, as for the fleet of examples/fleet: each robot
publishes odometry and its battery 20 times a second. A bridge, such as zenoh-bridge-ros2dds, sends
each message as it is serialised; the federation sends the features X, Y and Charge, which the base
station asks for, as each of `CASES` has it.

A row has payload bytes for a robot and a second in both directions, the time until a sample is
known at the base station, in milliseconds (with a deadband or constants, that of Charge alone), and
the processor time of Python in percent of a core, for a robot with its part of the base station.
"""

from __future__ import annotations

import math
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from nav_msgs.msg import Odometry
from parts import measure
from processes import percentile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import BatteryState

from dyknow_bringup.simulation.link import HERE, free_port
from dyknow_common import SECOND_NS, Alternatives, Value
from dyknow_configuration import RequestedFederation, RequestedShare
from dyknow_federation.encoding import encode
from dyknow_federation.events import ValueKnown
from dyknow_federation.messages import FormulaRequest, SharedFeature
from dyknow_federation.peer import Peer
from dyknow_federation.ros.transport import ZenohTransport

PERIOD_NS = SECOND_NS // 20
ZENOH = '{scouting: {multicast: {enabled: false}}}'
FEATURES = ('X', 'Y', 'Charge')
VERDICT = '_base_1'
PROMISES = 2
"""The steps between two promises of a verdict, as every 0.1 s of the federation node."""


@dataclass(frozen=True)
class Case:
    """How the robots share.

    Args:
        every: the period of X and Y, nanoseconds; 0 for every sample.
        deadband: of X and Y, in metres.
        compared: numbers with which the base station asks for X and Y to be compared.
        verdicts: True if the robots evaluate a formula about the three features, whose verdict
            crosses instead: another text each second.
    """

    every: int = 0
    deadband: float | None = None
    compared: tuple[float, ...] = ()
    verdicts: bool = False

    def features(self, robot: str) -> list[SharedFeature]:
        """Return the shared features of a robot."""
        return [
            SharedFeature(
                name, (robot,), f'{name}_{robot}', 'float', '',
                0.0 if name == 'Charge' else self.deadband or 0.0,
            )
            for name in FEATURES
        ]  # fmt: skip


CASES = {
    'X, Y at 20 Hz, Charge at 1 Hz': Case(),
    'X, Y with a deadband of 5 cm': Case(deadband=0.05),
    'X, Y at 2 Hz': Case(every=SECOND_NS // 2),
    'X, Y as compared with 0.5 m': Case(compared=(0.5,)),
    'the verdict of a formula about all three': Case(verdicts=True),
}


class Host:
    """A peer with its transport, which a thread runs.

    Args:
        federation: its name and endpoints.
    """

    def __init__(self, federation: RequestedFederation) -> None:
        self.peer = Peer(federation, time.time_ns())
        self.lock = threading.Lock()
        self.published: dict[tuple[str, Value], int] = {}
        """When the values of all hosts were published, by stream and value."""
        self.latencies: list[int] = []
        self.processor_ns = 0
        self.promised = 0
        """The time until which the verdict is known as it was told."""
        self._due = threading.Event()
        self.transport = ZenohTransport(federation, time.time_ns, self._due.set)
        self._is_over = False
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def wake(self) -> None:
        """Have the thread look for what is due."""
        self._due.set()

    def close(self) -> None:
        """End the thread and the session."""
        self._is_over = True
        self._due.set()
        self._thread.join()
        self.transport.close()

    def _run(self) -> None:
        while not self._is_over:
            self._due.clear()
            with self.lock:
                for each in self.transport.take():
                    self._act(self.peer.receive(each.data, time.time_ns(), each.sender))
                self._act(self.peer.advance(time.time_ns()))
                wait = self.peer.next_deadline() - time.time_ns()
                self.processor_ns = time.thread_time_ns()
            self._due.wait(max(wait, 0) / SECOND_NS)

    def _act(self, effects: Any) -> None:
        now = time.time_ns()
        for receiver, packet in effects.packets:
            self.transport.send(receiver, encode(packet), is_urgent=packet.is_urgent)
        for event in effects.events:
            if isinstance(event, ValueKnown):
                value = event.value
                if isinstance(value, Alternatives):
                    value = value.values[-1]
                if published := self.published.pop((event.stream, value), None):
                    self.latencies.append(now - published)


class Bridge:
    """The messages of all robots, as a bridge sends them.

    Args:
        session: of the base station.
    """

    def __init__(self, session: Any) -> None:
        self.latencies: list[int] = []
        self.bytes = 0
        self.processor_ns = 0
        self._subscription = session.declare_subscriber('raw/**', self._take)

    def send(self, session: Any, key: str, data: bytes) -> None:
        """Send a serialised message over the session of a robot."""
        began = time.thread_time_ns()
        session.put(f'raw/{key}', data, attachment=time.time_ns().to_bytes(8, 'big'))
        self.bytes += len(data)
        self.processor_ns += time.thread_time_ns() - began

    def close(self) -> None:
        """End the subscription."""
        self._subscription.undeclare()

    def _take(self, sample: Any) -> None:
        began = time.thread_time_ns()
        self.latencies.append(time.time_ns() - int.from_bytes(bytes(sample.attachment), 'big'))
        self.processor_ns += time.thread_time_ns() - began


def messages(robot: int, now: int) -> tuple[dict[str, float], list[bytes]]:
    """Return the features of a robot at a time, and its serialised messages."""
    elapsed = now / SECOND_NS
    charge = elapsed % 1  # No two samples are alike, so that the arrival of each one shows.
    odometry, battery = Odometry(), BatteryState(percentage=charge, voltage=24.0)
    odometry.header.frame_id, odometry.child_frame_id = 'odom', 'base_link'
    position = odometry.pose.pose.position
    position.x, position.y = robot * math.cos(0.2 * elapsed), robot * math.sin(0.2 * elapsed)
    values = {'X': position.x, 'Y': position.y, 'Charge': charge}
    return values, [serialize_message(odometry), serialize_message(battery)]


def link(*, robots: int, quick: bool) -> list[dict[str, Any]]:
    """Return a row for each case."""
    seconds = 4.0 if quick else 20.0
    return [{'case': name, **run(robots, seconds, case)} for name, case in CASES.items()]


def run(robots: int, seconds: float, case: Case) -> dict[str, Any]:
    """Run the fleet for some time, and return the figures."""
    end = f'tcp/{HERE}:{free_port()}'
    with ExitStack() as stack:
        zenoh = Path(stack.enter_context(tempfile.TemporaryDirectory()), 'zenoh.json5')
        zenoh.write_text(ZENOH)
        share = (
            *(RequestedShare(each, case.every, case.deadband) for each in ('X', 'Y')),
            RequestedShare('Charge', SECOND_NS),
        )
        base, *others = [
            stack.enter_context(closing(Host(each)))
            for each in (
                RequestedFederation('base', listen=(end,), zenoh=zenoh),
                *(
                    RequestedFederation(f'robot{each}', connect=(end,), share=share, zenoh=zenoh)
                    for each in range(1, robots + 1)
                ),
            )
        ]
        hosts = {f'robot{number}': each for number, each in enumerate(others, 1)}
        bridge = stack.enter_context(closing(Bridge(base.transport.session)))
        join(base, hosts, case)
        before = used((base, *others))
        drive(base, hosts, bridge, seconds, case)
        after = used((base, *others))
    spent = robots * seconds
    raw, shared = bridge.bytes / spent, (after[0] - before[0]) / spent
    return {
        'robots': robots,
        'raw_bytes_per_s': round(raw),
        'bytes_per_s': round(shared),
        'ratio': round(shared / raw, 3),
        'raw_latency_ms': times(bridge.latencies),
        'latency_ms': times(base.latencies),
        'raw_core_percent': round(bridge.processor_ns / SECOND_NS / spent * 100, 2),
        'core_percent': round((after[1] - before[1]) / SECOND_NS / spent * 100, 2),
    }


def join(base: Host, hosts: dict[str, Host], case: Case) -> None:
    """Have the base station ask for all features or verdicts, and wait until all robots know."""
    for name, host in hosts.items():
        with host.lock:
            host.peer.share((), case.features(name), time.time_ns())
        if case.verdicts:
            ask_formula(base, name, host)
            continue
        with base.lock:
            for each in FEATURES:
                constants = () if each == 'Charge' else case.compared
                base.peer.request(name, f'{each}_{name}', time.time_ns(), constants=constants)
    base.wake()
    streams = 1 if case.verdicts else len(FEATURES)
    while any(len(host.peer.sent) < streams for host in hosts.values()):
        time.sleep(0.1)
    time.sleep(2)  # Until all clocks are measured.


def ask_formula(base: Host, name: str, host: Host) -> None:
    """Have a robot evaluate a formula, and ask for its verdict."""
    parts = ' and '.join(f'{each}_{name}.value > -100' for each in FEATURES)
    while not host.peer.formulas:
        with base.lock:
            request = FormulaRequest(f'{VERDICT}_{name}', f'always ({parts})')
            base.peer.request_formula(name, request, time.time_ns())
        base.wake()
        time.sleep(0.5)
    with base.lock:
        base.peer.request(name, f'{VERDICT}_{name}', time.time_ns())


def publish_verdict(base: Host, name: str, host: Host, step: int, now: int) -> None:
    """Publish another text each second, and promise what a federation node does."""
    stream = f'{VERDICT}_{name}'
    if step % PROMISES == 0:
        host.promised = now - 1
    if step % round(SECOND_NS / PERIOD_NS) == 1:
        host.peer.publish(stream, host.promised + 1, f'true: {step}', now)
        host.promised = now - 1
        base.published[stream, f'true: {step}'] = now
    host.peer.promise(stream, host.promised, now)


def drive(base: Host, hosts: dict[str, Host], bridge: Bridge, seconds: float, case: Case) -> None:
    """Publish both ways for some time."""
    begin = time.time_ns()
    for step in range(round(seconds * SECOND_NS / PERIOD_NS)):
        time.sleep(max(begin + step * PERIOD_NS - time.time_ns(), 0) / SECOND_NS)
        for number, (name, host) in enumerate(hosts.items(), 1):
            now = time.time_ns()
            values, serialised = messages(number, now)
            for index, data in enumerate(serialised):
                bridge.send(host.transport.session, f'{name}/{index}', data)
            with host.lock:
                if case.verdicts:
                    publish_verdict(base, name, host, step, now)
                    values = {}
                for each, value in values.items():
                    stream = f'{each}_{name}'
                    host.peer.publish(stream, now, value, now)
                    if step:  # The first value is certain only after another one.
                        base.published[stream, value] = now
            host.wake()


def used(hosts: Sequence[Host]) -> tuple[int, int]:
    """Return the bytes that hosts have sent, and the processor time of their threads in ns."""
    sent = sum(each.transport.sent.total() for each in hosts)
    return sent, sum(each.processor_ns for each in hosts)


def times(latencies: Sequence[int]) -> dict[str, float]:
    """Return the median and the 99th percentile, in milliseconds."""
    found = [each / 1e6 for each in latencies]
    return {'median': round(median(found), 2), 'p99': round(percentile(found, 99), 2)}


if __name__ == '__main__':
    measure(__doc__, link, robots=3)
