"""The clock of another host, compared with the own one.

An exchange of four stamps bounds the offset, as no message takes less than no time (NTP, RFC 5905,
without its assumption that both directions take the same time):

    own clock        10.000 s sent                        10.008 s received
    other clock                12.003 s received, 12.004 s sent

The offset was at most 12.003 - 10.000 = 2.003 s when the probe arrived, and at least
12.004 - 10.008 = 1.996 s when the reply was sent. Two clocks drift apart by at most `max_drift`, so
a bound grows wider with time, by the drift since the exchange. The offset lies within the bounds of
all exchanges, so exchanges with little delay count most, and one exchange after an outage narrows
the earlier bounds. Bounds that exclude each other prove that a clock has jumped.
"""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple

from dyknow_common import round_duration

MAX_DRIFT_PPM: Final = 120
"""The drift of two clocks from each other: 50 ppm each, as for quartz, and a reserve."""

MAX_MEASURES: Final = 64
"""The number of exchanges that are kept: each bounds the offset best at some time."""

BEGINNING: Final = -(2**63)
"""A time before all others."""

NEVER: Final = 2**63
"""A time after all others."""

_MILLION: Final = 1_000_000


class Offset(NamedTuple):
    """What a clock shows more than the own one, in nanoseconds, and how far the truth may be."""

    offset: int
    uncertainty: int

    def __str__(self) -> str:
        sign = '-' if self.offset < 0 else ''
        return (
            f'{sign}{round_duration(abs(self.offset))} plus or minus '
            f'{round_duration(self.uncertainty)}'
        )


class OwnTime(NamedTuple):
    """The first and the last time of the own clock that a time of another clock may be."""

    earliest: int
    latest: int


class _Bounds(NamedTuple):
    """The bounds of an offset at a time of the own clock."""

    at: int
    least: int
    most: int


class PairClock:
    """The offset of one other clock.

    Attributes:
        delay: the round trip of the last exchange, in nanoseconds; None before the first.
        since: the own time of the first exchange after the last jump: earlier times of the other
            clock cannot be translated.
    """

    def __init__(self) -> None:
        self.delay: int | None = None
        self.since = BEGINNING
        self._measures: deque[_Bounds] = deque(maxlen=MAX_MEASURES)

    @property
    def latest(self) -> int | None:
        """The own time of the last exchange since the last jump; None without one."""
        return self._measures[-1].at if self._measures else None

    def measure(self, sent: int, received: int, replied: int, arrived: int) -> int | None:
        """Take an exchange.

        Args:
            sent: when the probe was sent, by the own clock, in nanoseconds as all times.
            received: when the probe was received, by the other clock.
            replied: when the reply was sent, by the other clock.
            arrived: when the reply was received, by the own clock.

        Returns:
            By how much a clock has jumped, in nanoseconds; None if no jump is noticed.
        """
        delay = (arrived - sent) - (replied - received)
        # The stamps are up to a round trip apart, during which the clocks drift, too.
        drift = self._drift(arrived - sent)
        found = _Bounds(arrived, replied - arrived - drift, received - sent + drift)
        if found.least > found.most or arrived < sent or replied < received:
            self.begin_anew(arrived)
            return delay
        self.delay, jump = delay, None
        known = self._at(arrived) if self._measures else None
        if known and (found.least > known.most or found.most < known.least):
            jump = (found.least + found.most - known.least - known.most) // 2
            self.begin_anew(arrived)
        self._measures.append(found)
        return jump

    def begin_anew(self, at: int) -> None:
        """Forget all exchanges, as a clock was seen to have jumped at an own time."""
        self._measures.clear()
        self.since = at

    def exceeds(self, stamp: int, at: int) -> bool:
        """Return True if a stamp is later than it can be, given the own time of its receipt."""
        return bool(self._measures) and stamp - at > self._at(at).most

    def offset(self, at: int) -> Offset | None:
        """Return the offset at an own time, in nanoseconds; None if it is not known."""
        if not self._measures:
            return None
        bounds = self._at(at)
        half = -(-(bounds.most - bounds.least) // 2)
        return Offset(bounds.least + half, half)

    def own_time(self, time: int) -> OwnTime:
        """Convert a time of the other clock, whose offset must be known, to the own clock.

        The result may be before `since`: then the clock has not been measured at that time.
        """
        # The offset at the own time is needed to find the own time: it is taken at a guess, and
        # the bounds allow for the drift between the guess and all that is possible.
        latest = self._measures[-1]
        middle = (latest.least + latest.most) // 2
        bounds = self._at(time - middle)
        slack = self._drift(2 * max(middle - bounds.least, bounds.most - middle))
        return OwnTime(time - bounds.most - slack, time - bounds.least + slack)

    @staticmethod
    def _drift(duration: int) -> int:
        return abs(duration) * MAX_DRIFT_PPM // _MILLION + 1

    def _at(self, at: int) -> _Bounds:
        """Return the bounds of all exchanges at an own time."""
        drifts = [(each, self._drift(at - each.at)) for each in self._measures]
        least = max(each.least - drift for each, drift in drifts)
        most = min(each.most + drift for each, drift in drifts)
        return _Bounds(at, least, most)
