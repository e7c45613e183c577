"""Packets cross between peers over zenoh, and access control keeps others out."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from importlib.util import find_spec
from pathlib import Path

import pytest
import rclpy
from std_msgs.msg import String

from dyknow_common import DyKnowError
from dyknow_common.ros import LATCHED
from dyknow_configuration import RequestedFederation
from dyknow_federation.peer import MAX_PEERS
from dyknow_federation.ros.federation import SIMULATED, Federation
from dyknow_federation.ros.transport import PREFIX, ZenohTransport

pytestmark = pytest.mark.skipif(find_spec('zenoh') is None, reason='zenoh is not installed')

EXAMPLES = Path(__file__).parents[3] / 'docs' / 'examples' / 'federation'
ALONE = '{scouting: {multicast: {enabled: false}}, connect: {retry: {period_init_ms: 100}}}'
LIMIT_S = 60.0


def free_port() -> int:
    with socket.socket() as found:
        found.bind(('127.0.0.1', 0))
        return int(found.getsockname()[1])


def wait_until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


class Network:
    """Transports that connect to the first one.

    Args:
        protocol: of the links.
    """

    def __init__(self, protocol: str) -> None:
        self.end = f'{protocol}/127.0.0.1:{free_port()}'
        self.received: dict[str, set[tuple[str, bytes]]] = {}
        self.transports: dict[str, ZenohTransport] = {}
        self.stack = ExitStack()

    def add(self, label: str, name: str, zenoh: Path) -> None:
        first = not self.transports
        ends = {'listen' if first else 'connect': (self.end,)}
        federation = RequestedFederation(name, zenoh=zenoh, peer_timeout=0, **ends)
        transport = ZenohTransport(federation, time.time_ns, lambda: None)
        self.transports[label] = self.stack.enter_context(closing(transport))
        self.received[label] = set()

    def send(self, label: str, receiver: str, data: bytes) -> None:
        self.transports[label].send(receiver, data, is_urgent=False)

    def take(self) -> None:
        for label, transport in self.transports.items():
            self.received[label] |= {(each.sender, each.data) for each in transport.take()}


@pytest.fixture
def network(request: pytest.FixtureRequest) -> Iterator[Network]:
    found = Network(request.param)
    with found.stack:
        yield found


@pytest.mark.parametrize('network', ['tcp'], indirect=True)
def test_packets_reach_those_that_they_are_for(network: Network, tmp_path: Path) -> None:
    file = tmp_path / 'zenoh.json5'
    file.write_text(ALONE)
    for name in ('base', 'carrier1', 'carrier2'):
        network.add(name, name, file)

    def have_come() -> bool:
        network.send('base', '', b'all')
        network.send('base', 'carrier1', b'one')
        network.send('carrier1', 'base', b'back')
        network.take()
        return all(network.received.values()) and len(network.received['carrier1']) > 1

    wait_until(have_come)
    assert network.received == {
        'base': {('carrier1', b'back')},
        'carrier1': {('base', b'all'), ('base', b'one')},
        'carrier2': {('base', b'all')},
    }
    assert network.transports['base'].sent['carrier1'] >= len(b'one')


@pytest.mark.parametrize('network', ['tcp'], indirect=True)
def test_senders_that_were_never_peers_keep_no_other_one_out(
    network: Network, tmp_path: Path
) -> None:
    file = tmp_path / 'zenoh.json5'
    file.write_text(ALONE)
    network.add('base', 'base', file)
    network.add('strange', 'strange', file)

    def have_come(name: str) -> bool:
        network.transports['strange'].session.put(f'{PREFIX}/{name}/all', b'?')
        network.take()
        return (name, b'?') in network.received['base']

    wait_until(lambda: have_come('first'))
    for number in range(MAX_PEERS + 1):
        have_come(f'p{number}')
    wait_until(lambda: have_come('last'))


@pytest.mark.parametrize('is_simulated', [False, True])
@pytest.mark.parametrize('network', ['tcp'], indirect=True)
def test_a_host_in_simulated_time_has_no_peers(
    network: Network, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, is_simulated: bool
) -> None:
    """Its clock goes in steps, so nothing bounds its difference to another one."""
    file = tmp_path / 'zenoh.json5'
    file.write_text(ALONE)
    network.add('base', 'base', file)
    robot = tmp_path / 'robot.yaml'
    ends = f'name: carrier1, connect: {network.end}, zenoh: {file}'
    robot.write_text(f'federation: {{{ends}}}\n')
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'OFF')
    given = (f'robot:={robot}', f'use_sim_time:={str(is_simulated).lower()}')
    rclpy.init(args=['--ros-args', *(word for each in given for word in ('-p', each))])
    node = Federation()
    reports: list[dict[str, object]] = []
    topic = 'federation/federation'
    node.create_subscription(
        String, topic, lambda message: reports.append(json.loads(message.data)), LATCHED
    )

    def is_reported() -> bool:
        rclpy.spin_once(node, timeout_sec=0.1)
        network.take()
        return bool(reports and (is_simulated or network.received['base']))

    try:
        wait_until(is_reported)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    assert (SIMULATED in reports[-1]['faults']) is is_simulated
    assert bool(network.received['base']) is not is_simulated


@pytest.mark.skipif(shutil.which('openssl') is None, reason='openssl is not installed')
@pytest.mark.parametrize('network', ['tls'], indirect=True)
def test_the_documented_access_control(network: Network, tmp_path: Path) -> None:
    """Without a certificate there is no link, and a certificate is good for its own name alone."""
    names = ('basestation', 'carrier1', 'carrier2')
    script = EXAMPLES / 'certificates.sh'
    subprocess.run([script, tmp_path, *names], check=True, capture_output=True)

    def configured(name: str, example: str, *changes: tuple[str, str]) -> Path:
        text = (EXAMPLES / f'{example}.json5').read_text()
        for before, after in (('/etc/dyknow', str(tmp_path)), *changes):
            assert before in text
            text = text.replace(before, after)
        path = tmp_path / f'{name}.json5'
        path.write_text(text)
        return path

    network.add('base', 'basestation', configured('basestation', 'basestation'))
    network.add('carrier1', 'carrier1', configured('carrier1', 'carrier1'))
    other = configured('other', 'carrier1', ('carrier1.', 'carrier2.'))
    network.add('disguised', 'carrier1', other)
    lines = ('connect_certificate', 'connect_private_key')
    text = (tmp_path / 'carrier1.json5').read_text().splitlines()
    bare = tmp_path / 'bare.json5'
    bare.write_text('\n'.join(each for each in text if not each.strip().startswith(lines)))
    network.add('bare', 'carrier2', bare)

    def have_come() -> bool:
        for label in ('carrier1', 'disguised', 'bare'):
            network.send(label, 'basestation', label.encode())
        network.send('base', '', b'all')
        network.send('base', 'carrier1', b'one')
        network.take()
        found = network.received
        return len(found['carrier1']) > 1 and bool(found['disguised']) and bool(found['base'])

    wait_until(have_come)
    for _ in range(10):
        have_come()
    assert network.received == {
        'base': {('carrier1', b'carrier1')},
        'carrier1': {('basestation', b'all'), ('basestation', b'one')},
        # It has the certificate of carrier2, which may read what is for all.
        'disguised': {('basestation', b'all')},
        'bare': set(),
    }
    faults = {label: each.link_fault() for label, each in network.transports.items()}
    refused = faults.pop('bare')
    assert refused.startswith(f'there is no link to {network.end}')
    assert 'certificate' in refused
    assert not any(faults.values())


@pytest.mark.parametrize('network', ['tcp'], indirect=True)
def test_a_missing_link_is_reported_once_it_is_missed(network: Network, tmp_path: Path) -> None:
    file = tmp_path / 'zenoh.json5'
    file.write_text(ALONE)
    times = iter((0, 99, 100, 200, 201))
    settings = RequestedFederation('carrier1', (network.end,), zenoh=file, peer_timeout=100)
    with closing(ZenohTransport(settings, lambda: next(times), lambda: None)) as carrier:
        assert not carrier.link_fault()
        assert carrier.link_fault()
        network.add('base', 'base', file)
        wait_until(lambda: bool(carrier.session.info.peers_zid()))
        assert not carrier.link_fault()
        network.transports['base'].close()
        wait_until(lambda: not carrier.session.info.peers_zid())
        assert not carrier.link_fault()


@pytest.mark.parametrize(
    ('ends', 'text', 'message'),
    [
        (('foo/127.0.0.1:1',), ALONE, 'zenoh cannot start: .*foo'),
        ((), '{scouting: ', 'is no configuration of zenoh'),
    ],
)
def test_a_wrong_configuration_is_explained(
    tmp_path: Path, ends: tuple[str, ...], text: str, message: str
) -> None:
    file = tmp_path / 'zenoh.json5'
    file.write_text(text)
    with pytest.raises(DyKnowError, match=message):
        ZenohTransport(
            RequestedFederation('a', listen=ends, zenoh=file), time.time_ns, lambda: None
        )
