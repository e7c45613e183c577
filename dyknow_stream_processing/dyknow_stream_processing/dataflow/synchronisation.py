"""Synchronisation: the operator of `sync`, which joins streams at common valid times.

Example: `sync("a", "b")`. Every valid time is a tick; a tick is emitted once no input can still
deliver a sample for it (times in milliseconds):

    receive       emit
    a valid at 0  -                          (b may still deliver a sample valid at 0)
    b valid at 1  -                          (skips tick 0, at which b has no value)
    a valid at 2  tick 1: a of 0, b of 1
    b valid at 3  tick 2: a of 2, b of 1

Samples of an input with equal valid times follow each other a nanosecond apart, in the order of
arrival, unless they repeat the values: no value is lost, and all streams have the same ones.

With `sample_period = 2 ms` the ticks are 0, 2, 4, ..., and the same samples emit tick 2 only. With
a `max_delay` of 10 ms on b, tick 2 is emitted without another sample of b when the clock passes 12.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import Alternatives, Value, listed, round_duration, round_time
from dyknow_stream_processing.dataflow.approximations import LinearTrack, Track
from dyknow_stream_processing.dataflow.batches import (
    Planned,
    Refusal,
    SampleBatch,
    Settled,
    Times,
    is_increasing,
    latest,
    refuse,
)
from dyknow_stream_processing.dataflow.operators import Operator, Wiring
from dyknow_stream_processing.dataflow.scheduler import BEGINNING, END
from dyknow_stream_processing.errors import StreamError, open_value
from dyknow_stream_processing.language.type_rules import collision_text
from dyknow_stream_processing.violation import Fault, ViolationKind

Values = list['Mapping[str, Value]']
"""The fields of each input at one time."""

TickKey = tuple[str, int]
"""The label of a periodic operator without a start, and its period in nanoseconds."""

MAX_WAITING: Final = 10_000
"""The number of samples of an input that may wait for another input."""

MAX_TICKS: Final = 10_000
"""The number of ticks that are emitted at once when the time jumps."""

MAX_VALUES: Final = 100_000
"""The number of values of inputs in all these ticks."""


class SynchronisedOperator(Operator):
    """Base of the operators that process the values of all inputs at the same time, a tick.

    Without a period each valid time of a sample is a tick; with one, the ticks are
    `start + n * period`. A tick before every input has a value is skipped. Each tick is emitted as
    soon as all inputs are settled until then.

    The operator waits for one time, the *target*: the next tick, or else the first waiting sample.
    The tracks before the index `unsettled` are settled until the target, the track at that index
    is not. So a sample of any other input costs no more than its place in the queue.

    Args:
        start: the first tick, nanoseconds; `None`: the least first valid time.
        period: nanoseconds; `None`: each valid time is a tick.
    """

    _sorts = True
    _track: ClassVar[type[Track]] = Track

    def __init__(self, wiring: Wiring, start: int | None = None, period: int | None = None) -> None:
        super().__init__(wiring)
        self._tracks = [self._track(each) for each in self.inputs]
        self._period = period
        self._max_ticks = min(MAX_TICKS, max(1, MAX_VALUES // len(self.inputs)))
        self.tick_key: TickKey | None = None
        """Its name among the periodic operators; None for others, and for one with a start."""
        if period is not None and start is None:
            self.tick_key = self.label, period
        self.next_tick = None if period is None else start
        """The next tick of a periodic operator; None before the first one is known."""
        self._target: int | None = None
        self._unsettled = 0
        self._is_complete = False
        self._last_tick = BEGINNING
        self._first_possible_tick = BEGINNING
        self._is_overflowing = False

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Keep a sample until the other inputs are settled until its valid time."""
        track, target = self._tracks[port], self._target
        last_time, last_fields = track.last
        if valid_time <= last_time or valid_time <= self._last_tick:
            if fields == last_fields:
                self._drop('repeated')
                self.promise(port, watermark, now)
                return
            latest = max(last_time, self._last_tick)
            watermark = latest + 1 if watermark >= valid_time else watermark
            valid_time = latest + 1
        track.put(valid_time, fields, watermark)
        if self.next_tick is not None and self._period is not None:
            track.thin(self.next_tick, self._period)
            if not self._is_complete:
                self._wait_for(self._find_target())
        elif target is None or valid_time < target:
            self._target = valid_time
        if len(track.waiting) > MAX_WAITING:
            self._overflow(track)
        if port == self._unsettled or self._target != target:
            self._settle(now)
        elif self.consumers:
            self._promise(self._horizon(), now)

    def promise(self, port: int, watermark: int, now: int) -> None:
        """Emit the ticks that the promise makes certain."""
        self._tracks[port].promise(watermark)
        if port == self._unsettled:
            self._settle(now)
        elif self.consumers:
            self._promise(self._horizon(), now)

    def wake(self, now: int) -> None:
        """Emit the ticks that the clock makes certain."""
        self._settle(now, clock=now)

    def awaited(self) -> Iterable[Operator]:
        """Return the inputs that have never delivered, or else the ones that delay the target."""
        return self._silent() or [each.source for each in self._unsettled_tracks()] or self.inputs

    def delay(self, name: Callable[[Operator], str]) -> str:
        """Return which inputs delay the target, and for how long at most; empty without one."""
        if self._target is not None and (silent := self._silent()):
            return f'no sample of {listed(map(name, silent))} has come yet'
        delaying = self._unsettled_tracks()
        if self._target is None or not delaying:
            return ''
        sources = ', '.join(name(each.source) for each in delaying)
        ends = [each.certain_at(self._target) for each in delaying]
        limit = '' if None in ends else f', at most until {round_time(max(filter(None, ends)))}'
        return f'the sample at {round_time(self._target)} waits for later ones of {sources}{limit}'

    def _silent(self) -> list[Operator]:
        """Return the inputs that have never delivered."""
        return [each.source for each in self._tracks if each.latest is None and not each.waiting]

    def _unsettled_tracks(self) -> list[Track]:
        """Return the tracks that neither samples nor the clock have settled until the target."""
        target, now = self._target, self._scheduler.now
        if target is None:
            return []
        behind = [each for each in self._tracks if each.settled < target]
        ends = [each.certain_at(target) for each in behind]
        pairs = zip(behind, ends, strict=True)
        return [track for track, end in pairs if end is None or end > now]

    def _tick(self, valid_time: int, values: Values, now: int) -> None:
        raise NotImplementedError

    def _settle(self, now: int, clock: int | None = None) -> None:
        """Emit all ticks that samples, or the clock if it is given, make certain."""
        emitted = 0
        while (target := self._target) is not None and self._is_settled(target, clock):
            if self._period is not None and self._skips(target, self._period, emitted, clock):
                emitted = 0
            else:
                self._process(target, now)
                emitted += 1
        self._plan()
        if self.consumers:
            self._promise(self._horizon(), now)

    def _plan(self) -> None:
        """Wake when the clock may settle the target."""
        if self._target is not None and self.timed:
            certain = self._tracks[self._unsettled].certain_at(self._target)
            if certain is not None:
                self._scheduler.wake_at(self, certain)

    def _is_settled(self, target: int, clock: int | None) -> bool:
        tracks = self._tracks
        for index in range(self._unsettled, len(tracks)):
            track = tracks[index]
            if track.settled < target:
                certain = None if clock is None else track.certain_at(target)
                if clock is None or certain is None or certain > clock:
                    self._unsettled = index
                    return False
                track.settled = target
        self._unsettled = 0
        return True

    def _process(self, target: int, now: int) -> None:
        """Move all tracks to the target, and emit the tick if it is one."""
        values = [track.move_to(target) for track in self._tracks]
        is_tick = self._advance(target)
        known = [each for each in values if each is not None]
        self._is_complete = len(known) == len(values)
        self._is_overflowing = False
        self._target = self._find_target()
        if is_tick and self._is_complete and target >= self._first_possible_tick:
            self._last_tick = target
            self._tick(target, known, now)

    def _advance(self, target: int) -> bool:
        """Set the next tick after a time; return true if that time is a tick."""
        if self._period is None:
            return True
        # Without a start, the ticks begin at the first time that is settled for all inputs.
        tick = target if self.next_tick is None else self.next_tick
        self.next_tick = _first_tick(max(tick, target + 1), tick, self._period)
        return target >= tick and (target - tick) % self._period == 0

    def _wait_for(self, target: int | None) -> None:
        if target != self._target:
            self._target, self._unsettled = target, 0

    def _find_target(self) -> int | None:
        if self._is_complete and self.next_tick is not None:
            return self.next_tick
        heads = [track.waiting[0][0] for track in self._tracks if track.waiting]
        if self.next_tick is None or self._period is None:
            return min(heads, default=None)
        missing = [track for track in self._tracks if track.latest is None]
        if not all(track.waiting for track in missing):
            return min(heads, default=None)
        earliest = max([self.next_tick, *(track.waiting[0][0] for track in missing)])
        return _first_tick(earliest, self.next_tick, self._period)

    def _horizon(self) -> int:
        return min([track.settled for track in self._tracks])

    def _skips(self, target: int, period: int, emitted: int, clock: int | None) -> bool:
        """Skip to the last tick that is due if too many are due; return true if so."""
        # The time that the clock has jumped over if it wakes the operator late.
        lateness = 0 if clock is None else self._scheduler.now - clock
        if not self._is_complete or (
            emitted < self._max_ticks and lateness <= self._max_ticks * period
        ):
            return False
        until = max(target + lateness, self._horizon())
        last = until - (until - target) % period
        self.next_tick = last
        self._wait_for(last)
        message = (
            f'the time jumped by {round_duration(last - target)} at {round_time(target)}: '
            f'{(last - target) // period} ticks are skipped; the limit is {self._max_ticks} at once'
        )
        self._violate(Fault(ViolationKind.SAMPLE_PERIOD, target, message, last - target, period))
        return True

    def _overflow(self, track: Track) -> None:
        """Drop the oldest waiting sample; no tick before the next one is possible any more."""
        valid_time = track.waiting[0][0]
        track.move_to(valid_time)
        self._first_possible_tick = max(self._first_possible_tick, track.waiting[0][0])
        self._wait_for(self._find_target())
        self._drop(ViolationKind.BUFFER)
        if not self._is_overflowing:
            self._is_overflowing = True
            silent = min(self._tracks, key=lambda each: each.settled).source.label
            message = (
                f'{MAX_WAITING} samples of {track.source.label} wait for one of {silent}; the '
                f'oldest are dropped; give {silent} a max_delay to limit the wait'
            )
            self._violate(Fault(ViolationKind.BUFFER, valid_time, message))


