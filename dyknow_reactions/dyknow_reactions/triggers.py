"""Triggers: what is done when the verdict on a formula changes, when, and how it went.

Events are changes of the verdict, from the answers and reports of a client. For example, a formula
that is asked at every state, and asked again after an error:

    report or answer                    event
    an episode begins                   false
    the episode ends                    clear
    CONSTRAINT_VIOLATION                violation
    UNAVAILABLE, of a retry             none: no state has come since the violation
    states are progressed again         clear, or false if they violate the formula
    TRUE or FALSE at the timeout        none: the episodes were events

A trigger is *used* by an event of a formula. Each event starts a run, which consists of attempts:

    0.0 s   an event: the run begins with its first attempt, which fails
    1.0 s   the second attempt, which fails too; the third one follows 2 s later
    2.0 s   another event, within the `min_interval` of the first one: it is ignored and counted
    3.0 s   the third attempt succeeds: the run has ended

Runs of one formula with the same target, such as a service, wait for each other, so a retry never
reports an alarm after the report that it is over. All other runs are independent. The target of a
command is its executable. As different commands may have the same one, such as `sh`, commands of
one event do not wait for each other, but commands of the next event wait for them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import partial
from itertools import takewhile
from math import isfinite, nan
from operator import attrgetter
from typing import Final

from dyknow_common import SECOND_NS, ExitCode, Margin, Value, Verdict, format_duration, round_time
from dyknow_configuration import RequestedFormula, Severity, Trigger, TriggerEvent, TriggerKind
from dyknow_coordinator import Answer, Progress, StandingVerdicts

_NO_VIOLATIONS: Final = (ExitCode.CANCELLED, ExitCode.TIMEOUT)
"""Errors with which the monitoring of a formula ends normally."""

FIRST_BACKOFF: Final = SECOND_NS
"""The time from a failed attempt to the next one, in nanoseconds; it doubles with each."""

MAX_BACKOFF: Final = 30 * SECOND_NS
"""The longest one."""

MAX_WAITING: Final = 100
"""The number of runs that wait for others with the same target."""

LOG_LENGTH: Final = 20
"""The number of entries that the log of a use keeps."""


@dataclass(frozen=True, slots=True)
class TriggerReport:
    """An event of a formula.

    Args:
        formula: the formula.
        event: what has happened.
        verdict: the verdict at that time.
        explanation: the explanation for people.
        time: the time of the deciding state, or else of the event, in nanoseconds.
        margin: the margin, if it is known.
    """

    formula: RequestedFormula
    event: TriggerEvent
    verdict: Verdict
    explanation: str
    time: int
    margin: Margin | None = None

    @property
    def texts(self) -> Mapping[str, str]:
        """The values of the placeholders in texts."""
        return {
            'name': self.formula.name or self.formula.text,
            'formula': self.formula.text,
            'event': str(self.event),
            'explanation': self.explanation,
            'verdict': self.verdict.name.lower(),
            'severity': str(self.formula.severity) if self._level else 'ok',
            'time': round_time(self.time),
            'margin': str(self.margin or 'unknown'),
        }

    @property
    def numbers(self) -> Mapping[str, Value]:
        """The values of the placeholders in fields of numbers; the time is in seconds."""
        return {
            'verdict': int(self.verdict),
            'severity': self._level,
            'time': self.time / 1e9,
            'margin': _number(self.margin),
        }

    @property
    def _level(self) -> int:
        """The severity as a level of DiagnosticStatus."""
        if self.event in {TriggerEvent.TRUE, TriggerEvent.CLEAR}:
            return 0
        return 2 if self.formula.severity is Severity.ERROR else 1


class FormulaEvents:
    """Derives the events of one formula from what its client receives."""

    def __init__(self, formula: RequestedFormula) -> None:
        self._formula = formula
        self._report = partial(TriggerReport, formula)
        self._verdicts = StandingVerdicts()
        self._violation = ''

    def on_progress(self, progress: Progress, now: int) -> Iterator[TriggerReport]:
        """Yield the events in a report on the evaluation.

        Args:
            progress: the report.
            now: the present time, in nanoseconds.
        """
        if progress.states_progressed:
            is_false = progress.episodes is not None and progress.episodes.is_violated
            yield from self._end_of_violation(now, progress.margin, is_false=is_false)
        if progress.episodes is not None:
            yield from self._episodes(progress.episodes, now, progress.margin)

    def on_answer(self, answer: Answer, now: int) -> Iterator[TriggerReport]:
        """Yield the events in the answer to a request."""
        error = answer.error
        if answer.episodes is not None:
            if answer.episodes != StandingVerdicts():
                is_false = answer.episodes.is_violated
                yield from self._end_of_violation(now, answer.margin, is_false=is_false)
            yield from self._episodes(answer.episodes, now, answer.margin)
        self._verdicts = StandingVerdicts()
        if error is None:
            is_false = answer.verdict is Verdict.FALSE
            yield from self._end_of_violation(now, answer.margin, is_false=is_false)
            if not self._formula.every_state:
                verdict = Verdict.TRUE if answer.verdict is Verdict.TRUE else Verdict.FALSE
                event = TriggerEvent(verdict.name.lower())
                time = now if answer.decided_at is None else answer.decided_at
                yield self._report(event, verdict, answer.explanation, time, answer.margin)
        elif error.code not in _NO_VIOLATIONS and not self._violation:
            self._violation = f'{error.code.name}: {error.message}'
            event, undecided = TriggerEvent.VIOLATION, Verdict.UNDECIDED
            yield self._report(event, undecided, self._violation, now, answer.margin)

    def _end_of_violation(
        self, now: int, margin: Margin | None, *, is_false: bool
    ) -> Iterator[TriggerReport]:
        past, self._violation = self._violation, ''
        if past and not is_false:
            text = f'it has passed: {past}'
            yield self._report(TriggerEvent.CLEAR, Verdict.UNDECIDED, text, now, margin)

    def _episodes(
        self, verdicts: StandingVerdicts, now: int, margin: Margin | None
    ) -> Iterator[TriggerReport]:
        before, self._verdicts = self._verdicts, verdicts.known_after(self._verdicts)
        for episode, has_ended in verdicts.changes(before):
            least = episode.worst or margin
            if has_ended:
                past = episode.past_text
                yield self._report(TriggerEvent.CLEAR, Verdict.TRUE, past, now, least)
            else:
                event, at = TriggerEvent.FALSE, episode.decided_at
                yield self._report(event, Verdict.FALSE, episode.text, at, least)


def _number(margin: Margin | None) -> float:
    """Return the bound that is known, or NaN; bounds are equal once the formula is decided."""
    if margin is None:
        return nan
    unknown = margin.lower if margin.lower == margin.upper else nan
    return next(filter(isfinite, (margin.lower, margin.upper)), unknown)


class TriggerState(IntEnum):
    """The outcome of a use of a trigger; numbers as in DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(slots=True)
