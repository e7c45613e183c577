"""When triggers run: their rate limits, their order, their retries, and how they went.

A trigger is *used* by an event of a formula. Each event starts a run, which consists of attempts:

    0.0 s   an event: the run begins with its first attempt, which fails
    1.0 s   the second attempt, which fails too; the third one follows 2 s later
    2.0 s   another event, within the `min_interval` of the first one: it is ignored and counted
    3.0 s   the third attempt succeeds: the run has ended

Runs of one formula with the same target, such as a service, wait for each other, so a retry never
reports an alarm after the report that it is over. All other runs are independent.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

from dyknow_common import SECOND_NS, format_duration
from dyknow_configuration import RequestedFormula, Trigger, TriggerEvent, TriggerKind
from dyknow_reactions.triggers.events import TriggerReport

FIRST_BACKOFF: Final = SECOND_NS
"""The time from a failed attempt to the next one, in nanoseconds; it doubles with each."""

MAX_BACKOFF: Final = 30 * SECOND_NS
"""The longest one."""

MAX_WAITING: Final = 100
"""The number of runs that wait for others with the same target."""

LOG_LENGTH: Final = 20
"""The number of entries that the log of a use keeps."""


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
        state: of the latest event.
        text: what has happened last, for people.
        runs: the number of runs that have begun.
        failures: of runs that have failed.
        ignored: of events within the `min_interval`, or while too many runs wait.
        last_begin: when the latest run began, in nanoseconds; None before the first.
        log: the latest entries, with their times.
    """

    formula: str
    event: TriggerEvent
    trigger: Trigger
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
        return self.formula, kind, self.trigger.target

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
    """

    def __init__(self, formulas: Sequence[RequestedFormula]) -> None:
        self.uses = tuple(
            TriggerUse(formula.name or formula.text, event, trigger)
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
        for queue in list(self._queues.values()):
            first = queue[0]
            if not first.is_running and first.due <= now:
                first.is_running = True
                yield first

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
        queue.popleft()
        if not queue:
            del self._queues[use.target]

    @property
    def is_idle(self) -> bool:
        """True if no run is under way."""
        return not self._queues

    @property
    def next_due(self) -> int | None:
        """When the next attempt is due, in nanoseconds; None if none is."""
        heads = (queue[0] for queue in self._queues.values())
        return min((each.due for each in heads if not each.is_running), default=None)

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


def _ignore(use: TriggerUse, now: int, reason: str) -> bool:
    use.ignored += 1
    use.note(now, max(use.state, TriggerState.WARN), f'ignored: {reason}')
    return False
