"""Bytes and latency between two hosts: shared features, beside the same topics bridged raw.

    python benchmarks/federation_link.py [--seconds 20] [--robots 3]

Both ways cross zenoh on loopback at the same time, as for the fleet of examples/fleet: each robot
publishes odometry and its battery 20 times a second. A bridge, such as zenoh-bridge-ros2dds, sends
each message as it is serialised; the federation sends the features X, Y and Charge, which the base
station asks for: the robots share X and Y at 20 Hz, or at `--every`, and Charge each second. Prints
JSON: payload bytes for a robot and a second in both directions, the time from a sample to its
arrival at the base station, in milliseconds, and the share of a core for a robot, its messages and
its part of the base station.
"""

from __future__ import annotations

import argparse
import json
import math
import socket
import sys
import tempfile
import threading
import time
from pathlib import Path
from statistics import median, quantiles
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from sensor_msgs.msg import BatteryState

from dyknow_common import SECOND_NS, parse_duration
from dyknow_configuration import RequestedFederation
from dyknow_federation import Peer, PeerSettings, SharedFeature, ValueKnown, encode
from dyknow_federation.ros.transport import ZenohTransport

PERIOD_NS = SECOND_NS // 20
ZENOH = '{scouting: {multicast: {enabled: false}}}'
FEATURES = ('X', 'Y', 'Charge')


def feature(robot: str, name: str) -> SharedFeature:
    """Return a shared feature of a robot."""
    return SharedFeature(name, (robot,), f'{name}_{robot}', 'float')


class Host:
    """A peer with its transport, which a thread runs.

    Args:
        federation: its name and endpoints.
    """

    def __init__(self, federation: RequestedFederation) -> None:
        self.peer = Peer(PeerSettings(federation.name, time.time_ns()))
        self.lock = threading.Lock()
        self.latencies: list[int] = []
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
            self._due.wait(max(wait, 0) / SECOND_NS)

    def _act(self, effects: Any) -> None:
        now = time.time_ns()
        for packet in effects.packets:
            self.transport.send(packet.receiver, encode(packet), is_urgent=False)
        for event in effects.events:
            if isinstance(event, ValueKnown):
                self.latencies.append(now - event.time)


def messages(robot: int, now: int) -> tuple[dict[str, float], list[bytes]]:
    """Return the features of a robot at a time, and its serialised messages."""
    elapsed = now / SECOND_NS
    odometry, battery = Odometry(), BatteryState(percentage=0.8, voltage=24.0)
    odometry.header.frame_id, odometry.child_frame_id = 'odom', 'base_link'
    position = odometry.pose.pose.position
    position.x, position.y = robot * math.cos(0.2 * elapsed), robot * math.sin(0.2 * elapsed)
    values = {'X': position.x, 'Y': position.y, 'Charge': 0.8}
    return values, [serialize_message(odometry), serialize_message(battery)]


def run(robots: int, seconds: float, every: int) -> dict[str, Any]:
    """Run the fleet for some time, and return the figures."""
    with socket.socket() as found:
        found.bind(('127.0.0.1', 0))
        end = f'tcp/127.0.0.1:{found.getsockname()[1]}'
    with tempfile.TemporaryDirectory() as folder:
        zenoh = Path(folder, 'zenoh.json5')
        zenoh.write_text(ZENOH)
        names = [f'robot{number}' for number in range(1, robots + 1)]
        base = Host(RequestedFederation('base', listen=(end,), zenoh=zenoh))
        hosts = {
            name: Host(RequestedFederation(name, connect=(end,), zenoh=zenoh)) for name in names
        }
        raw_latencies: list[int] = []
        topic = base.transport.session.declare_subscriber(
            'raw/**',
            lambda sample: raw_latencies.append(
                time.time_ns() - int.from_bytes(bytes(sample.attachment), 'big')
            ),
        )
        raw_bytes = drive(base, hosts, seconds, every)
        figures = {
            'robots': robots,
            'seconds': seconds,
            'every_ms': every / 1e6,
            'raw_bytes_per_s': round(raw_bytes / robots / seconds),
            'bytes_per_s': round(crossed(base, hosts) / robots / seconds),
            'raw_latency_ms': times(raw_latencies),
            'latency_ms': times(base.latencies),
        }
        topic.undeclare()
        for each in (base, *hosts.values()):
            each.close()
    figures['ratio'] = round(figures['bytes_per_s'] / figures['raw_bytes_per_s'], 3)
    return figures


def drive(base: Host, hosts: dict[str, Host], seconds: float, every: int) -> int:
    """Publish both ways for some time; return the bytes of the raw messages."""
    for name, host in hosts.items():
        with host.lock:
            host.peer.share((), [feature(name, each) for each in FEATURES], time.time_ns())
        with base.lock:
            for each in FEATURES:
                base.peer.request(name, f'{each}_{name}', time.time_ns())
    base.wake()
    time.sleep(2)  # Until all are joined.
    base.latencies.clear()
    before = crossed(base, hosts)
    begin, raw = time.time_ns(), 0
    for step in range(round(seconds * SECOND_NS / PERIOD_NS)):
        time.sleep(max(begin + step * PERIOD_NS - time.time_ns(), 0) / SECOND_NS)
        for number, (name, host) in enumerate(hosts.items(), 1):
            now = time.time_ns()
            values, serialised = messages(number, now)
            for index, data in enumerate(serialised):
                host.transport.session.put(
                    f'raw/{name}/{index}', data, attachment=time.time_ns().to_bytes(8, 'big')
                )
                raw += len(data)
            with host.lock:
                for each, value in values.items():
                    rate = SECOND_NS if each == 'Charge' else every
                    if step % max(rate // PERIOD_NS, 1):
                        host.peer.promise(f'{each}_{name}', now, now)
                    else:
                        host.peer.publish(f'{each}_{name}', now, value, now)
            host.wake()
    for host in (base, *hosts.values()):
        host.transport.sent[''] -= before if host is base else 0
    return raw


def crossed(base: Host, hosts: dict[str, Host]) -> int:
    """Return the bytes that all hosts have sent."""
    return sum(each.transport.sent.total() for each in (base, *hosts.values()))


def times(latencies: list[int]) -> dict[str, float]:
    """Return the median and the 99th percentile, in milliseconds."""
    found = [each / 1e6 for each in latencies]
    return {'median': round(median(found), 2), 'p99': round(quantiles(found, n=100)[-1], 2)}


def main() -> int:
    """Print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=20.0)
    parser.add_argument('--robots', type=int, default=3)
    parser.add_argument('--every', default='0 ms', help='of X and Y (default: every sample)')
    options = parser.parse_args()
    print(json.dumps(run(options.robots, options.seconds, parse_duration(options.every))))
    return 0


if __name__ == '__main__':
    sys.exit(main())