class TriggerUse:
    """A trigger that follows an event of a formula.

    Args:
        formula: the name of the formula.
        event: the event.
        trigger: the trigger.
        name_of_target: the absolute name of its target.
        state: of the latest event.
        text: what has happened last, for people.
        runs: the number of runs that have begun.
        failures: the number of runs that have failed.
        ignored: the number of events within the `min_interval`, or while too many runs wait.
        last_begin: when the latest run began, in nanoseconds; None before the first.
        log: the latest entries, with their times.
    """

    formula: str
    event: TriggerEvent
    trigger: Trigger
    name_of_target: str
    state: TriggerState = TriggerState.OK
    text: str = 'it has not run'
    runs: int = 0
    failures: int = 0
    ignored: int = 0
    last_begin: int | None = None
    log: deque[tuple[int, str]] = field(default_factory=lambda: deque(maxlen=LOG_LENGTH))

    @property
    def name(self) -> str:
        """For people."""
        return f'{self.formula}: on {self.event}: {self.trigger.name}'

    @property
    def target(self) -> tuple[str, TriggerKind, str]:
        """The key of runs that keep their order: the formula and the trigger's target."""
        kind = self.trigger.kind
        # A goal that is sent late must not survive the cancellation that follows it.
        kind = TriggerKind.SEND_GOAL if kind is TriggerKind.CANCEL_GOAL else kind
        return self.formula, kind, self.name_of_target

    def note(self, now: int, state: TriggerState, text: str) -> None:
        """Set the state, with an entry in the log."""
        self.state, self.text = state, text
        self.log.append((now, text))


