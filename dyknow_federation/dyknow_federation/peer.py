"""The own host among its peers: takes packets and times, returns packets and events.

The machine has no clock, no network and no threads. Its host calls `receive` for each packet and
`advance` at `next_deadline`, sends the packets that both return, and acts on their events. Calls
that only ask for something, as `request` and `publish`, take effect at the next `advance`, which
they make due.

    peer = Peer(RequestedFederation('base'), incarnation=start)
    peer.request('carrier1', 'Charge_carrier1', at=now)
    effects = peer.advance(now)

All times are in nanoseconds of the own clock.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from itertools import chain, count
from typing import Final, NamedTuple

from dyknow_common import NANOSECONDS, Value, check_name
from dyknow_configuration import RequestedFederation, RequestedShare
from dyknow_federation import events, messages
from dyknow_federation.clocks import BEGINNING, NEVER
from dyknow_federation.encoding import MAX_MESSAGES, decode
from dyknow_federation.errors import FederationError
from dyknow_federation.events import PeerEvent
from dyknow_federation.messages import MAX_REASON, Message, Packet, Request, Shares, is_verdict
from dyknow_federation.push_down import streams_of
from dyknow_federation.remote import RemotePeer, hello_period
from dyknow_federation.sending import SentStream, Thinning

MAX_PEERS: Final = 1000
"""The most other peers that are known; peers that are asked before they are heard are extra."""

BATCH_DELAY: Final = 2 * NANOSECONDS['ms']
"""How long a sample waits for others to be sent with, in nanoseconds."""

WATERMARK_DELAY: Final = 50 * NANOSECONDS['ms']
"""How long a watermark without a sample waits, in nanoseconds."""

MAX_COMPARISONS: Final = 100
"""The number of lists of constants with which peers may ask for one stream."""

MAX_FORMULAS: Final = 100
"""The number of formulas that are evaluated for others."""

_Constants = tuple[float, ...]
"""With which peers compare the values of a stream; empty if they need all values."""


class Effects(NamedTuple):
    """The packets to send, each with its receiver (empty: all peers), and the events to act on."""

    packets: list[tuple[str, Packet]]
    events: list[PeerEvent]


@dataclass(frozen=True, slots=True)
class FormulaForPeer:
    """A formula that is evaluated for another peer.

    Args:
        asker: the peer.
        request: the request of the peer.
        streams: the streams that the formula is about.
        expires: when it ends, if its verdict is not requested before.
    """

    asker: str
    request: messages.FormulaRequest
    streams: frozenset[str]
    expires: int


class Peer:
    """The own host among its peers.

    Attributes:
        remotes: the other peers that are known, by their names.
        shares: what the own host shares; version 0 until it has found out. Until then, peers stay
            with what its former run shared, and get no answer to requests.
        sent: the own streams that others ask for, or did so for the time of the history, by their
            names and constants: `publish` their samples.
        formulas: that others have asked to evaluate, by the streams of their verdicts.

    Args:
        settings: its settings.
        incarnation: the number of this run, unique among all its runs, as the time of its start.

    Raises:
        FederationError: if it has no name, or one that is too long.
    """

    def __init__(self, settings: RequestedFederation, incarnation: int) -> None:
        if not settings.name:
            raise FederationError('a peer needs a name; set name')
        check_name(settings.name, FederationError)
        self._settings = settings
        self._incarnation = incarnation
        self._now = self._begun_at = BEGINNING
        self.shares = Shares(0 if settings.share else 1)
        self.remotes: dict[str, RemotePeer] = {}
        self.sent: dict[str, dict[_Constants, SentStream]] = {}
        self.formulas: dict[str, FormulaForPeer] = {}
        self._epochs = count(1)
        self._hello_at = self._flush_at = BEGINNING
        self._events: list[PeerEvent] = []
        self._unsent: dict[tuple[str, bool], list[Message]] = {}
        """By receiver and urgency: urgent messages have packets of their own."""
        self._faults_at: dict[str, int] = {}
        """When a fault was last reported, by peer; unknown senders share the empty name."""

    def given(self, peer: str) -> list[str]:
        """Return the names of the own streams that a peer receives."""
        return sorted(
            name
            for name, streams in self.sent.items()
            if any(peer in each.subscribers for each in streams.values())
        )

    def _named(self, stream: str) -> Iterable[SentStream]:
        return self.sent.get(stream, {}).values()

    def next_deadline(self) -> int:
        """Return when to call `advance`."""
        if self._unsent:
            return self._now
        deadlines = (each.next_deadline() for each in self.remotes.values())
        return min(self._hello_at, self._flush_at, *deadlines)

    def share(
        self,
        objects: Iterable[messages.SharedObject],
        features: Iterable[messages.SharedFeature],
        at: int,
    ) -> None:
        """Replace what the own host shares: nothing else is sent to anybody."""
        self.shares = Shares(self.shares.version + 1, tuple(objects), tuple(features))
        shared = {each.stream for each in self.shares.features}
        own = self.formulas.items()
        self.formulas = {name: each for name, each in own if each.streams <= shared}
        for name in self.sent.keys() - shared - self.formulas.keys():
            del self.sent[name]
        self._hello_at = at

    def publish(self, stream: str, valid_time: int, value: Value, at: int) -> None:
        """Send a sample of an own stream to all that have asked for it, unless it says too little.

        Raises:
            FederationError: if its valid time does not increase, or was excluded by `promise`.
        """
        for each in self._named(stream):
            delay = BATCH_DELAY if each.publish(valid_time, value) else WATERMARK_DELAY
            self._flush_at = min(self._flush_at, at + delay)

    def violate(self, stream: str, fault: messages.StreamFault, at: int) -> None:
        """Tell all that have asked for an own stream that it has a violation."""
        for each in self._named(stream):
            each.violate(fault)
            self._flush_at = min(self._flush_at, at + BATCH_DELAY)

    def explain(self, stream: str, reason: str) -> None:
        """Tell the peer that asked for the verdict of a formula why the formula has no states."""
        if stream in self.formulas:
            message = messages.FormulaWait(stream, reason[:MAX_REASON])
            self._send(self.formulas[stream].asker, message)

    def promise(self, stream: str, time: int, at: int) -> None:
        """Promise that all later samples of an own stream are valid after a time."""
        for each in self._named(stream):
            each.promise(time)
            self._flush_at = min(self._flush_at, at + WATERMARK_DELAY)

    def request(
        self,
        peer: str,
        stream: str,
        at: int,
        after: int = BEGINNING,
        constants: tuple[float, ...] = (),
    ) -> None:
        """Ask a peer for a stream until it is released; the peer need not be there yet.

        Values are told after `after`, or after `at` if that is earlier. If they are only compared
        with constants, in ascending order, the peer sends only samples that compare otherwise, and
        values are intervals between constants.

        Raises:
            FederationError: if constants are not as they must be.
        """
        Request(stream, constants=constants)  # Checks them.
        self._remote(peer, at).request(stream, at, min(after, at), constants)

    def request_formula(self, peer: str, request: messages.FormulaRequest, at: int) -> None:
        """Ask a peer to evaluate a formula; a `FormulaAnswered` follows.

        The caller must then request the stream of the verdict, within `peer_timeout` of the peer.
        """
        self._remote(peer, at).request_formula(request, at)

    def release(self, peer: str, stream: str) -> None:
        """Ask a peer for a stream no more."""
        if peer in self.remotes:
            self.remotes[peer].release(stream)

    def receive(self, data: bytes, at: int, sender: str) -> Effects:
        """Take a packet of a sender, as the transport knows it; a bad one is an event."""
        self._note_time(at)
        try:
            self._take(decode(data), sender, at)
        except FederationError as error:
            self._report(sender, f'a message is refused: {error}', at)
        if sender in self.remotes:
            self.remotes[sender].received += len(data)
        return self._effects()

    def advance(self, at: int) -> Effects:
        """Do what is due."""
        self._note_time(at)
        if at >= self._hello_at:
            self._hello_at = at + hello_period(self._settings)
            self._send('', messages.Hello(self.shares.version))
            self._expire(at)
        for remote in self.remotes.values():
            self._events += remote.advance(at)
        if at >= self._flush_at:
            self._flush_at = NEVER
            for stream in chain.from_iterable(map(self._named, self.sent)):
                for peer, message in stream.unsent():
                    self._send(peer, message)
        return self._effects()

    def _note_time(self, at: int) -> None:
        """Notice that the own clock has jumped back: restart waits, and measure clocks anew."""
        if self._now == BEGINNING:
            self._begun_at = at
        elif at < self._now:
            self._hello_at = self._begun_at = at
            self._faults_at.clear()
            for streams in self.sent.values():
                for constants, stream in streams.items():
                    streams[constants] = stream.continued(next(self._epochs))
            for remote in self.remotes.values():
                self._events += remote.restart_times(at)
        self._now = at

    def _take(self, packet: Packet, sender: str, at: int) -> None:
        if sender == self._settings.name:
            if packet.incarnation == self._incarnation:
                return
            raise FederationError(
                f"another host is called '{sender}', too; give each host its own name"
            )
        # Peers that the own host asks need no limit here: the readers of this host limit them.
        if sender not in self.remotes and len(self.remotes) >= MAX_PEERS:
            raise FederationError(f'there are more than {MAX_PEERS} peers; use several groups')
        remote = self._remote(sender, at)
        heard = remote.hear(packet.incarnation, at)
        if heard is None:
            return
        self._events += heard
        for message in packet.messages:
            self._take_message(remote, message, at)

    def _take_message(self, remote: RemotePeer, message: Message, at: int) -> None:
        match message:
            case messages.SharesRequest():
                remote.send(self.shares)
            case Request() | messages.FormulaRequest() if self._is_beginning(at):
                pass  # It is repeated.
            case Request():
                self._take_request(remote, message, at)
            case messages.FormulaRequest():
                self._take_formula(remote, message, at)
            case messages.Release(stream):
                if self._is_asked(stream, remote):
                    del self.formulas[stream]
                    self.sent.pop(stream, None)
                for each in self._named(stream):
                    each.release(remote.name)
            case messages.Probe(sent_at):
                self._events += remote.check_stamp(sent_at, at)
                remote.send(messages.ProbeReply(sent_at, at, at))
            case _:
                self._events += remote.take(message, at)

    def _is_beginning(self, at: int) -> bool:
        """Return True while the own host may soon find out what it shares."""
        return not self.shares.version and at - self._begun_at < self._settings.peer_timeout

    def _refusal(self, stream: str) -> str:
        """Return why a stream is not given."""
        if is_verdict(stream):
            return 'it is not shared, as that formula is not evaluated there any more'
        if not self.shares.version:
            return (
                'it is not known there what can be shared, as the ontology manager or the '
                'semantics manager there does not answer'
            )
        named = (each.name for each in self._settings.share)
        if any(f'{stream}_'.startswith(f'{each}_') for each in named):
            return 'no stream there carries it now'
        return 'it is not shared; name it in share there'

    def _is_asked(self, stream: str, remote: RemotePeer) -> bool:
        """Return True for the verdict of a formula that a peer has asked for."""
        return stream in self.formulas and self.formulas[stream].asker == remote.name

    def _take_formula(self, remote: RemotePeer, request: messages.FormulaRequest, at: int) -> None:
        refusal = ''
        if request.stream not in self.formulas:
            try:
                self._accept(remote, request, at)
            except FederationError as error:
                refusal = error.message[:MAX_REASON]
        elif not self._is_asked(request.stream, remote):
            refusal = f"'{request.stream}' is the verdict of another peer; choose another name"
        remote.send(messages.FormulaReply(request.stream, refusal))

    def _accept(self, remote: RemotePeer, request: messages.FormulaRequest, at: int) -> None:
        streams = streams_of(request.formula, [each.stream for each in self.shares.features])
        if len(self.formulas) >= MAX_FORMULAS:
            raise FederationError(f'{MAX_FORMULAS} formulas are evaluated for peers; end some')
        expires = at + self._settings.peer_timeout
        self.formulas[request.stream] = FormulaForPeer(remote.name, request, streams, expires)

    def _take_request(self, remote: RemotePeer, request: Request, at: int) -> None:
        name, constants = request.stream, request.constants
        feature = next((each.name for each in self.shares.features if each.stream == name), None)
        if feature is None and not self._is_asked(name, remote):
            reason = self._refusal(name)
            remote.send(messages.RequestRefusal(name, reason))
            return
        streams = self.sent.setdefault(name, {})
        if constants not in streams:
            if len(streams) >= MAX_COMPARISONS:
                reason = f'peers compare it with more than {MAX_COMPARISONS} lists of constants'
                remote.send(messages.RequestRefusal(name, reason))
                return
            thinned = (each for each in self._settings.share if each.name == feature)
            share = next(thinned, RequestedShare(name))
            thinning = Thinning(share.every, share.deadband, constants)
            history = self._settings.history
            streams[constants] = SentStream(name, next(self._epochs), history, thinning)
        for each in streams.keys() - {constants}:
            streams[each].release(remote.name)
        expires = at + self._settings.peer_timeout
        for answer in streams[constants].renew(remote.name, request, expires):
            remote.send(answer)

    def _expire(self, at: int) -> None:
        """End what is not needed any more."""
        for name, streams in list(self.sent.items()):
            for constants, stream in list(streams.items()):
                stream.expire(at)
                if not stream.subscribers and at >= stream.used_until + self._settings.history:
                    del streams[constants]
            if not streams:
                del self.sent[name]
                self.formulas.pop(name, None)
        for name, asked in list(self.formulas.items()):
            if name not in self.sent and at >= asked.expires:
                del self.formulas[name]
        for name, remote in list(self.remotes.items()):
            if remote.expire(at):
                del self.remotes[name]
                self._faults_at.pop(name, None)
                self._events.append(events.SharesChanged(name, Shares(0)))

    def _remote(self, name: str, at: int) -> RemotePeer:
        if name not in self.remotes:
            check_name(name, FederationError)
            send = partial(self._send, name)
            self.remotes[name] = RemotePeer(name, self._settings, send, at)
        return self.remotes[name]

    def _report(self, peer: str, message: str, at: int) -> None:
        """Report a fault of a peer, or of any other sender, once in a while."""
        name, period = '', self._settings.peer_timeout
        if peer in self.remotes:
            self.remotes[peer].fault, name = message, peer
        if at >= self._faults_at.get(name, at - period) + period:
            self._faults_at[name] = at
            self._events.append(events.PeerFault(peer, message))

    def _send(self, receiver: str, message: Message) -> None:
        key = receiver, isinstance(message, messages.URGENT)
        self._unsent.setdefault(key, []).append(message)

    def _effects(self) -> Effects:
        packets = [
            (receiver, Packet(self._incarnation, tuple(unsent[first:][:MAX_MESSAGES])))
            for (receiver, _), unsent in self._unsent.items()
            for first in range(0, len(unsent), MAX_MESSAGES)
        ]
        found = Effects(packets, self._events)
        self._unsent, self._events = {}, []
        return found
