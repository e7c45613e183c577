"""Parts of a recording around failures, so that formulas fail in them as in all of it.

A state has the latest value of each topic, so a span contains the message of each that was the
latest at the first state that the failure depends on, and all messages from the first of these on.
It ends after the messages that complete the deciding state:

    always (A -> eventually[0 s, 2 s] B), false at 50 s     depends on states from 48 s on
    /a, each second; /b, last at 47.2 s, then at 51.5 s     47.2 s to 51.5 s, and what was asked for
    /mode without stamps, once at 3 s                       its message comes again at the begin
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import SECOND_NS, Verdict, format_time
from dyknow_configuration import RequestedFormula, TopicTimes
from dyknow_reasoning import parse_formula
from dyknow_recordings.black_boxes import horizon, is_bounded, lacking_states
from dyknow_recordings.evaluation.results import RecordingReport
from dyknow_recordings.reading.recording import RecordingSpan

MAX_REACH_NS: Final = 60 * SECOND_NS
"""The age from which on a value without a stamp comes again at the begin of a span."""

CLOCK_NS: Final = SECOND_NS
"""The time after which the clock makes a state certain without a later message of a topic."""

_START: Final = -(1 << 62)
"""A time before all states, in nanoseconds."""


@dataclass(frozen=True, slots=True)
class RecordedFailure:
    """A failure of a formula; the valid times of states are in nanoseconds.

    Args:
        reason: for people.
        first: of the first state that it depends on.
        last: of the deciding state; None if `log_time` says when it was known.
        log_time: when it was known.
    """

    reason: str
    first: int
    last: int | None = None
    log_time: int | None = None

    @property
    def key(self) -> tuple[str, int | None]:
        """The same for this failure in a part of the recording."""
        return self.reason, self.last


def failures_of(
    report: RecordingReport, requested: Sequence[RequestedFormula]
) -> Iterator[RecordedFailure]:
    """Yield the failures of formulas: false episodes, unmet obligations, violations."""
    for formula, asked in zip(report.formulas, requested, strict=True):
        if not (formula.episodes or formula.violations):
            continue  # Perhaps the text is no formula.
        parsed, is_standing = parse_formula(formula.formula), asked.every_state
        is_local = not lacking_states(parsed, every_state=is_standing) and (
            is_standing or is_bounded(parsed)
        )
        reach = horizon(formula.formula) if is_local else 0
        for each in formula.episodes:
            last, first = each.decided_at, each.begin
            is_false = each.verdict is Verdict.FALSE and last is not None
            if not is_false and not each.presumably_false:
                continue
            if not is_local or first is None:
                first = _START
            elif not is_standing:
                first = max(first, (report.end_time if last is None else last) - reach)
            if last is None:
                yield RecordedFailure(
                    f"'{formula.name}' is not met", first, log_time=report.end_time
                )
            else:
                text = f"'{formula.name}' is false at {format_time(last)}"
                yield RecordedFailure(text, first, last)
        for violation in formula.violations:
            first = min(violation.valid_time, violation.available_time)
            yield RecordedFailure(violation.message, first, log_time=violation.available_time)


class _TopicOrder:
    """The messages of a topic in the order of their valid times."""

    def __init__(self, times: TopicTimes) -> None:
        order = np.argsort(times.valid_times, kind='stable')
        self.valid: NDArray[np.int64] = times.valid_times[order]
        self._receipts = times.receipt_times[order]
        # The receipt of the first message that is valid at a time or later.
        self._completions = np.minimum.accumulate(self._receipts[::-1])[::-1]

    def latest(self, time: int) -> int | None:
        """Return when the message was received whose value a state has."""
        row = int(np.searchsorted(self.valid, time, 'right')) - 1
        return int(self._receipts[row]) if row >= 0 else None

    def completion(self, time: int) -> int | None:
        """Return when a message was received that is valid at a time or later."""
        row = int(np.searchsorted(self.valid, time))
        return int(self._completions[row]) if row < len(self.valid) else None

    def valid_before(self, time: int) -> int:
        """Return the latest valid time before another one, or that one."""
        row = int(np.searchsorted(self.valid, time)) - 1
        return int(self.valid[row]) if row >= 0 else time


class SpanFinder:
    """Finds the spans of failures.

    Args:
        times: of the topics that formulas read.
        unstamped: the topics among these whose messages have no stamp.
        limits: the start and end of the recording, in nanoseconds.
        before: the time before each failure that is wanted, ...
        after: ... and the time after it.
    """

    def __init__(
        self,
        times: Mapping[str, TopicTimes],
        unstamped: Iterable[str],
        limits: tuple[int, int],
        before: int,
        after: int,
    ) -> None:
        self._topics = {name: _TopicOrder(each) for name, each in times.items()}
        self._unstamped = frozenset(unstamped)
        self._start, self._end = limits
        self._before, self._after = before, after

    def around(self, time: int) -> RecordingSpan:
        """Return the span around a log time."""
        return RecordingSpan(*self._limited(time, time), reasons=('the time that was asked for',))

    def span(self, failure: RecordedFailure) -> RecordingSpan:
        """Return the span of a failure."""
        first, known = failure.first, failure.log_time
        if failure.last is not None:
            # A window may have ended after the state before the deciding one.
            ticks = (each.valid_before(failure.last) for each in self._topics.values())
            earlier = max(ticks, default=failure.last)
            first -= max(0, failure.last - earlier)
            found = [each.completion(failure.last) for each in self._topics.values()]
            known = max((each for each in found if each is not None), default=self._end)
            known += CLOCK_NS if None in found else 0
        ages = ((name, each.latest(first)) for name, each in self._topics.items())
        latest = {name: time for name, time in ages if time is not None}
        newest = max(latest.values(), default=self._start)
        repeated = {
            name: each
            for name, each in latest.items()
            if name in self._unstamped and newest - each > MAX_REACH_NS
        }
        begin = min((each for name, each in latest.items() if name not in repeated), default=newest)
        span = RecordingSpan(
            *self._limited(begin, self._end if known is None else known), (failure.reason,)
        )
        return replace(span, repeated=_before(repeated, span.begin))

    def _limited(self, begin: int, end: int) -> tuple[int, int]:
        return max(self._start, begin - self._before), min(self._end, end + self._after)


def joined_spans(spans: Iterable[RecordingSpan]) -> Sequence[RecordingSpan]:
    """Return spans in their order, those that overlap as one."""
    found: list[RecordingSpan] = []
    for each in sorted(spans, key=lambda span: (span.begin, span.end)):
        if not found or each.begin > found[-1].end:
            found.append(each)
            continue
        last = found[-1]
        reasons = tuple(dict.fromkeys((*last.reasons, *each.reasons)))
        repeated = {**_before(each.repeated, last.begin), **last.repeated}
        found[-1] = RecordingSpan(last.begin, max(last.end, each.end), reasons, repeated)
    return found


def _before(repeated: Mapping[str, int], begin: int) -> Mapping[str, int]:
    return {name: time for name, time in repeated.items() if time < begin}
