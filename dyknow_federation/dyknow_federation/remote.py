"""One other peer, as the own host knows it: its life, its clock, and what was asked of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

from dyknow_common import (
    NANOSECONDS,
    SECOND_NS,
    format_duration,
    round_duration,
    round_time,
    with_changed_times,
)
from dyknow_configuration import RequestedFederation
from dyknow_federation import events, messages
from dyknow_federation.clocks import NEVER, PairClock
from dyknow_federation.events import PeerEvent
from dyknow_federation.messages import is_verdict
from dyknow_federation.possible_values import TOO_CLOSE, PossibleValues, Precision
from dyknow_federation.receiving import Lost, Promise, Received, ReceivedStream
from dyknow_stream_processing import DEFAULT_MAX_LEAD, ViolationKind

MAX_FORMER: Final = 16
"""The number of former runs of a peer whose late messages are known as such."""

RETRY: Final = 100 * NANOSECONDS['ms']
"""The least time until an unanswered request is repeated, in nanoseconds."""

PROBE_PERIOD: Final = SECOND_NS
"""The time between two measures of a clock, in nanoseconds."""

UNUSED: Final = 10
"""The clock of a peer that nothing is asked of is measured this many times more rarely."""

MAX_PROBES: Final = 16
"""The number of probes that wait for a reply."""

FORMULA_TIMEOUT: Final = 5 * SECOND_NS
"""How long an answer to the request to evaluate a formula is waited for, in nanoseconds."""

_STALE: Final = 3
"""A link over which nothing has been heard for this part of `peer_timeout` is stale."""


def hello_period(settings: RequestedFederation) -> int:
    """Return the time between two signs of life; `peer_timeout` allows for some lost ones."""
    return min(SECOND_NS, settings.peer_timeout // 10)


@dataclass(slots=True)
class _Requested:
    """A stream that was requested."""

    stream: ReceivedStream
    values: PossibleValues
    due: int
    """When the request is repeated."""
    precision: Precision
    is_refused: bool = False


@dataclass(slots=True)
class _PendingFormula:
    """A request to evaluate a formula without an answer, which is repeated until its deadline."""

    request: messages.FormulaRequest
    due: int
    deadline: int


class RemotePeer:
    """One other peer.

    Attributes:
        shares: what it shares, as it has told last.
        is_present: False if it has left, or was never heard.
        departure: why it has left; empty if it has not.
        heard_at: when it was last heard.
        received: the number of bytes that have come from it.
        lost: the number of its samples that are lost for good.
        late: the number of packets of its former runs, which are dropped.
        fault: why its last refused message was refused.

    Args:
        settings: the settings of the own host.
        send: sends a message to the peer.
    """

    def __init__(
        self,
        name: str,
        settings: RequestedFederation,
        send: Callable[[messages.Message], None],
        at: int,
    ) -> None:
        self.name = name
        self.clock = PairClock()
        self.shares = messages.Shares(0)
        self.is_present = self.is_stale = False
        self.departure = self.fault = ''
        self.received = self.lost = self.late = 0
        self.heard_at = self._needed_at = at
        self.send = send
        self._settings = settings
        self._incarnation: int | None = None
        self._version = 0
        """The version of the shares of this run; 0 if they are not known."""
        self._former: deque[int] = deque(maxlen=MAX_FORMER)
        self._probes: deque[int] = deque(maxlen=MAX_PROBES)
        self._probe_at = at
        self.requested: dict[str, _Requested] = {}
        """The streams that were requested of it, by their names."""
        self._formulas: dict[str, _PendingFormula] = {}
        """The unanswered requests for formulas, by the streams of their verdicts."""
        self._granted: dict[int, str] = {}
        """The streams by their epochs; frequent messages name a stream by its epoch."""

    def next_deadline(self) -> int:
        """Return when to call `advance`."""
        waits = (min(each.due, each.deadline) for each in self._formulas.values())
        if not self.is_present:
            return min((each.deadline for each in self._formulas.values()), default=NEVER)
        timeout = self._settings.peer_timeout
        limit = timeout if self.is_stale else timeout // _STALE
        due = (each.due for each in self.requested.values())
        return min(self.heard_at + limit, self._probe_at, *due, *waits)

    def hear(self, incarnation: int, at: int) -> list[PeerEvent] | None:
        """Take a sign of life; return None if it is a late one of a former run.

        If the present run is stale, a sign of a former run makes that run the present one again:
        an altered packet had named the stale one.
        """
        if incarnation in self._former:
            if at - self.heard_at < self._settings.peer_timeout // _STALE:
                self.late += 1
                self.fault = f'{self.late} packets of a former run of the peer are dropped'
                return None
            self._former.remove(incarnation)
        is_new = incarnation != self._incarnation
        found = self._restart(incarnation) if is_new else []
        if is_new or not self.is_present or self.is_stale:
            self._begin(at)
        self.is_present, self.is_stale, self.heard_at, self.departure = True, False, at, ''
        return found

    def _restart(self, incarnation: int) -> list[PeerEvent]:
        """Forget the former run: its clock, its version, and its numbers."""
        found: list[PeerEvent] = []
        if self._incarnation is not None:
            self._former.append(self._incarnation)
            for name, each in self.requested.items():
                if each.stream.epoch:
                    found.append(self._lose(name, 0, 'the peer has started again'))
                each.stream, each.is_refused = ReceivedStream(name), False
        self._granted.clear()
        self._incarnation, self._version = incarnation, 0
        self.clock = PairClock()
        self._probes.clear()
        return found

    def _begin(self, at: int) -> None:
        """Ask at once for all that is needed."""
        self._probe_at = at
        for each in self.requested.values():
            each.due = at

    def restart_times(self, at: int) -> list[PeerEvent]:
        """Measure the clock anew, as the own one has jumped; all waits end."""
        self.heard_at = self._needed_at = at
        self._probes.clear()
        for each in self._formulas.values():
            each.due, each.deadline = at, at + FORMULA_TIMEOUT
        self._begin(at)
        return self._begin_times_anew(at)

    def _begin_times_anew(self, at: int) -> list[PeerEvent]:
        """Forget the clock, which has jumped, and the samples that are dated by it."""
        since, self._probe_at = self.clock.latest, at
        self.clock.begin_anew(at)
        self._forget_values()
        return [events.ClockJumped(self.name, since)]

    def advance(self, at: int) -> list[PeerEvent]:
        """Do what is due: requests, probes, and the end of a link."""
        found = self._ask_again(at)
        if not self.is_present:
            return found
        silence = at - self.heard_at
        if silence >= self._settings.peer_timeout:
            self.is_present = self.is_stale = False
            self.departure = f"peer '{self.name}' has not been heard for {round_duration(silence)}"
            return [*found, events.PeerLeft(self.name, self.departure)]
        self.is_stale = silence >= self._settings.peer_timeout // _STALE
        if at >= self._probe_at:
            self._probes.append(at)
            self._probe_at = at + min(self._retry, PROBE_PERIOD)
            self.send(messages.Probe(at))
        for each in self.requested.values():
            if at >= each.due:
                self._send_request(each, at)
        return found

    def _ask_again(self, at: int) -> list[PeerEvent]:
        """Repeat requests to evaluate formulas, and give up those that are late."""
        late = [name for name, each in self._formulas.items() if at >= each.deadline]
        for name in late:
            del self._formulas[name]
        for each in self._formulas.values():
            if self.is_present and at >= each.due:
                each.due = at + self._retry
                self.send(each.request)
        reason = f'it does not answer within {format_duration(FORMULA_TIMEOUT)}'
        return [events.FormulaAnswered(self.name, name, reason) for name in late]

    def expire(self, at: int) -> bool:
        """Return True if the peer has left, and nothing has been asked of it for `peer_timeout`.

        While a formula looks for another source, the objects that its error names must be known.
        """
        if self.is_present or self.requested or self._formulas:
            self._needed_at = at
        return at - self._needed_at >= self._settings.peer_timeout

    def request_formula(self, request: messages.FormulaRequest, at: int) -> None:
        """Ask it to evaluate a formula; see `Peer.request_formula`."""
        is_heard = self.is_present and not self.is_stale
        deadline = at + (FORMULA_TIMEOUT if is_heard else 0)
        self._formulas[request.stream] = _PendingFormula(request, at, deadline)

    def request(self, name: str, at: int, after: int, constants: tuple[float, ...] = ()) -> None:
        """Ask for a stream until it is released; see `Peer.request`."""
        if name not in self.requested:
            self.requested[name] = _Requested(
                ReceivedStream(name), PossibleValues(after), at, Precision(constants=constants)
            )
            self._probe_at = at

    def release(self, name: str) -> None:
        """Ask for a stream no more."""
        if self.requested.pop(name, None) is not None:
            self._granted = {key: each for key, each in self._granted.items() if each != name}
            self.send(messages.Release(name))

    def take(  # noqa: PLR0911 - one for each kind
        self, message: messages.Message, at: int
    ) -> list[PeerEvent]:
        """Take a message that answers what the own host has asked."""
        match message:
            case messages.Hello(version) if self._version < version:
                self.send(messages.SharesRequest())
            case messages.Shares(version) if self._version < version:
                return self._take_shares(message)
            case messages.Grant():
                return self._take_grant(message)
            case messages.Samples() | messages.Watermark():
                return [*self._take_samples(message, at)]
            case messages.RequestRefusal(stream, reason):
                return self._take_refusal(stream, reason, at)
            case messages.FormulaReply(stream, refusal) if self._formulas.pop(stream, None):
                return [events.FormulaAnswered(self.name, stream, refusal)]
            case messages.FormulaWait(stream, reason) if stream in self.requested:
                return [events.FormulaWaits(self.name, stream, self._with_own_times(reason))]
            case messages.ProbeReply():
                return self._take_reply(message, at)
        return []

    def _take_shares(self, shares: messages.Shares) -> list[PeerEvent]:
        self.shares, self._version = shares, shares.version
        for each in self.requested.values():
            each.is_refused = False
        return [events.SharesChanged(self.name, shares)]

    def check_stamp(self, stamp: int, at: int) -> list[PeerEvent]:
        """Notice a clock that has jumped ahead, by a stamp that is later than it can be."""
        return self._begin_times_anew(at) if self.clock.exceeds(stamp, at) else []

    def _take_grant(self, grant: messages.Grant) -> list[PeerEvent]:
        name, epoch = grant.stream, grant.epoch
        requested = self.requested.get(name)
        if requested is None:
            self.send(messages.Release(name))
            return []
        if grant.constants != requested.precision.constants:
            return []  # It is a late answer to an earlier request.
        shared = self.shares.features if self._version else ()
        exact = 0.0 if is_verdict(name) else None
        deadband = next((each.deadband for each in shared if each.stream == name), exact)
        former = requested.stream.epoch
        if epoch <= former or deadband is None:  # Without shares, the next request is granted, too.
            return []
        self._granted.pop(former, None)
        self._granted[epoch] = name
        requested.stream, requested.is_refused = ReceivedStream(name, epoch), False
        reasons = [f'{self.name} shares {name} with a deadband of {deadband}'] if deadband else []
        if constants := requested.precision.constants:
            compared = ', '.join(map(str, constants))
            own = self._settings.name
            reasons.append(f'{own} asks for {name} as compared with {compared} alone')
        requested.precision = Precision(deadband, constants, ', and '.join(reasons))
        return [self._lose(name, 0, 'the peer numbers its samples anew')] if former else []

    def _take_samples(self, message: messages.StreamMessage, at: int) -> Iterator[PeerEvent]:
        name = self._granted.get(message.epoch)
        if name is None:
            return  # The next request will be granted with this epoch.
        requested = self.requested[name]
        requested.stream.take(message)
        yield from self._deliver(name, at)
        if not requested.stream.is_complete:
            requested.due = min(requested.due, at + self._retry)

    def _take_refusal(self, name: str, reason: str, at: int) -> list[PeerEvent]:
        requested = self.requested.get(name)
        if requested is None or requested.is_refused:
            return []
        requested.is_refused = True
        text = f"peer '{self.name}' refuses it: {reason}"
        return [self._violation(name, ViolationKind.MESSAGE, text, at)]

    def _take_reply(self, reply: messages.ProbeReply, at: int) -> list[PeerEvent]:
        sent = reply.probe_sent_at
        if sent not in self._probes:
            return []
        self._probes.remove(sent)
        since = self.clock.latest
        jump = self.clock.measure(sent, reply.received_at, reply.sent_at, at)
        found: list[PeerEvent] = []
        if jump is not None:
            self._forget_values()
            found.append(events.ClockJumped(self.name, since))
        self._probe_at = at + PROBE_PERIOD * (1 if self.requested else UNUSED)
        if since is None or jump is not None:
            for name in self.requested:
                found += self._deliver(name, at)
        return found

    def _deliver(self, name: str, at: int) -> Iterator[PeerEvent]:
        """Yield what is due of a stream; nothing while its times cannot be translated."""
        if self.clock.latest is None:
            return
        values, precision = self.requested[name].values, self.requested[name].precision
        for each in self.requested[name].stream.deliveries():
            match each:
                case Lost():
                    yield self._lose(name, *each)
                case messages.StreamFault():
                    text = f"peer '{self.name}' reports: {self._with_own_times(each.reason)}"
                    time = min(self.clock.own_time(each.valid_time).earliest, at)
                    yield self._violation(name, each.constraint, text, time)
                case Received():
                    yield from self._put(name, each, at)
                case Promise(time):
                    # A clock that has jumped ahead promises more than is past.
                    if (earliest := self.clock.own_time(time).earliest) > self.clock.since:
                        values.promise(min(earliest, at))
            for time, value in values.take(partial(self.difference, at), precision):
                yield events.ValueKnown(self.name, name, time, value)
            if isinstance(each, Promise):
                yield events.WatermarkArrived(self.name, name, values.settled)

    def _put(self, name: str, received: Received, at: int) -> Iterator[PeerEvent]:
        """Take a sample, unless it cannot be dated; yield what is wrong with its time."""
        earliest, latest = self.clock.own_time(received.valid_time)
        if earliest < self.clock.since:
            yield self._lose(name, 1, f"the clock of peer '{self.name}' jumped after it")
            return
        if earliest > at + DEFAULT_MAX_LEAD:
            reason = f'it is valid at {round_time(earliest)}, which is still to come'
            yield self._lose(name, 1, reason)
            return
        limit = self._settings.max_uncertainty
        faults: list[str] = []
        if latest - earliest > 2 * limit:
            faults.append(f'more than a max_uncertainty of {format_duration(limit)}')
        value = received.value
        if is_verdict(name) and isinstance(value, str):
            value = self._with_own_times(value)
        if not self.requested[name].values.put(earliest, latest, value):
            faults.append(TOO_CLOSE)
        for each in faults:
            text = f'{self.difference(at)}; {each}'
            yield self._violation(name, ViolationKind.CLOCK, text, earliest)

    def _with_own_times(self, text: str) -> str:
        """Return a text of the peer for people with its times on the own clock.

        They are the latest possible ones, as is the valid time of a verdict.
        """
        if self.clock.latest is None:
            return text
        return with_changed_times(text, lambda time: self.clock.own_time(time).latest)

    def _lose(self, name: str, count: int, reason: str) -> PeerEvent:
        self.requested[name].values.lose()
        text = f"samples of peer '{self.name}' are lost: {reason}"
        self.lost += count
        return self._violation(name, ViolationKind.LOST, text)

    def _violation(
        self, name: str, constraint: str, reason: str, time: int | None = None
    ) -> PeerEvent:
        return events.StreamViolated(self.name, name, str(constraint), reason, time)

    def _forget_values(self) -> None:
        for each in self.requested.values():
            each.values = PossibleValues()

    def difference(self, at: int) -> str:
        """Return by how much its clock differs, as the beginning of a sentence."""
        offset = self.clock.offset(at)
        if offset is None:
            return f"the clock of '{self.name}' is not known"
        return f'the clocks of {self._settings.name} and {self.name} differ by {offset}'

    @property
    def _retry(self) -> int:
        return max(RETRY, 2 * (self.clock.delay or 0))

    def _send_request(self, requested: _Requested, at: int) -> None:
        stream = requested.stream
        is_settled = requested.is_refused or (stream.epoch and stream.is_complete)
        requested.due = at + (hello_period(self._settings) if is_settled else self._retry)
        self.send(replace(stream.request(), constants=requested.precision.constants))
