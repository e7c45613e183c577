"""The streams that others have asked for: their numbers, history and subscribers.

Samples are numbered, so that who receives them notices what is missing. A stream keeps its last
samples, and stays for as long after its last request: a peer that was cut off can still ask for
what it missed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from math import isnan
from typing import Final, NamedTuple

from dyknow_common import SECOND_NS, Value, format_time
from dyknow_federation import messages
from dyknow_federation.clocks import BEGINNING
from dyknow_federation.encoding import check_value
from dyknow_federation.errors import FederationError
from dyknow_federation.messages import Grant, Request, Samples, StreamFault, StreamMessage
from dyknow_federation.possible_values import Precision
from dyknow_stream_processing import ViolationKind

MAX_HISTORY: Final = 20_000
"""The number of samples of a stream that are kept for back-fill."""

MAX_RESENT: Final = 2_000
"""The number of samples that one request can ask for again."""

REFRESH: Final = 10 * SECOND_NS
"""When a value within the deadband is sent again: the time of an old one becomes uncertain."""


class Thinning:
    """Decides which samples of a stream are sent.

    The first sample without a known value is always sent: else a peer would take the last value
    for known.

    Args:
        every: the least time between two known samples, in nanoseconds; 0: no limit.
        deadband: how much a sample must differ from the last one; None: it need not differ.
        constants: if there are any, its comparison with one of them must have changed, too.
    """

    def __init__(
        self, every: int = 0, deadband: float | None = None, constants: tuple[float, ...] = ()
    ) -> None:
        self._every = every
        is_thin = constants or deadband is not None
        self._precision = Precision(deadband or 0, constants) if is_thin else None
        self._seen: int | None = None
        self._is_unknown = False
        self._passed = BEGINNING
        self._value: Value | None = None
        """The last sample that was outside the deadband."""
        self._told: object = None
        """What peers know of the last sample that was sent, if they compare it."""

    def passes(self, valid_time: int, value: Value) -> bool:
        """Return False for a sample that follows too soon, or says too little."""
        is_unknown = isinstance(value, float) and isnan(value)
        is_soon = self._seen is not None and 0 <= valid_time - self._seen < self._every
        if is_soon and (self._is_unknown or not is_unknown):
            return False
        self._seen, self._is_unknown = valid_time, is_unknown
        is_near, told = self._is_near(value), self._tells(value)
        is_known = is_near or (told is not None and told == self._told)
        if not is_near:
            self._value = value
        if is_known and valid_time - self._passed < REFRESH:
            return False
        self._passed, self._value, self._told = valid_time, value, told
        return True

    def forget(self) -> None:
        """Send the next sample that `every` lets pass: the last one may hold no more."""
        self._value = self._told = None

    def _tells(self, value: Value) -> object:
        if self._precision is None or not self._precision.constants:
            return None
        return value if isinstance(value, bool | str) else self._precision.ends(value)

    def _is_near(self, value: Value) -> bool:
        former = self._value
        if self._precision is None or former is None:
            return False
        if isinstance(value, bool | str) or isinstance(former, bool | str):
            return value == former
        error = self._precision.error
        # The bounds that peers calculate, with the same rounding; a value that is NaN is not near.
        return former - error <= value <= former + error


class _Kept(NamedTuple):
    valid_time: int
    content: messages.Content


@dataclass(slots=True)
class _Subscription:
    """A peer that receives a stream.

    Args:
        number: the number of the next sample for the peer.
        expires: when the subscription ends unless the request is repeated.
        promised: the last promise that the peer was sent.
    """

    number: int
    expires: int
    promised: int = BEGINNING


class SentStream:
    """An own stream, for all peers that have asked for it.

    Args:
        name: the name of the stream.
        epoch: the epoch of its numbers.
        history: how long samples are kept, in nanoseconds.
        thinning: decides which samples are sent; None: all are.
    """

    def __init__(
        self, name: str, epoch: int, history: int, thinning: Thinning | None = None
    ) -> None:
        self._name = name
        self._epoch = epoch
        self._history = history
        self._thinning = thinning or Thinning()
        self._kept: deque[_Kept] = deque(maxlen=MAX_HISTORY)
        self._number = 1
        self._latest = self._promised = BEGINNING
        self.subscribers: dict[str, _Subscription] = {}
        """The peers that receive it, by their names."""
        self.used_until = BEGINNING
        """When the last subscription has ended, or will end."""

    def publish(self, valid_time: int, value: Value) -> bool:
        """Number and keep a sample; return False if it need not be sent.

        Raises:
            FederationError: if it is not valid later than what was promised.
        """
        if valid_time <= self._promised:
            raise FederationError(
                f"a sample of '{self._name}' is valid at {format_time(valid_time)}, not "
                f'after {format_time(self._promised)}, as was promised'
            )
        self._promised = valid_time
        if not self._thinning.passes(valid_time, value):
            return False
        try:
            check_value(value)
        except FederationError as error:
            text = f"a value of '{self._name}' cannot cross: {error}"
            self.violate(StreamFault(valid_time, str(ViolationKind.FIELDS), text))
            return True
        self._latest = valid_time
        self._keep(_Kept(valid_time, value))
        return True

    def violate(self, fault: StreamFault) -> None:
        """Number and keep a violation."""
        self._thinning.forget()
        time = fault.valid_time if self._latest == BEGINNING else self._latest
        self._keep(_Kept(time, fault))

    def _keep(self, kept: _Kept) -> None:
        self._kept.append(kept)
        self._number += 1
        while kept.valid_time - self._kept[0].valid_time > self._history:
            self._kept.popleft()

    def promise(self, time: int) -> None:
        """Promise that all later samples are valid after a time."""
        self._promised = max(self._promised, time)

    def renew(self, peer: str, request: Request, expires: int) -> list[Grant | StreamMessage]:
        """Take a request of a peer, valid until `expires`; return the older messages it needs."""
        subscription = self.subscribers.get(peer)
        if subscription is None:
            known = request.number if request.epoch == self._epoch else self._number
            number = min(max(known, self._oldest), self._number)
            subscription = self.subscribers[peer] = _Subscription(number, expires)
        subscription.expires = expires
        self.used_until = max(self.used_until, expires)
        found: list[Grant | StreamMessage] = []
        if request.epoch != self._epoch:
            found.append(Grant(self._name, self._epoch, request.constants))
        else:
            left = MAX_RESENT
            for start, end in request.missing:
                first = max(start, self._oldest)
                last = min(end, self._number - 1, first + left - 1)
                found += self._batches(first, last)
                left -= max(0, last - first + 1)
        return [*found, self.watermark()]

    def continued(self, epoch: int) -> SentStream:
        """Return a new one for its subscribers, as the clock has jumped."""
        self._thinning.forget()
        found = SentStream(self._name, epoch, self._history, self._thinning)
        found.used_until = self.used_until
        for peer, each in self.subscribers.items():
            found.subscribers[peer] = _Subscription(found._number, each.expires)
        return found

    def release(self, peer: str) -> None:
        """End the subscription of a peer."""
        self.subscribers.pop(peer, None)

    def expire(self, at: int) -> None:
        """End the subscriptions that were not repeated until a time."""
        own = self.subscribers.items()
        self.subscribers = {peer: each for peer, each in own if each.expires > at}

    def unsent(self) -> Iterator[tuple[str, StreamMessage]]:
        """Yield the messages to send, each with its receiver."""
        for peer, subscription in self.subscribers.items():
            for batch in self._batches(max(subscription.number, self._oldest), self._number - 1):
                yield peer, batch
            subscription.number = self._number
            if self._promised > max(subscription.promised, self._latest):  # A sample is a promise.
                yield peer, self.watermark()
            subscription.promised = self._promised

    def watermark(self) -> messages.Watermark:
        """Return what is promised about the samples to come."""
        return messages.Watermark(self._epoch, self._number, self._oldest, self._promised)

    @property
    def _oldest(self) -> int:
        return self._number - len(self._kept)

    def _batches(self, first: int, last: int) -> Iterator[Samples]:
        """Yield what a range of numbers stands for, in batches."""
        start, number = first - self._oldest, first
        rows = islice(self._kept, start, max(start, last + 1 - self._oldest))
        while batch := list(islice(rows, messages.MAX_BATCH)):
            yield Samples(self._epoch, number, *zip(*batch, strict=True))
            number += len(batch)
