"""One other peer, as the own host knows it: its life, its clock, and what was asked of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

from dyknow_common import NANOSECONDS, SECOND_NS, format_duration, round_duration, round_time
from dyknow_configuration import RequestedFederation
from dyknow_federation.clocks import OwnTime, PairClock
from dyknow_federation.events import (
    ClockJumped,
    Event,
    PeerJoined,
    PeerLeft,
    SamplesLost,
    SharesChanged,
    StreamViolated,
    ValueKnown,
    WatermarkArrived,
)
from dyknow_federation.messages import (
    Grant,
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
    Watermark,
)
from dyknow_federation.possible_values import TOO_CLOSE, PossibleValues, Precision
from dyknow_federation.receiving import Lost, Promise, Received, ReceivedStream
from dyknow_stream_processing import ViolationKind

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


_STALE: Final = 3
"""A link over which nothing has been heard for this part of `peer_timeout` is stale."""


def hello_period(settings: RequestedFederation) -> int:
    """Return the time between two signs of life: some of those in `peer_timeout` may be lost."""
    return min(SECOND_NS, settings.peer_timeout // 10)


@dataclass(slots=True)
class _Requested:
    """A stream that was requested.

    Args:
        stream: as it is received.
        values: of it.
        due: when the request is repeated.
        is_refused: True if the peer does not grant it.
        precision: of its values.
    """

    stream: ReceivedStream
    values: PossibleValues
    due: int
    precision: Precision
    is_refused: bool = False


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
        self, name: str, settings: RequestedFederation, send: Callable[[Message], None], at: int
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
        self._probes: deque[int] = deque(maxlen=MAX_PROBES)
        self._probe_at = at
        self._requested: dict[str, _Requested] = {}
        self._granted: dict[int, str] = {}
        """The streams by their epochs, which those messages name that are sent often."""

    @property
    def requested(self) -> list[str]:
        """The names of the streams that were requested of it."""
        return list(self._requested)

    def next_deadline(self) -> int | None:
        """Return when to call `advance`; None if there is nothing to wait for."""
        if not self.is_present:
            return None
        timeout = self._settings.peer_timeout
        limit = timeout if self.is_stale else timeout // _STALE
        return min(
            [
                self.heard_at + limit,
                self._probe_at,
                *(each.due for each in self._requested.values()),
            ]
        )

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
            for name, each in self._requested.items():
                if each.stream.epoch:
                    events.append(self._lose(name, 0, 'the peer has started again'))
                each.stream, each.is_refused = ReceivedStream(name), False
        self._granted.clear()
        self._incarnation, self.shares = incarnation, None
        self.clock = PairClock()
        self._probes.clear()
        return events

    def _begin(self, at: int) -> None:
        """Ask at once for all that is needed."""
        self._probe_at = at
        for each in self._requested.values():
            each.due = at

    def restart_times(self, at: int) -> list[Event]:
        """Measure the clock anew, as the own one has jumped; all waits end."""
        found = self._begin_times_anew(at)
        self.heard_at = at
        self._probes.clear()
        self._begin(at)
        return [found]

    def _begin_times_anew(self, at: int) -> ClockJumped:
        """Forget the clock, which has jumped, and the samples that are dated by it."""
        since = self.clock.latest
        self.clock.begin_anew(at)
        self._forget_values()
        return ClockJumped(self.name, since)

    def advance(self, at: int) -> list[Event]:
        """Do what is due: requests, probes, and the end of a link."""
        if not self.is_present:
            return []
        silence = at - self.heard_at
        if silence >= self._settings.peer_timeout:
            return self._leave(silence)
        self.is_stale = silence >= self._settings.peer_timeout // _STALE
        if at >= self._probe_at:
            self._send_probe(at)
        for each in self._requested.values():
            if at >= each.due:
                self._send_request(each, at)
        return []

    def _leave(self, silence: int) -> list[Event]:
        self.is_present = self.is_stale = False
        reason = f"peer '{self.name}' has not been heard for {round_duration(silence)}"
        return [PeerLeft(self.name, reason)]

    def request(self, name: str, at: int, after: int, constants: tuple[float, ...] = ()) -> None:
        """Ask for a stream until it is released; see `Peer.request`."""
        if name not in self._requested:
            self._requested[name] = _Requested(
                ReceivedStream(name), PossibleValues(after), at, Precision(constants=constants)
            )
            self._probe_at = at

    def release(self, name: str) -> None:
        """Ask for a stream no more."""
        if self._requested.pop(name, None) is not None:
            self._granted = {key: each for key, each in self._granted.items() if each != name}
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
                    for each in self._requested.values():
                        each.is_refused = False
                    return [SharesChanged(self.name, message)]
            case Grant():
                return self._take_grant(message)
            case Samples() | Watermark():
                return [*self._take_samples(message, at)]
            case RequestRefusal(stream, reason):
                return self._take_refusal(stream, reason, at)
            case ProbeReply():
                return self._take_reply(message, at)
        return []

    def check_stamp(self, stamp: int, at: int) -> list[Event]:
        """Notice a clock that has jumped ahead, by a stamp that is later than it can be."""
        if not self.clock.exceeds(stamp, at):
            return []
        self._probe_at = at
        return [self._begin_times_anew(at)]

    def _take_grant(self, grant: Grant) -> list[Event]:
        name, epoch = grant.stream, grant.epoch
        requested = self._requested.get(name)
        if requested is None:
            self.send(Release(name))
            return []
        if grant.constants != requested.precision.constants:
            return []  # It is a late answer to an earlier request.
        shared = self.shares.features if self.shares else ()
        deadband = next((each.deadband for each in shared if each.stream == name), None)
        former = requested.stream.epoch
        if epoch <= former or deadband is None:  # Without shares, the next request is granted, too.
            return []
        self._granted.pop(former, None)
        self._granted[epoch] = name
        requested.stream = ReceivedStream(name, epoch)
        reasons = [f'{self.name} shares {name} with a deadband of {deadband}'] if deadband else []
        if constants := requested.precision.constants:
            compared = ', '.join(map(str, constants))
            own = self._settings.name
            reasons.append(f'{own} asks for {name} as compared with {compared} alone')
        requested.precision = Precision(deadband, constants, ', and '.join(reasons))
        return [self._lose(name, 0, 'the peer numbers its samples anew')] if former else []

    def _take_samples(self, message: StreamMessage, at: int) -> Iterator[Event]:
        name = self._granted.get(message.epoch)
        if name is None:
            return  # The next request will be granted with this epoch.
        requested = self._requested[name]
        requested.stream.take(message)
        yield from self._deliver(name, at)
        if not requested.stream.is_complete:
            requested.due = min(requested.due, at + self._retry)

    def _take_refusal(self, name: str, reason: str, at: int) -> list[Event]:
        requested = self._requested.get(name)
        if requested is None or requested.is_refused:
            return []
        requested.is_refused = True
        text = f"peer '{self.name}' refuses it: {reason}"
        return [self._violation(name, ViolationKind.MESSAGE, text, at)]

    def _take_reply(self, reply: ProbeReply, at: int) -> list[Event]:
        sent = reply.probe_sent_at
        if sent not in self._probes:
            return []
        self._probes.remove(sent)
        since, was_known = self.clock.latest, self.clock.is_known
        jump = self.clock.measure(sent, reply.received_at, reply.sent_at, at)
        events: list[Event] = []
        if jump is not None:
            self._forget_values()
            events.append(ClockJumped(self.name, since))
        self._probe_at = at + PROBE_PERIOD * (1 if self._requested else UNUSED)
        if not was_known or jump is not None:
            for name in self._requested:
                events += self._deliver(name, at)
        return events

    def _deliver(self, name: str, at: int) -> Iterator[Event]:
        """Yield what is due of a stream; nothing while its times cannot be translated."""
        if not self.clock.is_known:
            return
        values, precision = self._requested[name].values, self._requested[name].precision
        for each in self._requested[name].stream.deliveries():
            match each:
                case Lost():
                    yield self._lose(name, *each)
                case StreamFault():
                    text = f"peer '{self.name}' reports: {each.reason}"
                    time = min(self._own_time(each.valid_time).earliest, at)
                    yield self._violation(name, each.constraint, text, time)
                case Received():
                    yield from self._put(name, each, at)
                case Promise(time):
                    if (earliest := self._own_time(time).earliest) > self.clock.since:
                        values.promise(earliest)
            for time, value in values.take(partial(self.difference, at), precision):
                yield ValueKnown(self.name, name, time, value)
            if isinstance(each, Promise):
                yield WatermarkArrived(self.name, name, values.settled)

    def _put(self, name: str, received: Received, at: int) -> Iterator[Event]:
        """Take a sample, unless it cannot be dated; yield what is wrong with its time."""
        earliest, latest = self._own_time(received.valid_time)
        if earliest < self.clock.since:
            yield self._lose(name, 1, f"the clock of peer '{self.name}' jumped after it")
            return
        if earliest > at:
            reason = f'it is valid at {round_time(earliest)}, which is still to come'
            yield self._lose(name, 1, reason)
            return
        limit = self._settings.max_uncertainty
        faults: list[str] = []
        if latest - earliest > 2 * limit:
            faults.append(f'more than a max_uncertainty of {format_duration(limit)}')
        if not self._requested[name].values.put(earliest, latest, received.value):
            faults.append(TOO_CLOSE)
        for each in faults:
            text = f'{self.difference(at)}; {each}'
            yield self._violation(name, ViolationKind.CLOCK, text, earliest)

    def _lose(self, name: str, count: int, reason: str) -> SamplesLost:
        self._requested[name].values.lose()
        text = f"samples of peer '{self.name}' are lost: {reason}"
        return SamplesLost(self.name, name, count, text)

    def _violation(self, name: str, constraint: str, reason: str, time: int) -> StreamViolated:
        return StreamViolated(self.name, name, str(constraint), reason, time)

    def _forget_values(self) -> None:
        for each in self._requested.values():
            each.values = PossibleValues()

    def difference(self, at: int) -> str:
        """Return by how much its clock differs, as the beginning of a sentence."""
        offset = self.clock.offset(at)
        if offset is None:
            return f"the clock of '{self.name}' is not known"
        return f'the clocks of {self._settings.name} and {self.name} differ by {offset}'

    def _own_time(self, time: int) -> OwnTime:
        found = self.clock.own_time(time)
        if found is None:
            raise AssertionError('the clock is measured before anything is delivered')
        return found

    @property
    def _retry(self) -> int:
        return max(RETRY, 2 * (self.clock.delay or 0))

    def _send_probe(self, at: int) -> None:
        self._probes.append(at)
        self._probe_at = at + min(self._retry, PROBE_PERIOD)
        self.send(Probe(at))

    def _send_request(self, requested: _Requested, at: int) -> None:
        stream = requested.stream
        is_settled = requested.is_refused or (stream.epoch and stream.is_complete)
        requested.due = at + (hello_period(self._settings) if is_settled else self._retry)
        self.send(replace(stream.request(), constants=requested.precision.constants))