@dataclass(slots=True, eq=False)
class TriggerAttempt:
    """The present attempt of a run.

    Args:
        use: the trigger that runs.
        report: what it reports.
        due: when the attempt begins, in nanoseconds.
        number: 1 for the first one.
        is_running: True after its begin.
    """

    use: TriggerUse
    report: TriggerReport
    due: int
    number: int = 1
    is_running: bool = False


class TriggerRuns:
    """The runs of all triggers.

    Args:
        formulas: with their triggers.
        target_of: returns the absolute name of a target, which may be written in several ways.
    """

    def __init__(
        self,
        formulas: Sequence[RequestedFormula],
        target_of: Callable[[Trigger], str] = attrgetter('target'),
    ) -> None:
        self.uses = tuple(
            TriggerUse(formula.name or formula.text, event, trigger, target_of(trigger))
            for formula in formulas
            for event, trigger in formula.on
        )
        self._uses: dict[tuple[str, TriggerEvent], list[TriggerUse]] = {}
        for use in self.uses:
            self._uses.setdefault((use.formula, use.event), []).append(use)
        self._queues: dict[tuple[str, TriggerKind, str], deque[TriggerAttempt]] = {}

    def start(self, report: TriggerReport, now: int) -> list[TriggerUse]:
        """Start the runs of an event, and return the uses that ignore it.

        Args:
            report: the event.
            now: the present time of a clock that never jumps, in nanoseconds.
        """
        formula = report.formula.name or report.formula.text
        uses = self._uses.get((formula, report.event), [])
        return [use for use in uses if not self._start(use, report, now)]

    def begin(self, now: int) -> Iterator[TriggerAttempt]:
        """Yield the attempts that are due; each must be ended."""
        for each in self._waiting():
            if each.due <= now:
                each.is_running = True
                yield each

    def end(self, attempt: TriggerAttempt, now: int, failure: str = '') -> None:
        """End an attempt.

        Args:
            attempt: the attempt.
            now: the present time.
            failure: the reason if it has failed, for people; else empty.
        """
        use, trigger = attempt.use, attempt.use.trigger
        if failure and attempt.number <= trigger.retries:
            delay = min(FIRST_BACKOFF << (attempt.number - 1), MAX_BACKOFF)
            attempt.due, attempt.is_running = now + delay, False
            attempt.number += 1
            text = f'{failure}; attempt {attempt.number} in {format_duration(delay)}'
            use.note(now, TriggerState.WARN, text)
            return
        if failure:
            use.failures += 1
            use.note(now, TriggerState.ERROR, failure)
        else:
            use.note(now, TriggerState.OK, f'done in attempt {attempt.number}')
        queue = self._queues[use.target]
        queue.remove(attempt)
        if not queue:
            del self._queues[use.target]

    @property
    def is_idle(self) -> bool:
        """True if no run is under way."""
        return not self._queues

    @property
    def next_due(self) -> int | None:
        """The time of the next attempt, in nanoseconds; None if none is due."""
        return min((each.due for each in self._waiting()), default=None)

    def _waiting(self) -> list[TriggerAttempt]:
        """Return the attempts that wait for no other run, only until they are due."""
        firsts = (each for queue in self._queues.values() for each in _independent(queue))
        return [each for each in firsts if not each.is_running]

    def _start(self, use: TriggerUse, report: TriggerReport, now: int) -> bool:
        interval = use.trigger.min_interval
        if use.last_begin is not None and now < use.last_begin + interval:
            return _ignore(use, now, f'another event within {format_duration(interval)}')
        queue = self._queues.setdefault(use.target, deque())
        if len(queue) > MAX_WAITING:
            return _ignore(use, now, f'{MAX_WAITING} runs wait already')
        use.last_begin, use.runs = now, use.runs + 1
        queue.append(TriggerAttempt(use, report, now))
        return True


def _independent(queue: deque[TriggerAttempt]) -> Iterable[TriggerAttempt]:
    """Return the first run of a queue; of commands, all first ones of the same event."""
    first = queue[0]
    if first.use.trigger.kind is not TriggerKind.RUN:
        return (first,)
    return takewhile(lambda each: each.report is first.report, queue)


def _ignore(use: TriggerUse, now: int, reason: str) -> bool:
    use.ignored += 1
    use.note(now, max(use.state, TriggerState.WARN), f'ignored: {reason}')
    return False
