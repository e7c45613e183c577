"""The values that a stream of another host may have, at times of the own clock.

The valid time of a sample of another host is known up to an uncertainty. From its earliest possible
valid time on, the stream has either the value of the sample or an earlier value. From its latest
possible valid time on, earlier values are excluded. Both times are exact on the own clock. So only
the value is uncertain, and whatever joins streams by their valid times needs to know no more:

    sample    is valid at        own time    value
    1         0.90 s ± 50 ms     0.95 s      1
    2         2.02 s ± 50 ms     1.97 s      1 or 2
                                 2.07 s      2

The value at a time is known once no later sample can be valid until then. Where not all samples are
sent, it is known as `Precision` says: it is an interval, whichever samples are possible.
"""

from __future__ import annotations

from bisect import bisect
from collections import deque
from collections.abc import Callable, Iterator
from itertools import chain
from math import inf, isfinite, nextafter
from typing import Final, NamedTuple

from dyknow_common import MAX_ALTERNATIVES, Alternatives, Value
from dyknow_federation.clocks import BEGINNING

TOO_CLOSE: Final = (
    f'more than {MAX_ALTERNATIVES} samples may be valid at one time; share it at most once in some '
    "time with 'every'"
)
"""Why values are not known, after the difference of the clocks."""


class _Dated(NamedTuple):
    """A sample, with the bounds of its valid time."""

    earliest: int
    latest: int
    value: Value


class Precision(NamedTuple):
    """How exactly the value of a stream is known while no sample is sent.

    Args:
        error: how much the value may differ from the last sample.
        constants: if there are any, the value may also be any number that compares with each
            constant as some number within the error does.
        reason: why the value is not known better.
    """

    error: float = 0
    constants: tuple[float, ...] = ()
    reason: str = ''

    def ends(self, value: float) -> tuple[float, float]:
        """Return the least and the greatest value that is possible after a sample."""
        if not isfinite(value):
            return value, value
        least = most = value
        if self.error:  # Outwards, as sums are rounded.
            least, most = nextafter(value - self.error, -inf), nextafter(value + self.error, inf)
        bounds = (-inf, *self.constants, inf)
        if self.constants and least not in bounds:
            least = nextafter(bounds[bisect(bounds, least) - 1], inf)
        if self.constants and most not in bounds:
            most = nextafter(bounds[bisect(bounds, most)], -inf)
        return least, most


EXACT: Final = Precision()


class PossibleValues:
    """The values of one stream.

    Args:
        after: values are told after this time.
    """

    def __init__(self, after: int = BEGINNING) -> None:
        self.settled = after
        """No later sample is valid until this time."""
        self._told = after
        self._value: Value | None = None
        # The sample that is certainly valid, if any is, and the samples that may be valid.
        self._samples: deque[_Dated] = deque()

    def put(self, earliest: int, latest: int, value: Value) -> bool:
        """Take a sample and the bounds of its valid time; calls are in the order of the true times.

        Return False if too many may be valid at one time: then values are unknown until the last
        one is certain.
        """
        earliest = max(earliest, self.settled + 1)
        self._samples.append(_Dated(earliest, max(earliest, latest), value))
        self.settled = earliest
        is_known = len(self._samples) <= MAX_ALTERNATIVES
        if not is_known:
            self._samples, self._value = deque([self._samples[-1]]), None
        return is_known

    def promise(self, time: int) -> None:
        """Note that all later samples are certainly valid after a time."""
        self.settled = max(self.settled, time)

    def lose(self) -> None:
        """Note that samples are lost between the last one and the next one."""
        self._samples.clear()
        self._value = None

    def take(
        self, reason: Callable[[], str], precision: Precision = EXACT
    ) -> Iterator[tuple[int, Value]]:
        """Yield the values that have become known, each with the own time since which it holds.

        `reason` returns why several values are possible.
        """
        told, self._told = self._told, self.settled
        bounds = ((each.earliest, each.latest) for each in self._samples)
        times = {time for pair in bounds for time in pair if told < time <= self.settled}
        for time in sorted(times):
            begun = [each for each in self._samples if each.earliest <= time]
            certain = [number for number, each in enumerate(begun) if each.latest <= time]
            if not certain:
                continue
            for _ in range(certain[-1]):
                self._samples.popleft()
            value = _possible([each.value for each in begun[certain[-1] :]], reason, precision)
            if value != self._value or begun[-1].earliest == time:
                yield time, value
            self._value = value


def _possible(values: list[Value], reason: Callable[[], str], precision: Precision) -> Value:
    """Return a value that is one of some, as far as it is known."""
    numbers = [each for each in values if not isinstance(each, bool | str)]
    if (precision.error or precision.constants) and len(numbers) == len(values):
        reasons = [precision.reason, *([reason()] if len(values) > 1 else ())]
        ends = chain.from_iterable(map(precision.ends, numbers))
        return Alternatives.between([*numbers, *ends], ', and '.join(reasons))
    return Alternatives.of(values, reason()) if len(values) > 1 else values[0]
