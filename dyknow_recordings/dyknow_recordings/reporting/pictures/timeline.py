"""Verdicts over time: the outcomes of the episodes of a formula, as segments of a line."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, groupby, pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import MAX_OFFSET_NS, NANOSECONDS, DyKnowError
from dyknow_reasoning import Always, Eventually, Formula, Term, Until, parse_formula, parts
from dyknow_recordings.evaluation.results import Episode, FormulaReport, Outcome, RecordingReport

MAX_SEGMENTS: Final = 200
"""The most visible segments; with more, segments in one place merge into the worst outcome."""

MAX_MARKS: Final = 20
"""The number of gaps, violations and the like that are marked in one place."""

_SEVERITY: Final = {outcome: rank for rank, outcome in enumerate(Outcome)}
_UNITS: Final = ((2 * NANOSECONDS['h'], 'h'), (5 * NANOSECONDS['min'], 'min'))
_TICKS: Final = 5


@dataclass(frozen=True, slots=True)
class Span:
    """A span of valid time, in nanoseconds.

    Args:
        start: its first time.
        end: its last time.
        recording_start: the time that offsets for people count from; None for the start.
    """

    start: int
    end: int
    recording_start: int | None = field(default=None, compare=False)

    @property
    def origin(self) -> int:
        """The time that offsets for people count from."""
        return self.start if self.recording_start is None else self.recording_start

    @property
    def unit(self) -> str:
        """The unit in which people read times."""
        length = self.end - self.start
        return next((unit for limit, unit in _UNITS if length >= limit), 's')

    def place(self, time: int) -> float:
        """Return where a time is in the span: 0 for its start, 1 for its end."""
        return min(max((time - self.start) / max(self.end - self.start, 1), 0.0), 1.0)

    def since_origin(self, time: int) -> float:
        """Return the time since the origin, in the unit of the span."""
        return (time - self.origin) / NANOSECONDS[self.unit]

    def text(self, time: int) -> str:
        """Return the time since the origin, for people."""
        return f'{self.since_origin(time):.3f} {self.unit}'

    @property
    def ticks(self) -> tuple[int, ...]:
        """Some round times in the span."""
        unit = NANOSECONDS[self.unit]
        length = max(self.end - self.start, 1)
        steps = (
            max(unit * factor * 10**power // 1000, 1) for power in range(10) for factor in (1, 2, 5)
        )
        step = next(each for each in steps if length <= each * _TICKS)
        first, last = -((self.origin - self.start) // step), (self.end - self.origin) // step
        return tuple(self.origin + number * step for number in range(first, last + 1))


@dataclass(frozen=True, slots=True)
class OutcomeSegment:
    """A time in which a formula has an outcome; undecided before it is decided."""

    span: Span
    outcome: Outcome


def spans_where(times: NDArray[np.int64], found: NDArray[np.bool_]) -> tuple[Span, ...]:
    """Return the spans in which something is found, each to the first time where it is not."""
    edges = np.flatnonzero(np.diff(found, prepend=False, append=False))
    ends = times[np.minimum(edges, len(times) - 1)].tolist()
    return tuple(Span(*pair) for pair in zip(ends[::2], ends[1::2], strict=True))


def extent(report: RecordingReport) -> Span:
    """Return the valid times of a recording, with its start as their origin, as for `--begin`.

    A state may be valid before the first message was logged: then its offset is negative. If the
    log times are of another clock, the origin is the first valid time.
    """
    times = [
        time
        for formula in report.formulas
        for time in (formula.first_state, *_episode_times(formula), *_signal_times(formula))
        if time is not None
    ]
    if not times:
        return Span(report.start_time, report.end_time)
    start, end = min(times), max(times)
    if start <= report.end_time and report.start_time <= end:
        start, end = min(start, report.start_time), max(end, report.end_time)
    is_of_one_clock = abs(start - report.start_time) <= MAX_OFFSET_NS
    return Span(start, max(end, start + 1), report.start_time if is_of_one_clock else None)


def last_state(formula: FormulaReport, whole: Span) -> int:
    """Return the valid time of the last state of a formula; the end if that is not known."""
    known = () if formula.last_state is None else (formula.last_state,)
    return max((*_signal_times(formula), *_episode_times(formula), *known), default=whole.end)


def segments(formula: FormulaReport, whole: Span) -> list[OutcomeSegment]:
    """Return the outcomes of a formula over time, in order, and with gaps before its states."""
    if any(each.report.first_state is not None for each in formula.attempts):
        return _of_attempts(formula, whole)
    has_states = bool(formula.episodes and (formula.states or formula.error is None))
    if not has_states:
        outcome = formula.outcome
        return [OutcomeSegment(whole, outcome)] if outcome is Outcome.ERROR else []
    if len(formula.episodes) == 1:
        return list(_progress(formula, formula.episodes[0], whole))
    begins = [whole.start if each.begin is None else each.begin for each in formula.episodes]
    ends = [*begins[1:], max(last_state(formula, whole), begins[-1])]
    found = [
        OutcomeSegment(Span(begin, end), each.outcome)
        for begin, end, each in zip(begins, ends, formula.episodes, strict=True)
    ]
    return _merged(_seen(found, whole))


def _of_attempts(formula: FormulaReport, whole: Span) -> list[OutcomeSegment]:
    """Return the outcomes of all evaluations, each from its first state to the next one's."""
    reports = [each.report for each in formula.attempts if each.report.first_state is not None]
    begins = [each.first_state or 0 for each in reports]
    spans = map(Span, begins, [*begins[1:], max(whole.end, begins[-1])])
    found = (segments(*pair) for pair in zip(reports, spans, strict=True))
    return _merged(_seen([*chain.from_iterable(found)], whole))


