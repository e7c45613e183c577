"""One other peer, as the own host knows it: its life, its clock, and what was asked of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Final

from dyknow_common import NANOSECONDS, SECOND_NS, round_duration, round_time
from dyknow_federation.clocks import OwnTime, PairClock
from dyknow_federation.events import (
    ClockJumped,
    Event,
    PeerJoined,
    PeerLeft,
    RemoteSample,
    SampleArrived,
    SamplesLost,
    SharesChanged,
    StreamRefused,
    StreamViolated,
    WatermarkArrived,
)
from dyknow_federation.messages import (
    Hello,
    Message,
    Probe,
    ProbeReply,
    Release,
    RequestRefusal,
    Samples,
    Shares,
    SharesRequest,
    StreamFault,
    StreamMessage,
    ViolationNotice,
    Watermark,
)
from dyknow_federation.receiving import Delivery, Lost, Promise, ReceivedStream
from dyknow_federation.settings import PeerSettings

MAX_FORMER: Final = 16
"""The number of former runs of a peer whose late messages are known as such."""

RETRY: Final = 100 * NANOSECONDS['ms']
"""The least time until an unanswered request is repeated, in nanoseconds."""

PROBE_PERIOD: Final = SECOND_NS
"""The time between two measures of a clock, in nanoseconds."""

UNUSED: Final = 10
"""The clock of a peer of which nothing is asked is measured this many times more rarely."""

MAX_PROBES: Final = 16
"""The number of probes that wait for a reply."""

_NUMBERS: Final = 2**62
"""Probes are numbered below this; runs of a host differ in their numbers."""


class RemotePeer:
    """One other peer.

    Attributes:
        name: its name.
        clock: its clock.
        shares: what it shares; None if it is not known.
        is_present: False if it has left.
        heard_at: when it was last heard.

    Args:
        name: its name.
        settings: of the own host.
        send: sends a message to it.
        at: the time.
    """

    def __init__(
        self, name: str, settings: PeerSettings, send: Callable[[Message], None], at: int
    ) -> None:
        self.name = name
        self.clock = PairClock()
        self.shares: Shares | None = None
        self.is_present = self.is_stale = False
        self.heard_at = at
        self.send = send
        self._settings = settings
        self._incarnation: int | None = None
        self._former: deque[int] = deque(maxlen=MAX_FORMER)
        self._probes: dict[int, int] = {}
        self._probe_at = at
        self._streams: dict[str, ReceivedStream] = {}
        self._request_at: dict[str, int] = {}
        self._refused: set[str] = set()

    @property
    def requested(self) -> list[str]:
        """The names of the streams that were requested of it."""
        return list(self._streams)

    def next_deadline(self) -> int | None:
        """Return when to call `advance`; None if there is nothing to wait for."""
        if not self.is_present:
            return None
        limit = self._settings.peer_timeout if self.is_stale else self._settings.stale_after
        return min([self.heard_at + limit, self._probe_at, *self._request_at.values()])

    def hear(self, incarnation: int, at: int) -> list[Event] | None:
        """Take a sign of life; return None if it is a late one of a former run."""
        if incarnation in self._former:
            return None
        events: list[Event] = []
        is_new = incarnation != self._incarnation
        if is_new:
            events += self._restart(incarnation)
        if is_new or not self.is_present:
            events.append(PeerJoined(self.name))
        if is_new or not self.is_present or self.is_stale:
            self._begin(at)
        self.is_present, self.is_stale, self.heard_at = True, False, at
        return events

    def _restart(self, incarnation: int) -> list[Event]:
        """Forget the former run: its clock, its shares, and its numbers."""
        events: list[Event] = []
        if self._incarnation is not None:
            self._former.append(self._incarnation)
            for name, stream in self._streams.items():
                if stream.is_subscribed:
                    reason = 'the peer has started again'
                    events.append(SamplesLost(self.name, name, 0, reason))
                self._streams[name] = ReceivedStream(name)
        self._incarnation, self.shares = incarnation, None
        self.clock = PairClock()
        self._probes.clear()
        self._refused.clear()
        return events

    def _begin(self, at: int) -> None:
        """Ask at once for all that is needed."""
        self._probe_at = at
        self._request_at = dict.fromkeys(self._streams, at)

    def restart_times(self, at: int) -> list[Event]:
        """Measure the clock anew, as the own one has jumped; all waits end."""
        since = self.clock.latest
        self.clock.begin_anew(at)
        self.heard_at = at
        self._probes.clear()
        self._begin(at)
        return [ClockJumped(self.name, since)]

    def advance(self, at: int) -> list[Event]:
        """Do what is due: requests, probes, and the end of a link."""
        if not self.is_present:
            return []
        silence = at - self.heard_at
        if silence >= self._settings.peer_timeout:
            return self._leave(silence)
        self.is_stale = silence >= self._settings.stale_after
        if at >= self._probe_at:
            self._send_probe(at)
        for name, due in self._request_at.items():
            if at >= due:
                self._send_request(name, at)
        return []

    def _leave(self, silence: int) -> list[Event]:
        self.is_present = self.is_stale = False
        reason = f"peer '{self.name}' has not been heard for {round_duration(silence)}"
        return [PeerLeft(self.name, reason)]

    def request(self, name: str, at: int) -> None:
        """Ask for a stream until it is released."""
        if name not in self._streams:
            self._streams[name] = ReceivedStream(name)
            self._request_at[name] = self._probe_at = at

    def release(self, name: str) -> None:
        """Ask for a stream no more."""
        if self._streams.pop(name, None) is not None:
            self._request_at.pop(name, None)
            self._refused.discard(name)
            self.send(Release(name))

    def take(self, message: Message, at: int) -> list[Event]:
        """Take a message that answers what the own host has asked."""
        match message:
            case Hello(version):
                if self.shares is None or self.shares.version < version:
                    self.send(SharesRequest())
            case Shares():
                if self.shares is None or self.shares.version < message.version:
                    self.shares = message
                    self._refused.clear()
                    return [SharesChanged(self.name, message)]
            case Samples() | ViolationNotice() | Watermark():
                return self._take_samples(message, at)
            case RequestRefusal(stream, reason):
                return self._take_refusal(stream, reason)
            case ProbeReply():
                return self._take_reply(message, at)
        return []

    def check_stamp(self, stamp: int, at: int) -> list[Event]:
        """Notice a clock that has jumped ahead, by a stamp that is later than it can be."""
        if not self.clock.exceeds(stamp, at):
            return []
        since = self.clock.latest
        self.clock.begin_anew(at)
        self._probe_at = at
        return [ClockJumped(self.name, since)]

    def _take_samples(self, message: StreamMessage, at: int) -> list[Event]:
        name = message.stream
        stream = self._streams.get(name)
        if stream is None:
            self.send(Release(name))
            return []
        stream.take(message)
        events = self._deliver(name, at)
        if not stream.is_complete:
            self._request_at[name] = min(self._request_at[name], at + self._retry)
        return events

    def _take_refusal(self, name: str, reason: str) -> list[Event]:
        if name not in self._streams or name in self._refused:
            return []
        self._refused.add(name)
        return [StreamRefused(self.name, name, reason)]

    def _take_reply(self, reply: ProbeReply, at: int) -> list[Event]:
        sent = self._probes.pop(reply.number, None)
        if sent is None or sent != reply.probe_sent_at:
            return []
        since, was_known = self.clock.latest, self.clock.is_known
        jump = self.clock.measure(sent, reply.received_at, reply.sent_at, at)
        events: list[Event] = []
        if jump is not None:
            events.append(ClockJumped(self.name, since))
        self._probe_at = at + PROBE_PERIOD * (1 if self._streams else UNUSED)
        if not was_known or jump is not None:
            for name in self._streams:
                events += self._deliver(name, at)
        return events

    def _deliver(self, name: str, at: int) -> list[Event]:
        """Return what is due of a stream; nothing while its times cannot be translated."""
        if not self.clock.is_known:
            return []
        return [*self._events(name, self._streams[name].deliveries(), at)]

    def _events(self, stream: str, deliveries: Iterable[Delivery], at: int) -> Iterator[Event]:
        """Yield what is told of a stream, in times of the own clock."""
        for each in deliveries:
            if isinstance(each, Lost):
                yield SamplesLost(self.name, stream, *each)
                continue
            own = self._own_time(each.time if isinstance(each, Promise) else each.valid_time)
            earliest = own.time - own.uncertainty
            if isinstance(each, StreamFault):
                fault = replace(each, valid_time=min(earliest, at))
                yield StreamViolated(self.name, stream, fault)
            elif isinstance(each, Promise):
                if earliest > self.clock.since:
                    yield WatermarkArrived(self.name, stream, earliest)
            elif earliest < self.clock.since:
                reason = f"the clock of peer '{self.name}' jumped after it"
                yield SamplesLost(self.name, stream, 1, reason)
            elif earliest > at:
                reason = f'it is valid at {round_time(own.time)}, which is still to come'
                yield SamplesLost(self.name, stream, 1, reason)
            else:
                sample = RemoteSample(own.time, own.uncertainty, each.value)
                yield SampleArrived(self.name, stream, sample)

    def _own_time(self, time: int) -> OwnTime:
        found = self.clock.own_time(time)
        if found is None:
            raise AssertionError('the clock is measured before anything is delivered')
        return found

    @property
    def _retry(self) -> int:
        return max(RETRY, 2 * (self.clock.delay or 0))

    def _send_probe(self, at: int) -> None:
        number = (self._settings.incarnation + at) % _NUMBERS
        while len(self._probes) >= MAX_PROBES:
            del self._probes[next(iter(self._probes))]
        self._probes[number] = at
        self._probe_at = at + min(self._retry, PROBE_PERIOD)
        self.send(Probe(number, at))

    def _send_request(self, name: str, at: int) -> None:
        stream = self._streams[name]
        is_urgent = not (stream.is_subscribed and stream.is_complete) and name not in self._refused
        period = self._retry if is_urgent else self._settings.hello_period
        self._request_at[name] = at + period
        self.send(stream.request())
