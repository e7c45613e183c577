"""The rate of the messages of a topic, which falls to 0 in silence."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from itertools import takewhile
from typing import Final

from dyknow_common import SECOND_NS, Value, format_duration, round_time
from dyknow_stream_processing.dataflow.operators import NormalWait, Operator, Wiring
from dyknow_stream_processing.dataflow.scheduler import BEGINNING, END
from dyknow_stream_processing.dataflow.synchronisation import SynchronisedOperator, Values
from dyknow_stream_processing.violation import Fault, ViolationKind

_SAMPLES: Final = 10
"""The samples of a rate in each window."""


class RateOperator(SynchronisedOperator):
    """The number of messages in the window before each tick, by its length.

    Ticks count from the first message, and there is no sample before a whole window has passed. A
    message at a tick is not in the window that ends there: so 10 Hz are 10 messages in 1 s, and no
    tick need wait for a second message of its time.

    Messages that are lost because the own process was stopped are not missing from the topic: no
    window that contains such a loss has a rate. After each pause of the process, the operator is in
    *doubt*: it holds the ticks back whose windows begin before the end of the pause, until a later
    message of each publisher proves how many are lost. Without these, it gives no such rate.

    Args:
        window: its length, nanoseconds.
    """

    def __init__(self, wiring: Wiring, window: int) -> None:
        super().__init__(wiring, None, window // _SAMPLES)
        self._window = window
        self._first: int | None = None
        self._doubted_until: int | None = None
        self._is_proven = False
        """True if the next message ends the doubt."""
        self._drops = 0
        """The number of messages that had been dropped when the doubt began."""
        self._has_lost = False
        """True if messages before the next one are lost."""
        self._lost_until = BEGINNING
        self._times: deque[int] = deque()
        """The valid times in the window, and of messages after it that came already."""

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Note the time of a message, and make the samples that it makes certain."""
        if self._has_lost:
            self._lose_before(valid_time, 'were')
        if self._is_proven:
            self._end_doubt()
        self._times.append(valid_time)
        if valid_time > max(self._tracks[port].last[0], self._last_tick):
            super().receive(port, valid_time, fields, watermark, now)
        else:  # A second message of a time counts, but settles no more than the first one.
            self.promise(port, watermark, now)

    def doubt(self, until: int) -> None:
        """Note that messages that were sent before a time may be lost, as the process paused."""
        if self._doubted_until is None:
            self._drops = self._dropped()
        self._doubted_until, self._is_proven = until, False
        self._plan()

    def lose(self) -> None:
        """Note that messages before the next one are lost, if there is a doubt."""
        self._has_lost = self._doubted_until is not None

    def trust(self) -> None:
        """Note that no messages before the next one are lost, but those that are noted."""
        self._is_proven = self._doubted_until is not None

    def certain_at(self, valid_time: int) -> int | None:
        """Return `None` for ticks that are held back, as only a message can make them certain."""
        return None if valid_time >= self._held_from() else super().certain_at(valid_time)

    def certain_until(self, now: int) -> int:
        """Return the latest certain time, which is before the ticks that are held back."""
        return min(super().certain_until(now), self._held_from() - 1)

    def delay(self, name: Callable[[Operator], str]) -> str:
        """Return that the first window has not passed, or what delays the next sample."""
        if self._times and self.emitted_at is None:
            window = format_duration(self._window)
            return NormalWait(
                f'the rate of {name(self)} has its first value {window}{NormalWait.END}'
            )
        return super().delay(name)

    def _held_from(self) -> int:
        """Return the first tick that is held back; END without one."""
        target, until = self._target, self._doubted_until
        if target is None or until is None or target - self._window >= until:
            return END
        return target

    def _horizon(self) -> int:
        return min(super()._horizon(), self._held_from() - 1)

    def _is_settled(self, target: int, clock: int | None) -> bool:
        until = self._doubted_until
        if until is not None and target == self._held_from():
            # Messages prove nothing: each of another publisher may still do so.
            is_over = clock is not None or self.vouched
            if not is_over or not super()._is_settled(until + self._window, clock):
                return False
            self._lose_before(until, 'may have been')
            self._end_doubt()
        return super()._is_settled(target, clock)

    def _plan(self) -> None:
        until = self._doubted_until
        if until is None or self._held_from() == END:
            super()._plan()
        elif (certain := self._tracks[0].certain_at(until + self._window)) is not None:
            self._scheduler.wake_at(self, certain)

    def _end_doubt(self) -> None:
        until, self._doubted_until, self._is_proven = self._doubted_until, None, False
        if until is not None and self._lost_until < until and self._dropped() != self._drops:
            self._lose_before(until, 'may have been')

    def _lose_before(self, valid_time: int, were: str) -> None:
        self._has_lost, self._lost_until = False, max(self._lost_until, valid_time)
        text = (
            f'messages before {round_time(valid_time)} {were} lost, as their reader was stopped or '
            'had no processor'
        )
        self._violate(Fault(ViolationKind.LOST, valid_time, text))

    def _dropped(self) -> int:
        """Return the number of messages that were dropped before they came here."""
        return sum(each.dropped.total() for each in self.sources)

    def _tick(self, valid_time: int, values: Values, now: int) -> None:
        del values
        if self._first is None:
            self._first = valid_time
        times, begin = self._times, valid_time - self._window
        while times and times[0] < begin:
            times.popleft()
        if max(self._first, self._lost_until) <= begin:
            later = sum(1 for _ in takewhile(lambda each: each >= valid_time, reversed(times)))
            hz = (len(times) - later) * SECOND_NS / self._window
            self._emit(valid_time, {'hz': hz}, valid_time, now)
