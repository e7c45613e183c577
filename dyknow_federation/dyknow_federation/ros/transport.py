"""The way of packets between hosts: zenoh, which discovers, routes, batches, and controls access.

Each peer publishes on keys that begin with its name. So zenoh's access control can decide, by the
certificate of a peer, which keys it may write and read:

    dyknow/federation/carrier1/all                  signs of life
    dyknow/federation/carrier1/to/basestation       everything else
"""

from __future__ import annotations

import json
import re
from collections import Counter, deque
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from dyknow_common import DyKnowError, ExitCode, listed, one_line
from dyknow_configuration import RequestedFederation
from dyknow_federation.encoding import MAX_PACKET
from dyknow_federation.errors import FederationError

PREFIX: Final = 'dyknow/federation'

MAX_WAITING: Final = 10_000
"""The number of packets that may wait for the node; more are dropped, and asked for again."""

_KEY: Final = re.compile(f'{PREFIX}/([^/]+)/(?:all|to/[^/]+)')


class ReceivedPacket(NamedTuple):
    """The bytes of a packet, the peer whose key they came on, and when, in nanoseconds."""

    sender: str
    data: bytes
    received_at: int


class ZenohTransport:
    """Session of zenoh that sends and receives packets.

    Args:
        federation: the name of this host, endpoints, and a file of zenoh's configuration.
        now: returns the time in nanoseconds; it is called in threads of zenoh.
        wake: has the node take the packets that wait; it is called in threads of zenoh.

    Raises:
        DyKnowError: if zenoh is missing or its configuration is wrong, or an endpoint is taken.
    """

    def __init__(
        self, federation: RequestedFederation, now: Callable[[], int], wake: Callable[[], None]
    ) -> None:
        self.sent: Counter[str] = Counter()
        """Numbers of bytes by the names of peers; bytes sent to all count for the empty name."""
        self.dropped = 0
        """The number of packets that came while too many waited, or were too long."""
        self._name = federation.name
        self._connect = federation.connect
        self._timeout = federation.peer_timeout
        self._now = now
        self._linked_at = now()
        self._wake = wake
        self._waiting: deque[ReceivedPacket] = deque()
        self._zenoh = _zenoh()
        self._publishers: dict[tuple[str, bool], Any] = {}
        try:
            self.session = self._zenoh.open(self._configuration(federation))
            keys = (f'{PREFIX}/*/all', f'{PREFIX}/*/to/{self._name}')
            declare = self.session.declare_subscriber
            self._subscribers = [declare(key, self._receive) for key in keys]
        except self._zenoh.ZError as error:
            raise FederationError(
                f'zenoh cannot start: {one_line(error)}; see the key federation of the robot.yaml, '
                'and its zenoh file',
                ExitCode.UNAVAILABLE,
            ) from None

    def send(self, receiver: str, data: bytes, *, is_urgent: bool) -> None:
        """Send a packet to a peer, or to all if the name is empty; an urgent one never waits."""
        key = receiver, is_urgent
        if key not in self._publishers:
            self._publishers[key] = self._publisher(receiver, is_urgent=is_urgent)
        self._publishers[key].put(data)
        self.sent[receiver] += len(data)

    def take(self) -> list[ReceivedPacket]:
        """Return the packets that have come since the last call."""
        return [self._waiting.popleft() for _ in range(len(self._waiting))]

    def link_fault(self) -> str:
        """Return that a link has been missing for `peer_timeout`; empty if none is missed.

        zenoh logs neither a link that the other host refuses nor one that it refuses itself.
        """
        info, now = self.session.info, self._now()
        if not self._connect or info.peers_zid() or info.routers_zid():
            self._linked_at = now
            return ''
        if now - self._linked_at < self._timeout:
            return ''
        return (
            f'there is no link to {listed(self._connect)}; check the address, that the host is '
            'there, and for tls, that each of both has a certificate that the other one accepts'
        )

    def forget(self, peer: str) -> None:
        """Free what was needed to send to a peer."""
        self.sent.pop(peer, None)
        for key in [key for key in self._publishers if key[0] == peer]:
            self._publishers.pop(key).undeclare()

    def close(self) -> None:
        """End the session."""
        self.session.close()

    def _configuration(self, federation: RequestedFederation) -> Any:
        file = federation.zenoh
        try:
            configuration = self._zenoh.Config.from_file(file) if file else self._zenoh.Config()
        except self._zenoh.ZError as error:
            text = f'{file} is no configuration of zenoh: {one_line(error)}'
            raise FederationError(text) from None
        for key in ('connect', 'listen'):
            if endpoints := getattr(federation, key):
                configuration.insert_json5(f'{key}/endpoints', json.dumps(endpoints))
        return configuration

    def _publisher(self, receiver: str, *, is_urgent: bool) -> Any:
        priority = self._zenoh.Priority
        return self.session.declare_publisher(
            f'{PREFIX}/{self._name}/' + (f'to/{receiver}' if receiver else 'all'),
            # What a congested link loses, the receiver asks for again; the node must not wait.
            congestion_control=self._zenoh.CongestionControl.DROP,
            reliability=self._zenoh.Reliability.RELIABLE,
            priority=priority.INTERACTIVE_HIGH if is_urgent else priority.DATA,
            express=is_urgent,
            allowed_destination=self._zenoh.Locality.REMOTE,
        )

    def _receive(self, sample: Any) -> None:
        """Take a packet in a thread of zenoh."""
        now = self._now()
        found = _KEY.fullmatch(str(sample.key_expr))
        if found is None:
            return
        data = sample.payload
        if len(data) > MAX_PACKET or len(self._waiting) >= MAX_WAITING:
            self.dropped += 1
            return
        self._waiting.append(ReceivedPacket(found[1], bytes(data), now))
        self._wake()


def _zenoh() -> Any:
    """Return the library of zenoh, which is optional."""
    try:
        import zenoh  # noqa: PLC0415
    except ImportError:
        text = "the key 'federation' needs zenoh: pip install eclipse-zenoh"
        raise DyKnowError(text, ExitCode.UNAVAILABLE) from None
    return zenoh