class SyncOperator(SynchronisedOperator):
    """The fields of all inputs, joined."""

    def _tick(self, valid_time: int, values: Values, now: int) -> None:
        joined: dict[str, Value] = {}
        for fields in values:
            joined.update(fields)
        if len(joined) == sum(map(len, values)):
            self._emit(valid_time, joined, valid_time, now)
        else:
            self._reject(Fault(ViolationKind.FIELDS, valid_time, self._collision(values)))

    def step_many(self, inputs: Sequence[SampleBatch], end: int) -> Planned:
        """Plan all ticks that are certain at the end."""
        tracks, old_tick = self._tracks, self.next_tick
        samples = [each.samples(batch) for each, batch in zip(tracks, inputs, strict=True)]
        times = [each for each, _ in samples]
        self._check_order(inputs, times)
        pairs = list(zip(tracks, inputs, strict=True))
        until = min(each.settled_until(batch, end) for each, batch in pairs)
        settled = latest([each.settling(batch) for each, batch in pairs])
        targets, ticks, next_tick = self._targets(times, until)
        self._check_counts(inputs, times, targets, ticks, settled)
        columns: dict[str, NDArray[np.generic]] = {}
        for track, (known, values) in zip(tracks, samples, strict=True):
            if len(ticks) and not columns.keys().isdisjoint(values):
                refuse(Refusal.FIELDS)
            columns |= track.values_at(ticks, known, values) if len(ticks) else {}
        last_tick = int(ticks[-1]) if len(ticks) else self._last_tick

        def adopt() -> None:
            position = int(targets[-1]) if len(targets) else BEGINNING
            for track, each in zip(tracks, samples, strict=True):
                track.continue_from(position, *each)
            self._is_complete = all(each.latest is not None for each in tracks)
            self.next_tick, self._last_tick = next_tick, last_tick
            self._is_overflowing = self._is_overflowing and not len(targets)
            if next_tick is not None and old_tick is not None:
                self._thin(inputs, next_tick, BEGINNING)
            elif next_tick is not None:
                # Before the first target was processed, it was not known which ticks come.
                first = np.array([min(int(each[0]) for each in times if len(each))])
                self._thin(inputs, next_tick, int(settled(first, first)[0]))
            self._target, self._unsettled = self._find_target(), 0
            if self._target is not None:
                self._is_settled(self._target, None)
            self._plan()

        promised = max(last_tick, until) if self.consumers else last_tick
        return Planned(SampleBatch(ticks, columns, settled, None), promised, adopt)

    def _check_order(self, inputs: Sequence[SampleBatch], times: Sequence[Times]) -> None:
        """Refuse samples that are simultaneous, or come after a tick at which they are valid."""
        is_late = any((each.valid_times[:1] <= self._last_tick).any() for each in inputs)
        if is_late or not all(is_increasing(each, BEGINNING) for each in times):
            refuse(Refusal.ORDER)

    def _targets(self, times: Sequence[Times], until: int) -> tuple[Times, Times, int | None]:
        """Return the targets until a time, the ticks among them, and the tick after them.

        Args:
            times: the valid times of the samples of each track, the latest one included.
            until: the time until which all tracks are settled.
        """
        is_missing = [each.latest is None for each in self._tracks]
        new = [
            each if missing else each[1:] for each, missing in zip(times, is_missing, strict=True)
        ]
        heads = [
            each[:1].tolist() for each, missing in zip(new, is_missing, strict=True) if missing
        ]
        begin = max((each[0] if each else END for each in heads), default=BEGINNING)
        early = [each[: np.searchsorted(each, until, 'right')] for each in new]
        moves = early[0]
        if len(early) > 1:
            moves = np.sort(np.concatenate(early), kind='stable')
            moves = moves[np.diff(moves, prepend=BEGINNING) != 0]
        if self._period is None:
            return moves, moves[np.searchsorted(moves, begin) :], None
        if self.next_tick is None and not len(moves):
            return moves, moves, None
        tick = int(moves[0]) if self.next_tick is None else self.next_tick
        first = _first_tick(max(tick, begin), tick, self._period)
        ticks = np.arange(first, until + 1, self._period) if first <= until else moves[:0]
        if len(ticks) or not heads:
            return ticks, ticks, int(ticks[-1]) + self._period if len(ticks) else tick
        position = max(tick, int(moves[-1]) + 1) if len(moves) else tick
        return moves, ticks, _first_tick(position, tick, self._period)

    def _check_counts(
        self,
        inputs: Sequence[SampleBatch],
        times: Sequence[Times],
        targets: Times,
        ticks: Times,
        settled: Settled,
    ) -> None:
        """Refuse more ticks at once than are due, and more waiting samples than are kept."""
        if self._period is not None and len(ticks) >= self._max_ticks:
            _, counts = np.unique(settled(ticks, ticks), return_counts=True)
            if counts.max() >= self._max_ticks:
                refuse(Refusal.TICKS)
        if len(ticks) and int(ticks[0]) < self._first_possible_tick:
            refuse(Refusal.BUFFER)
        pairs = list(zip(self._tracks, inputs, strict=True))
        if all(len(track.waiting) + len(batch) <= MAX_WAITING for track, batch in pairs):
            return
        done, reached = settled(targets, targets), np.append(BEGINNING, targets)
        for (track, batch), known in zip(pairs, times, strict=True):
            position = reached[np.searchsorted(done, batch.emission_times())]
            moved = np.searchsorted(known, position, 'right')
            received = np.arange(len(known) - len(batch), len(known)) + 1
            waiting = received - np.maximum(moved, track.latest is not None)
            if (waiting > MAX_WAITING).any():
                refuse(Refusal.BUFFER)

    def _thin(self, inputs: Sequence[SampleBatch], tick: int, since: int) -> None:
        """Remove samples that were received after a time, wait, and are needed by no tick."""
        for track, batch in zip(self._tracks, inputs, strict=True):
            rows, track.waiting = track.waiting, deque()
            times = batch.emission_times().tolist()[-len(rows) :] if rows else []
            received = [BEGINNING] * (len(rows) - len(times)) + times
            for row, time in zip(rows, received, strict=True):
                track.waiting.append(row)
                if time > since and self._period is not None:
                    track.thin(tick, self._period)

    def _collision(self, values: Values) -> str:
        ports: dict[str, int] = {}
        name, second = next(
            (name, port)
            for port, fields in enumerate(values)
            for name in fields
            if ports.setdefault(name, port) != port
        )
        return collision_text(name, self.inputs[ports[name]].label, self.inputs[second].label)


class LinearSyncOperator(SyncOperator):
    """The fields of all inputs, joined; numbers are interpolated linearly."""

    _track = LinearTrack
    _open: StreamError | None = None
    """Why nothing can be interpolated any more."""

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Receive a sample, until the clocks of hosts leave the time of one open."""
        if self._open is None and not Alternatives.are_among(fields.values()):
            floats = {
                name: float(each) if type(each) is int else each for name, each in fields.items()
            }
            super().receive(port, valid_time, floats, watermark, now)
            return
        self._open = self._open or open_value(fields, 'interpolated')
        self._reject(Fault(ViolationKind.FIELDS, valid_time, self._open.message))
        self.promise(port, watermark, now)

    def certain_at(self, valid_time: int) -> int | None:
        """Return `None` for a time after the watermark, as only samples can make it certain."""
        return BEGINNING if valid_time <= self.watermark else None

    def certain_until(self, now: int) -> int:  # noqa: ARG002
        """Return the time until which samples, not the clock, have settled all inputs."""
        return max(self.watermark, self._horizon())


def _first_tick(earliest: int, tick: int, period: int) -> int:
    """Return the first tick that is not before a time, given any one tick."""
    return earliest + (tick - earliest) % period
