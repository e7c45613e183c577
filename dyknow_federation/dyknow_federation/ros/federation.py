"""The federation node: joins the DyKnow system of this host with the systems of other hosts.

ros2 run dyknow_federation federation --ros-args -p robot:=robot.yaml
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Final

from dyknow_interfaces.srv import PushDown
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.exceptions import InvalidHandle
from std_msgs.msg import String

from dyknow_common import NANOSECONDS, SECOND_NS, DyKnowError, format_time
from dyknow_common.ros import LATCHED, RUNNING, DyKnowNode, LogOnce, is_time_simulated, run
from dyknow_configuration import RequestedFederation, read_robot
from dyknow_coordinator import PEER_WAITS
from dyknow_federation import events
from dyknow_federation.encoding import encode_all
from dyknow_federation.errors import FederationError
from dyknow_federation.offers import shares
from dyknow_federation.peer import Effects, Peer
from dyknow_federation.remote import RemotePeer
from dyknow_federation.report import FederationReport, LinkState, PeerReport
from dyknow_federation.ros.own_formulas import OwnFormulas
from dyknow_federation.ros.own_streams import OwnStreams
from dyknow_federation.ros.remote_formulas import RemoteFormulas
from dyknow_federation.ros.remote_streams import RemoteStreams, StreamName
from dyknow_federation.ros.transport import ZenohTransport
from dyknow_federation.ros.vocabulary import SharedVocabulary
from dyknow_stream_processing import PEER_STREAMS, ViolationKind

PERIOD_S: Final = 0.1
"""The period in which demands and changes are looked for."""

REPORT_PERIOD_S: Final = 1.0

SIMULATED: Final = (
    'this host has no peers, as it takes its time from /clock, in which clocks cannot be compared; '
    'run it without use_sim_time'
)

MIN_PERIOD_NS: Final = NANOSECONDS['ms']
"""The least time between two looks for what is due."""


class Federation(DyKnowNode):
    """Passes own streams on to peers that ask for them, and publishes theirs here."""

    def __init__(self) -> None:
        super().__init__('federation')
        path = self.parameter('robot', '', 'robot.yaml with the key federation.')
        settings = self._settings = _federation(path)
        self._peer = Peer(settings, self.started_at)
        self._latest = self.now()
        self._remote = RemoteStreams(self)
        self._own = OwnStreams(self, self._peer, self._plan)
        self._own_formulas = OwnFormulas(self._own)
        self._formulas = RemoteFormulas(self._peer, self._remote, settings.name)
        prefix = str(self.resolve_topic_name(PEER_STREAMS)) + '/'
        self._vocabulary = SharedVocabulary(self, settings.same, self._remote.topic, prefix)
        self._meaning_of: object = None
        """The version of the vocabulary that peers know; None if it is outdated."""
        self._is_working = False
        self._offer_faults: Sequence[str] = ()
        self._refused = 0, ''
        """When a message of a sender that is no peer was refused last, and why."""
        self._log = LogOnce()
        group = ReentrantCallbackGroup()
        self._packets = self.create_guard_condition(self._take, group)
        self._transport = ZenohTransport(settings, self.now, self._wake)
        self._report = self.create_publisher(String, '~/federation', LATCHED)
        self._waits = self.create_publisher(String, f'~/{PEER_WAITS}', LATCHED)
        self._published_waits: Mapping[str, str] = {}
        timer = partial(self.create_timer, callback_group=group, clock=self.wall_clock)
        self._deadline = timer(PERIOD_S, self._advance)
        timer(PERIOD_S, self._update)
        timer(REPORT_PERIOD_S, self._publish_report)
        self.serve(PushDown, self._formulas.push_down)

    def destroy_node(self) -> None:
        """Leave the federation."""
        self._own_formulas.close()
        self._transport.close()
        super().destroy_node()

    def _wake(self) -> None:
        """Have packets taken; called in a thread of zenoh."""
        try:
            self._packets.trigger()
        except InvalidHandle:
            return  # The node is destroyed.

    def _take(self) -> None:
        """Take the packets that have come; in simulated time, no packet is sent or taken."""
        packets = self._transport.take()
        if is_time_simulated(self):
            return
        for each in packets:
            self._act(self._peer.receive(each.data, self._time(each.received_at), each.sender))
        self._plan()

    def _advance(self) -> None:
        """Do what is due, after all packets that have come before."""
        self._take()
        if not is_time_simulated(self):
            self._act(self._peer.advance(self._time(self.now())))
            self._plan()

    def _time(self, at: int) -> int:
        """Return a time that is not before an earlier one, unless the clock was set back."""
        now = self.now()
        self._latest = now if now < self._latest else max(at, self._latest)
        return self._latest

    def _plan(self) -> None:
        """Have the timer call at the next deadline."""
        wait = self._peer.next_deadline() - self.now()
        period = min(max(wait, 0), round(PERIOD_S * SECOND_NS))
        self._deadline.timer_period_ns = max(period, MIN_PERIOD_NS)
        self._deadline.reset()

    def _act(self, effects: Effects) -> None:
        for receiver, packet in effects.packets:
            try:
                for data in encode_all(packet):
                    self._transport.send(receiver, data, is_urgent=packet.is_urgent)
            except FederationError as error:
                self._warn([str(error)])
        for event in effects.events:
            self._handle(event)

    def _handle(self, event: events.PeerEvent) -> None:
        """Act on an event of a stream, or of a peer."""
        match event:
            case events.ValueKnown(peer, stream, time, value):
                self._formulas.note_states(peer, stream)
                for each in self._remote.of(peer, stream):
                    each.publish(time, value)
            case events.WatermarkArrived(peer, stream, time):
                for each in self._remote.of(peer, stream):
                    each.promise(time)
            case events.StreamViolated(peer, stream, constraint, reason, time):
                for each in self._remote.of(peer, stream):
                    each.violate(constraint, reason, time)
            case _:
                self._handle_peer(event)

    def _handle_peer(self, event: events.PeerEvent) -> None:
        match event:
            case events.FormulaAnswered():
                self._formulas.take(event)
            case events.FormulaWaits():
                self._formulas.note_wait(event)
            case events.SharesChanged(peer):
                self._meaning_of = None
                if peer not in self._peer.remotes:
                    self._transport.forget(peer)
            case events.PeerLeft(peer, reason):
                self._violate(peer, ViolationKind.MAX_DELAY, reason)
                self._warn([reason])
            case events.ClockJumped(peer, since):
                text = f"the clock of peer '{peer}' has jumped, or that of this host"
                if since is not None:
                    text += f'; samples may have wrong times since {format_time(since)}'
                self._violate(peer, ViolationKind.CLOCK, text)
            case events.PeerFault(peer, message):
                text = f"peer '{peer}': {message}"
                if peer not in self._peer.remotes:
                    self._refused = self.now(), text
                self._warn([text])

    def _violate(self, peer: str, kind: str, reason: str) -> None:
        """Report a violation of all streams of a peer that are read."""
        for each in self._remote.of(peer):
            each.violate(kind, reason)

    def _update(self) -> None:
        """Follow what is read here, and what has changed in the meaning."""
        now = self.now()
        begun, ended = self._remote.demand()
        for name, told in begun.items():
            self._peer.request(*name, now, told, self._compared(name))
        for name in ended:
            self._peer.release(*name)
        self._own_formulas.reconcile()
        self._own.reconcile()
        # Why the verdicts of peers do not come.
        if (waits := self._formulas.waits()) != self._published_waits:
            self._published_waits = waits
            self._waits.publish(String(data=json.dumps(waits)))
        version = self._vocabulary.version
        if version not in (None, self._meaning_of) and not self._is_working:
            self._is_working, self._meaning_of = True, version
            self.spawn(self._update_meaning)

    def _compared(self, name: StreamName) -> tuple[float, ...]:
        """Return the numbers with which a stream is compared; none if its values are needed."""
        remote = self._peer.remotes.get(name.peer)
        shared = remote.shares.features if remote else ()
        feature = next((each.name for each in shared if each.stream == name.stream), '')
        return self._settings.compared.get(feature, ())

    async def _update_meaning(self) -> None:
        """Publish here what peers share, and tell peers what this host shares."""
        is_done = False
        try:
            remotes = self._peer.remotes.items()
            due = await self._vocabulary.apply({name: each.shares for name, each in remotes})
            self._remote.keep({StreamName(*name) for name in due.streams})
            deadbands = {each.name: each.deadband for each in self._settings.share}
            found, knowledge, self._offer_faults = await self._vocabulary.offers(deadbands)
            given, offers = shares(self._peer.shares.version, found, knowledge, deadbands)
            self._own.offers = offers
            if given != self._peer.shares or not given.version:
                self._peer.share(given.objects, given.features, self.now())
            is_done = True
        except DyKnowError as error:
            self._warn([f'what hosts share is not up to date: {error}'])
        finally:
            self._is_working = False
            if not is_done:
                self._meaning_of = None

    def _warn(self, texts: Iterable[str]) -> None:
        for text in self._log.new(texts):
            self.get_logger().warning(text)

    def _publish_report(self) -> None:
        now, transport = self.now(), self._transport
        for peer, each in self._peer.remotes.items():
            if each.departure:  # For new readers, too.
                self._violate(peer, ViolationKind.MAX_DELAY, each.departure)
        peers = tuple(self._peer_report(each, now) for each in self._peer.remotes.values())
        shared = tuple(each.stream for each in self._peer.shares.features)
        faults = (*self._vocabulary.faults, *self._own.faults, *self._offer_faults)
        if fault := SIMULATED if is_time_simulated(self) else transport.link_fault():
            faults += (fault,)
        self._warn(faults)
        refused_at, refusal = self._refused
        if refusal and now - refused_at < 2 * self._settings.peer_timeout:
            faults += (refusal,)
        if transport.dropped:
            faults += (f'{transport.dropped} packets were dropped: too many waited',)
        report = FederationReport(self._settings.name, peers, shared, faults)
        self._report.publish(String(data=json.dumps(asdict(report))))
        linked = sum(each.state is LinkState.LINKED for each in peers)
        self.set_status(RUNNING, {'peers': str(len(peers)), 'linked': str(linked)})

    def _peer_report(self, remote: RemotePeer, now: int) -> PeerReport:
        name, offset = remote.name, remote.clock.offset(now)
        state = LinkState.STALE if remote.is_stale else LinkState.LINKED
        return PeerReport(
            name,
            state if remote.is_present else LinkState.LEFT,
            max(now - remote.heard_at, 0),
            remote.clock.delay,
            offset and offset.offset,
            offset and offset.uncertainty,
            self._transport.sent[name],
            remote.received,
            remote.lost,
            tuple(each.stream for each in remote.shares.features),
            tuple(sorted(remote.requested)),
            tuple(self._peer.given(name)),
            remote.fault,
        )


def _federation(path: str) -> RequestedFederation:
    """Return the federation that a robot.yaml describes."""
    if not path:
        raise FederationError('the parameter robot is empty; give the path of a robot.yaml')
    found = read_robot(Path(path)).federation
    if found is None:
        raise FederationError(f"{path} has no key 'federation'; add it")
    return found


def main() -> int:
    """Run the executable federation."""
    return run(Federation)
