"""A stream of a peer, as it is received: in order, each sample once.

Samples have numbers, so what is lost, late or doubled shows:

    receive                  deliver     ask for
    1, 2                     1, 2
    5                        -           3 to 4
    watermark after 6        -           3 to 4, 6
    3, 4, 6                  3, 4, 5, 6, the watermark
    6                        -           (a duplicate)
    watermark, oldest is 9   the loss of 7 and 8
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Final, NamedTuple

from dyknow_common import Value
from dyknow_federation import messages
from dyknow_federation.clocks import BEGINNING
from dyknow_federation.messages import Request, Samples, StreamFault, StreamMessage, Watermark

MAX_HELD: Final = 10_000
"""The number of samples of a stream that wait for earlier ones; later ones are asked for again."""


class Received(NamedTuple):
    """A sample in the clock of its sender."""

    valid_time: int
    value: Value


class Lost(NamedTuple):
    """Samples after the last delivered one are lost for good."""

    number: int
    """How many; 0 if that is not known."""
    reason: str


class Promise(NamedTuple):
    """All later samples are valid after a time of the sender's clock."""

    time: int


Delivery = Received | StreamFault | Lost | Promise
"""Something that the reader of a stream is told."""


class ReceivedStream:
    """A stream that was requested of a peer.

    Args:
        name: the name of the stream.
        epoch: the epoch of its numbers; 0: it is not granted yet.
    """

    def __init__(self, name: str, epoch: int = 0) -> None:
        self._name = name
        self.epoch = epoch
        self._held: dict[int, Received | StreamFault] = {}
        self._end = self._number = 0
        """All samples before `_number` are delivered or lost; all samples before `_end` exist."""
        self._oldest = 0
        self._watermark: Watermark | None = None
        self._promised = BEGINNING

    @property
    def is_complete(self) -> bool:
        """True if no sample is known to be missing."""
        return self._number >= self._end

    def request(self) -> Request:
        """Return the request that subscribes, acknowledges, and asks for what is missing."""
        return Request(self._name, self.epoch, self._number, tuple(self._missing()))

    def take(self, message: StreamMessage) -> None:
        """Take an answer of the peer; a watermark holds once all samples before it are settled."""
        if isinstance(message, Samples):
            self._begin(message.first)
            self._end = max(self._end, message.first + len(message.valid_times))
            rows = zip(message.valid_times, message.contents, strict=True)
            for number, (time, content) in enumerate(rows, message.first):
                held = content if isinstance(content, StreamFault) else Received(time, content)
                has_room = len(self._held) < MAX_HELD or number == self._number
                if has_room and number >= self._number:
                    self._held.setdefault(number, held)
            return
        # It begins with the latest one: a violation may be all that comes.
        self._begin(max(message.number - 1, message.oldest))
        self._end = max(self._end, message.number)
        self._oldest = max(self._oldest, min(message.oldest, message.number))
        former = self._watermark
        if former is None or (message.number, message.time) > (former.number, former.time):
            self._watermark = message

    def deliveries(self) -> Iterator[Delivery]:
        """Yield what is due, once."""
        held = deque(sorted(each for each in self._held if each < self._oldest))
        while self._number < self._end:
            if self._number in self._held:
                sample = self._held.pop(self._number)
                self._number += 1
                if isinstance(sample, StreamFault):
                    yield sample
                    continue
                if sample.valid_time <= self._promised:
                    yield Lost(1, f'it is valid at {sample.valid_time} ns, which is too early')
                    continue
                self._promised = sample.valid_time
                yield sample
            elif self._number < self._oldest:
                while held and held[0] < self._number:
                    held.popleft()
                end = held[0] if held else self._oldest
                count, self._number = end - self._number, end
                yield Lost(count, 'the peer keeps them no more')
            else:
                break
        watermark = self._watermark
        if watermark and watermark.number <= self._number and watermark.time > self._promised:
            self._promised = watermark.time
            yield Promise(watermark.time)

    def _begin(self, number: int) -> None:
        """Begin with the first number that the peer tells, if there was none."""
        if not self._number:
            self._number = self._end = number

    def _missing(self) -> Iterator[tuple[int, int]]:
        """Yield the first ranges that are missing."""
        number, count = self._number, 0
        for held in [*sorted(self._held), self._end]:
            if number < held:
                yield number, held - 1
                count += 1
            if count == messages.MAX_RANGES:
                return
            number = held + 1
