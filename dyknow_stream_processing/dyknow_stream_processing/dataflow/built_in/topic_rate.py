"""The rate of the messages of a topic, which falls to 0 in silence."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from itertools import takewhile
from typing import Final

from dyknow_common import SECOND_NS, Value, format_duration, round_time
from dyknow_stream_processing.dataflow.operators import NormalWait, Operator, Wiring
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
    window that contains such a loss has a rate.

    Args:
        window: its length, nanoseconds.
    """

    def __init__(self, wiring: Wiring, window: int) -> None:
        super().__init__(wiring, None, window // _SAMPLES)
        self._window = window
        self._first: int | None = None
        self._has_lost = False
        """True if messages before the next one are lost."""
        self._times: deque[int] = deque()
        """The valid times in the window, and of messages after it that came already."""

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Note the time of a message, and make the samples that it makes certain."""
        if self._has_lost:
            self._has_lost, self._first = False, valid_time
            text = (
                f'messages before {round_time(valid_time)} were lost, as their reader was stopped '
                'or had no processor'
            )
            self._violate(Fault(ViolationKind.LOST, valid_time, text))
        self._times.append(valid_time)
        if valid_time > max(self._tracks[port].last[0], self._last_tick):
            super().receive(port, valid_time, fields, watermark, now)
        else:  # A second message of a time counts, but settles no more than the first one.
            self.promise(port, watermark, now)

    def lose(self) -> None:
        """Note that messages before the next one are lost."""
        self._has_lost = self._first is not None or bool(self._times)

    def delay(self, name: Callable[[Operator], str]) -> str:
        """Return that the first window has not passed, or what delays the next sample."""
        if self._times and self.emitted_at is None:
            window = format_duration(self._window)
            return NormalWait(
                f'the rate of {name(self)} has its first value {window}{NormalWait.END}'
            )
        return super().delay(name)

    def _tick(self, valid_time: int, values: Values, now: int) -> None:
        del values
        if self._first is None:
            self._first = valid_time
        times, begin = self._times, valid_time - self._window
        while times and times[0] < begin:
            times.popleft()
        if self._first <= begin and not self._has_lost:
            later = sum(1 for _ in takewhile(lambda each: each >= valid_time, reversed(times)))
            hz = (len(times) - later) * SECOND_NS / self._window
            self._emit(valid_time, {'hz': hz}, valid_time, now)