def episode_runs(formula: FormulaReport) -> list[Sequence[Episode]]:
    """Return runs of episodes with the same outcome, the worst outcome first."""
    runs = [[*each] for _, each in groupby(formula.episodes, lambda episode: episode.outcome)]
    return sorted(runs, key=lambda run: _SEVERITY[run[0].outcome])


def gaps(formula: FormulaReport, whole: Span) -> tuple[Span, ...]:
    """Return the times in which states of a formula may be missing."""
    return tuple(
        Span(each.after, whole.end if each.before is None else each.before)
        for each in formula.gaps[:MAX_MARKS]
    )


def pending_windows(episode: Episode, now: int) -> list[Span]:
    """Return the times with an end in which an undecided formula awaits something.

    Args:
        episode: the episode of the formula.
        now: the time of the last state.
    """
    if not episode.residual_formula or '...' in episode.residual_formula:
        return []
    try:
        found = list(_intervals(parse_formula(episode.residual_formula)))
    except DyKnowError:  # What remains of a formula may be too deep to be read again.
        return []
    return list(dict.fromkeys(Span(now + start, now + end) for start, end in found))


def _intervals(formula: Formula | Term) -> Iterator[tuple[int, int]]:
    """Yield the intervals of the outermost operators, which count from the last state."""
    if isinstance(formula, Always | Eventually | Until):
        if formula.interval.end is not None:
            yield formula.interval.start, formula.interval.end
        return
    for part in parts(formula):
        yield from _intervals(part)


def _progress(formula: FormulaReport, episode: Episode, whole: Span) -> Iterator[OutcomeSegment]:
    begin = whole.start if episode.begin is None else episode.begin
    outcome, latest = episode.outcome, last_state(formula, whole)
    if formula.error is not None and outcome is Outcome.UNDECIDED:
        outcome = Outcome.ERROR
    is_decided = outcome in {Outcome.TRUE, Outcome.FALSE}
    decided_at = episode.decided_at if is_decided else latest
    if decided_at is not None and decided_at > begin:
        yield OutcomeSegment(Span(begin, decided_at), Outcome.UNDECIDED)
    first = begin if decided_at is None else decided_at
    fails = is_decided and formula.error is not None  # No later state can begin an episode.
    end = max(latest if fails else whole.end, first)
    if outcome is not Outcome.UNDECIDED:
        yield OutcomeSegment(Span(first, end), outcome)
    if fails:
        yield OutcomeSegment(Span(end, max(whole.end, end)), Outcome.ERROR)


def _seen(found: Sequence[OutcomeSegment], whole: Span) -> Sequence[OutcomeSegment]:
    """Return the worst outcome in each place of the line, if there are too many segments."""
    if len(found) <= MAX_SEGMENTS:
        return found
    places = groupby(found, lambda each: int(whole.place(each.span.start) * MAX_SEGMENTS))
    cells = [list(each) for _, each in places]
    worst = [min(cell, key=lambda each: _SEVERITY[each.outcome]).outcome for cell in cells]
    starts = [cell[0].span.start for cell in cells]
    ends = [*starts[1:], found[-1].span.end]
    return [
        OutcomeSegment(Span(start, end), outcome)
        for start, end, outcome in zip(starts, ends, worst, strict=True)
    ]


def _merged(found: Sequence[OutcomeSegment]) -> list[OutcomeSegment]:
    """Join neighbours with the same outcome."""
    merged = list(found[:1])
    for before, each in pairwise(found):
        if before.outcome is each.outcome:
            merged[-1] = replace(merged[-1], span=Span(merged[-1].span.start, each.span.end))
        else:
            merged.append(each)
    return merged


def _episode_times(formula: FormulaReport) -> Iterator[int]:
    for each in formula.episodes:
        yield from (time for time in (each.begin, each.decided_at) if time is not None)


def _signal_times(formula: FormulaReport) -> Iterator[int]:
    if formula.signals is not None:
        for each in formula.signals.signals.values():
            if len(each.times):
                yield from (int(each.times[0]), int(each.times[-1]))
