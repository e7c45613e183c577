"""Bringing streams together at common valid times: the operator of `sync`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, Final

from dyknow_common import Value, round_duration, round_time
from dyknow_stream_processing.dataflow.approximations import LinearTrack, Track
from dyknow_stream_processing.dataflow.operators import Operator
from dyknow_stream_processing.dataflow.scheduler import BEGINNING, Scheduler
from dyknow_stream_processing.language.type_rules import collision_text
from dyknow_stream_processing.violation import Broken

Values = list['Mapping[str, Value]']
"""The fields of each input at one time."""

MOST_WAITING: Final = 10_000
"""How many samples of an input may wait for those of another."""

MOST_TICKS: Final = 10_000
"""How many ticks are made at once when the time leaps."""


class SynchronisedOperator(Operator):
    """Does something with the values that its inputs have at the same time, a tick.

    Without a period the ticks are the valid times of all samples; with one, they are
    `start + n * period`. A tick before every input has a value is skipped. Each tick is made as
    soon as all inputs are settled until then.

    One time is waited for, the *target*: the next tick, or else the first sample that waits. The
    tracks before the number `unsettled` are settled until then, the one with that number is not.
    So the sample of any other input costs no more than its place in the queue.

    Args:
        start: the first tick, nanoseconds; `None` is the least first valid time.
        period: nanoseconds; `None` makes each valid time a tick.
    """

    _track: ClassVar[type[Track]] = Track

    def __init__(
        self,
        agenda: Scheduler,
        label: str,
        inputs: Sequence[Operator],
        start: int | None = None,
        period: int | None = None,
    ) -> None:
        super().__init__(agenda, label, inputs, in_order=True)
        self._tracks = [self._track(each) for each in inputs]
        self._period = period
        self._next_tick = None if period is None else start
        self._target: int | None = None
        self._unsettled = 0
        self._complete = False
        self._last = BEGINNING
        self._floor = BEGINNING
        self._overflowing = False

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Keep a sample until the others have come."""
        track, target = self._tracks[port], self._target
        if valid_time <= self._last:
            track.correct(valid_time, fields)
            track.promise(watermark)
            self._drop('superseded')
        else:
            track.put(valid_time, fields, watermark)
            if self._next_tick is not None:
                self._thin(track)
            elif target is None or valid_time < target:
                self._target = valid_time
            if len(track.waiting) > MOST_WAITING:
                self._overflow(track)
        if port == self._unsettled or self._target != target:
            self._settle(now)
        elif self.consumers:
            self._promise(self._horizon(), now)

    def promise(self, port: int, watermark: int, now: int) -> None:
        """Make the ticks that have become certain."""
        self._tracks[port].promise(watermark)
        if port == self._unsettled:
            self._settle(now)
        elif self.consumers:
            self._promise(self._horizon(), now)

    def wake(self, now: int) -> None:
        """Make the ticks that the clock has made certain."""
        self._settle(now, clock=now)

    def _tick(self, valid_time: int, values: Values, now: int) -> None:
        raise NotImplementedError

    def _settle(self, now: int, clock: int | None = None) -> None:
        """Make all ticks that samples, or the clock, have made certain."""
        made = 0
        while (target := self._target) is not None and self._is_settled(target, clock):
            if self._period is not None and self._leaps(target, self._period, made, clock):
                made = 0
            else:
                self._make(target, now)
                made += 1
        if target is not None and self.timed:
            certain = self._tracks[self._unsettled].certain_at(target)
            if certain is not None:
                self._agenda.wake_at(self, certain)
        if self.consumers:
            self._promise(self._horizon(), now)

    def _is_settled(self, target: int, clock: int | None) -> bool:
        tracks = self._tracks
        for number in range(self._unsettled, len(tracks)):
            track = tracks[number]
            if track.settled < target:
                certain = None if clock is None else track.certain_at(target)
                if clock is None or certain is None or certain > clock:
                    self._unsettled = number
                    return False
                track.settled = target
        self._unsettled = 0
        return True

    def _make(self, target: int, now: int) -> None:
        values = [track.reach(target) for track in self._tracks]
        is_tick = self._advance(target)
        known = [each for each in values if each is not None]
        self._complete = len(known) == len(values)
        self._overflowing = False
        self._target = self._find_target()
        if is_tick and self._complete and target >= self._floor:
            self._last = target
            self._tick(target, known, now)

    def _advance(self, target: int) -> bool:
        """Leave a time behind; true if it was a tick."""
        if self._period is None:
            return True
        # The first time that is certain of all is where ticks without a start begin.
        tick = target if self._next_tick is None else self._next_tick
        self._next_tick = _tick_from(max(tick, target + 1), tick, self._period)
        return target >= tick and (target - tick) % self._period == 0

    def _thin(self, track: Track) -> None:
        """Keep of a new sample's track what ticks need, and see whether they can begin."""
        if self._next_tick is not None and self._period is not None:
            track.thin(self._next_tick, self._period)
            if not self._complete:
                self._wait_for(self._find_target())

    def _wait_for(self, target: int | None) -> None:
        if target != self._target:
            self._target, self._unsettled = target, 0

    def _find_target(self) -> int | None:
        if self._complete and self._next_tick is not None:
            return self._next_tick
        heads = [track.waiting[0][0] for track in self._tracks if track.waiting]
        if self._next_tick is None or self._period is None:
            return min(heads, default=None)
        missing = [track for track in self._tracks if track.latest is None]
        if not all(track.waiting for track in missing):
            return min(heads, default=None)
        earliest = max([self._next_tick, *(track.waiting[0][0] for track in missing)])
        return _tick_from(earliest, self._next_tick, self._period)

    def _horizon(self) -> int:
        return min([track.settled for track in self._tracks])

    def _leaps(self, target: int, period: int, made: int, clock: int | None) -> bool:
        """Leave out all ticks that are due but the last, if they are too many."""
        # The time that the clock has leapt over, when it wakes the operator late.
        lateness = 0 if clock is None else self._agenda.now - clock
        if not self._complete or (made < MOST_TICKS and lateness <= MOST_TICKS * period):
            return False
        until = max(target + lateness, self._horizon())
        last = until - (until - target) % period
        self._next_tick = last
        self._wait_for(last)
        message = (
            f'the time leapt by {round_duration(last - target)} at {round_time(target)}: '
            f'{(last - target) // period} ticks are left out; {MOST_TICKS} are made at once'
        )
        self._violate(Broken.SAMPLE_PERIOD, target, message, last - target, period)
        return True

    def _overflow(self, track: Track) -> None:
        """Drop the oldest sample that waits; ticks before the next one cannot be made any more."""
        valid_time = track.waiting[0][0]
        track.reach(valid_time)
        self._floor = max(self._floor, track.waiting[0][0])
        self._wait_for(self._find_target())
        self._drop(Broken.BUFFER)
        if not self._overflowing:
            self._overflowing = True
            self._violate(Broken.BUFFER, valid_time, self._overflow_text(track))

    def _overflow_text(self, track: Track) -> str:
        silent = min(self._tracks, key=lambda each: each.settled).source.label
        return (
            f'{MOST_WAITING} samples of {track.source.label} wait for one of {silent}; the oldest '
            f'are dropped; with a max_delay of {silent}, the clock decides how long to wait'
        )


class SyncOperator(SynchronisedOperator):
    """Joins the fields of all inputs."""

    def _tick(self, valid_time: int, values: Values, now: int) -> None:
        joined: dict[str, Value] = {}
        for fields in values:
            joined.update(fields)
        if len(joined) == sum(map(len, values)):
            self._emit(valid_time, joined, valid_time, now)
        else:
            self._reject(Broken.FIELDS, valid_time, self._collision(values))

    def _collision(self, values: Values) -> str:
        owners: dict[str, int] = {}
        for port, fields in enumerate(values):
            for name in fields:
                first = owners.setdefault(name, port)
                if first != port:
                    return collision_text(name, self.inputs[first].label, self.inputs[port].label)
        raise AssertionError  # pragma: no cover - called for a collision only


class LinearSyncOperator(SyncOperator):
    """Joins the fields of all inputs, numbers by linear interpolation."""

    _track = LinearTrack

    def certain_at(self, valid_time: int) -> int | None:
        """Only samples tell what lies before them."""
        return BEGINNING if valid_time <= self.watermark else None


def _tick_from(earliest: int, tick: int, period: int) -> int:
    """The first tick that is not before a time, given any one tick."""
    return earliest + (tick - earliest) % period
