"""Timing of a topic, measured from the times of its messages, and constraints that it keeps.

A topic whose messages were stamped and received at these times, in ms, is observed until 420:

    stamp       0   100   200   300   400
    received    4   103   212   305   403

The delays are 4, 3, 12, 5 and 3 ms, the intervals of the stamps 100 ms. The greatest delay with a
margin of half of it is 18 ms, rounded up to 20 ms; a deviation is at least a tenth of the period.
So the topic keeps, and is expected to keep:

    max_delay = 20 ms, sample_period = 100 ms, sample_period_deviation = 10 ms
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import (
    NANOSECONDS,
    SECOND_NS,
    StreamConstraints,
    format_duration,
    round_duration,
)

LEAST_BOUND_NS: Final = 10 * NANOSECONDS['ms']
"""The shortest delay or lead that is proposed: a busy computer delays messages as much."""

MAX_OFFSET_NS: Final = 60 * SECOND_NS
"""The delay from which on the stamps are taken to be of another clock."""

LEAST_INTERVALS: Final = 4
"""The number of intervals from which on a period is proposed."""

TOLERANT_BOUND_NS: Final = 500 * NANOSECONDS['ms']
"""The shortest delay or gap at which a topic is late for a robot.yaml that `init` proposes."""

TOLERATED_PERIODS: Final = 3
"""The length of a gap that is tolerated there: two samples in a row may be lost."""

_STEPS: Final = (100, 120, 150, 200, 250, 300, 400, 500, 600, 800, 1000)
"""The rounded numbers between two powers of ten, in hundredths of the lower one."""


@dataclass(frozen=True, slots=True, eq=False)
class TopicTimes:
    """The times of the messages of a topic, in nanoseconds and in the order of their receipt.

    Args:
        valid_times: the stamps, or the times of receipt where they are unset; of shape (n,).
        receipt_times: of shape (n,).
        end: the time until which the topic was observed.
        is_stamped: False if the messages have no stamp.
        unset: True for each message whose stamp is unset; of shape (n,), or None without stamps.
    """

    valid_times: NDArray[np.int64]
    receipt_times: NDArray[np.int64]
    end: int
    is_stamped: bool = True
    unset: NDArray[np.bool_] | None = None

    @classmethod
    def of(
        cls, stamps: NDArray[np.int64] | None, receipt_times: NDArray[np.int64], end: int
    ) -> TopicTimes:
        """Return the times of messages.

        Args:
            stamps: 0 where one is unset; at the receipt of 0, such as in a trace, 0 is a stamp.
                None without stamps.
            receipt_times: the receipt times of the messages.
            end: the time until which the topic was observed.
        """
        if stamps is None:
            return cls(receipt_times, receipt_times, end, is_stamped=False)
        unset = (stamps == 0) & (receipt_times != 0)
        return cls(np.where(unset, receipt_times, stamps), receipt_times, end, unset=unset)

    @property
    def delays(self) -> NDArray[np.int64]:
        """The time from the stamp of each message to its receipt; negative where it is ahead."""
        return self.receipt_times - self.valid_times

    @property
    def intervals(self) -> NDArray[np.int64]:
        """The distances of consecutive valid times."""
        ordered = np.sort(self.valid_times)
        return ordered[1:] - ordered[:-1]

    @property
    def disorders(self) -> int:
        """The number of messages with an earlier valid time than one before."""
        latest = np.maximum.accumulate(self.valid_times)
        return int(np.count_nonzero(self.valid_times < latest))

    @property
    def silence(self) -> int:
        """The time from the last valid time, or receipt if that is later, to the end."""
        if not len(self.valid_times):
            return 0
        return max(0, self.end - int(max(self.valid_times.max(), self.receipt_times.max())))


@dataclass(frozen=True, slots=True)
class TopicTiming:
    """Figures of the times of a topic, in nanoseconds.

    Args:
        count: the number of messages.
        duration: the time from the first to the last valid time.
        interval: the median of the distances of consecutive valid times; None for one message.
        least_interval: the shortest of the distances.
        greatest_interval: the longest of the distances.
        jitter: their standard deviation.
        delays: the median, the percentiles 95 and 99 and the greatest of the times from stamp to
            receipt; None without stamps.
        lead: the greatest time by which a message was stamped ahead of its receipt.
        disorders: the number of messages with an earlier valid time than one before.
        silence: the time without a message at the end.
    """

    count: int
    duration: int
    interval: int | None
    least_interval: int
    greatest_interval: int
    jitter: int
    delays: tuple[int, int, int, int] | None
    lead: int
    disorders: int
    silence: int

    @property
    def rate(self) -> float | None:
        """The number of messages in a second; None if it is unknown."""
        return (self.count - 1) * SECOND_NS / self.duration if self.duration else None


def timing_of(times: TopicTimes) -> TopicTiming:
    """Return the figures of a topic that had at least one message."""
    intervals, delays = times.intervals, times.delays
    percentiles = None
    if times.is_stamped:
        found = np.percentile(delays, (50, 95, 99, 100), method='higher')
        median, most, nearly_all, greatest = map(int, found)
        percentiles = median, most, nearly_all, greatest
    return TopicTiming(
        count=len(delays),
        duration=int(intervals.sum()),
        interval=int(np.median(intervals)) if len(intervals) else None,
        least_interval=int(intervals.min(initial=np.iinfo(np.int64).max)) if len(intervals) else 0,
        greatest_interval=int(intervals.max(initial=0)),
        jitter=int(intervals.std()) if len(intervals) else 0,
        delays=percentiles,
        lead=max(0, -int(delays.min())),
        disorders=times.disorders,
        silence=times.silence,
    )


@dataclass(frozen=True, slots=True)
class ProposedTiming:
    """Constraints that topics keep, and the reasons for constraints that are not proposed.

    Args:
        constraints: the constraints, with a margin.
        remarks: sentences about what could not be proposed.
    """

    constraints: StreamConstraints
    remarks: tuple[str, ...] = ()


def proposed_timing(topics: Sequence[TopicTimes]) -> ProposedTiming:
    """Return constraints that all of some topics of one kind have kept, each with messages."""
    found: dict[str, Any] = {}
    remarks = []
    if any(each.is_stamped for each in topics):
        delay = max(int(each.delays.max()) for each in topics)
        lead = max(-int(each.delays.min()) for each in topics)
        if delay > MAX_OFFSET_NS:
            remarks.append('The stamps are long before the receipt: compare the clocks.')
        else:
            found['max_delay'] = max(LEAST_BOUND_NS, rounded_up(with_margin(delay)))
        if lead > 0:
            found['max_lead'] = max(LEAST_BOUND_NS, rounded_up(with_margin(lead)))
    else:
        remarks.append('The messages have no stamps: a value holds from the time of its sending.')
    if any(each.disorders for each in topics):
        if 'max_delay' in found:
            found['reorder'] = True
        else:
            remarks.append('The stamps are not in order.')
    intervals = np.concatenate([each.intervals for each in topics])
    if len(intervals) < LEAST_INTERVALS:
        remarks.append('There were too few messages to measure their period: observe more of them.')
        return ProposedTiming(StreamConstraints(**found), tuple(remarks))
    silence = max(each.silence for each in topics)
    longest = max(int(intervals.max()), silence)
    period = rounded(int(np.median(intervals)))
    worst = max(period - int(intervals.min()), longest - period)
    if period > 0 and worst <= period:
        found['sample_period'] = period
        least = max(with_margin(worst), period // 10)
        found['sample_period_deviation'] = min(period, rounded_up(least))
    elif longest <= 0:
        remarks.append('All messages have one stamp: it tells no period.')
    else:
        remarks.append('The messages have no regular period.')
        found['max_gap'] = rounded_up(with_margin(longest))
    return ProposedTiming(StreamConstraints(**found), tuple(remarks))


def tolerant(timing: ProposedTiming) -> ProposedTiming:
    """Return constraints that topics also keep when a computer is busy for a moment.

    What was measured within seconds is not kept for days: 10 Hz, give or take 10 ms, with delays of
    up to 20 ms becomes max_gap = 500 ms, max_delay = 500 ms. Samples that are put in order wait for
    `max_delay`, so it stays as it was measured then.
    """
    stated = timing.constraints
    delay, longest = stated.max_delay, stated.longest_period or stated.max_gap
    if delay is not None and not stated.reorder:
        delay = max(delay, TOLERANT_BOUND_NS)
    gap = None
    if longest is not None:
        gap = max(rounded_up(TOLERATED_PERIODS * longest), TOLERANT_BOUND_NS)
    others = {'sample_period': None, 'sample_period_deviation': None}
    return replace(timing, constraints=replace(stated, max_delay=delay, max_gap=gap, **others))


def with_margin(duration: int) -> int:
    """Return a duration that is half as long again."""
    return ceil(duration * 3 / 2) if duration > 0 else 0


def rounded_up(duration: int) -> int:
    """Return the next rounded number of nanoseconds, such as 15 ms for 12.3 ms."""
    if duration <= _STEPS[0]:
        return max(duration, 0)
    power: int = 10 ** (len(str(duration)) - 3)
    return next(step * power for step in _STEPS if step * power >= duration)


def rounded(duration: int) -> int:
    """Return a duration with three significant digits."""
    power: int = 10 ** max(0, len(str(duration)) - 3)
    return (duration + power // 2) // power * power


def broken_constraints(times: TopicTimes, stated: StreamConstraints) -> Iterator[str]:
    """Yield a sentence with the mend for each stated constraint that a topic did not keep."""
    proposed = proposed_timing([times]).constraints
    delays, intervals = times.delays, times.intervals
    for name, sign in (('max_delay', 1), ('max_lead', -1)):
        bound, own = getattr(stated, name), sign * delays
        if bound is not None and times.is_stamped and (late := int((own > bound).sum())):
            kind = 'delay' if sign > 0 else 'lead'
            text = f'{late} of {len(own)} messages break {name} = {format_duration(bound)}, with a '
            yield (
                text + f'{kind} of up to {round_duration(int(own.max()))}; {_mend(name, proposed)}'
            )
    if len(intervals):
        yield from _broken_intervals(intervals, stated, proposed)


def _broken_intervals(
    intervals: NDArray[np.int64], stated: StreamConstraints, proposed: StreamConstraints
) -> Iterator[str]:
    measured = f'{round_duration(int(intervals.min()))} to {round_duration(int(intervals.max()))}'
    shortest, longest = stated.shortest_period, stated.longest_period
    gap = None if stated.expires else stated.max_gap
    if shortest is not None and longest is not None:
        broken = int(((intervals < shortest) | (intervals > longest)).sum())
        if broken:
            allowed = f'{format_duration(shortest)} and {format_duration(longest)}'
            text = f'{broken} of {len(intervals)} intervals are not between {allowed}, but'
            yield f'{text} {measured}; {_mend("sample_period", proposed)}'
    if gap is not None and (broken := int((intervals > gap).sum())):
        text = f'{broken} of {len(intervals)} intervals break max_gap = {format_duration(gap)}'
        least = format_duration(rounded_up(with_margin(int(intervals.max()))))
        yield f'{text}: they are {measured}; write max_gap = {least}'


def _mend(name: str, proposed: StreamConstraints) -> str:
    given = {each: text for each, text in proposed.texts().items() if each.startswith(name)}
    if not given:
        return f'remove {name}: the topic does not keep any'
    return 'write ' + ', '.join(f'{each} = {text}' for each, text in given.items())
