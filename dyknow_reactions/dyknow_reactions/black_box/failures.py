"""The failures of formulas, and the times around them that are to be recorded.

Example: `before` is 10 s, `after` is 2 s.

     0 s  a formula is reported: it is watched, and its topics are kept in memory
    30 s  it is reported to be false since 29.5 s: a box opens, from 19.5 s to 32 s
    31 s  it fails again (an episode): the box goes on until 33 s, and has two failures
    33 s  the box is due: its messages are written
    34 s  a new episode: a new box

A box goes on for `before` + `after` at most after the report of its first failure; a later failure
has a box of its own.

The number of boxes in a minute is limited. Some boxes are reserved for formulas that have had no
box for the same reason in this minute. So the retries or episodes of a formula cannot take the box
of the first failure of another formula, or of another kind of failure of the same formula.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

from dyknow_common import SECOND_NS, BlackBoxOptions, ExitCode, Verdict
from dyknow_coordinator import EvaluationPhase, EvaluationStatus

REPORT_DELAY_NS: Final = 5 * SECOND_NS
"""The time that a failure may take to be reported."""

RECENT_NS: Final = 30 * SECOND_NS
"""The time before the start in which a former run of the recorder may have lost a failure."""

_MINUTE_NS: Final = 60 * SECOND_NS

FALSE: Final = 'false'
VIOLATION: Final = 'violation'
EPISODE: Final = 'episode'
REQUEST: Final = 'request'

FormulaKey = tuple[str, int]
"""The name of an evaluation, and the time of its request."""


@dataclass(frozen=True, slots=True)
class FormulaFailure:
    """A failure of a formula.

    Args:
        reason: `false`, `violation`, `episode` or `request`.
        time: around which messages are recorded, nanoseconds.
        decided_at: the valid time of the deciding state; None without one.
        explanation: the explanation of the verdict, or the error.
    """

    reason: str
    time: int
    decided_at: int | None = None
    explanation: str = ''


@dataclass(eq=False, slots=True)
class OpenBox:
    """A time that is being recorded.

    Args:
        key: the key of the formula.
        failure: the first one.
        status: the status of the formula when it failed.
        begin: the begin of the time, nanoseconds.
        end: the end of the time.
        last_end: the latest time to which later failures may extend it.
        failures: their number.
        recorded_from: the time from which on all topics of the formula are received, nanoseconds.
    """

    key: FormulaKey
    failure: FormulaFailure
    status: EvaluationStatus
    begin: int
    end: int
    last_end: int
    failures: int = 1
    recorded_from: int = 0


@dataclass(slots=True)
class BoxedFormula:
    """A formula with a black box that is evaluated, or has a box that is not due yet."""

    options: BlackBoxOptions
    status: EvaluationStatus
    episodes: int = 0
    box: OpenBox | None = None

    def extend(self, now: int) -> bool:
        """Let the open box go on for a later failure; return False if there is none."""
        if self.box is None or now >= self.box.last_end:
            return False
        self.box.failures += 1
        self.box.end = min(max(self.box.end, now + self.options.after), self.box.last_end)
        return True


@dataclass(frozen=True, slots=True)
class LostFailure:
    """A failure that is not recorded.

    Args:
        status: the status of the formula.
        failure: the failure.
        error: why it is not recorded.
    """

    status: EvaluationStatus
    failure: FormulaFailure
    error: str


@dataclass(slots=True)
class FailureWatch:
    """Watches formulas, and says what is to be recorded. All times are of one clock, nanoseconds.

    Args:
        started_at: failures of formulas that were requested earlier count from the first report on.
        limit: the most boxes that open within a minute.
    """

    started_at: int
    limit: int
    watched: dict[FormulaKey, BoxedFormula] = field(default_factory=dict)
    _ended: set[FormulaKey] = field(default_factory=set)
    _opened: deque[tuple[int, str, str]] = field(default_factory=deque)

    def update(self, statuses: Iterable[EvaluationStatus], now: int) -> list[LostFailure]:
        """Process a report on all formulas; return the failures that are not recorded."""
        reported: set[FormulaKey] = set()
        lost: list[LostFailure] = []
        for status in statuses:
            key = status.name, status.started
            reported.add(key)
            if status.record is not None and key not in self._ended:
                lost += self._note(key, status, status.record, now)
        self._ended &= reported
        for key in [each for each in self.watched if each not in reported]:
            self._end(key)
        return lost

    def missed(self, statuses: Iterable[EvaluationStatus]) -> list[LostFailure]:
        """Return the failures in the first report that a former run may not have recorded.

        They were known shortly before the start, or between it and this report.
        """
        begin = self.started_at - RECENT_NS
        found: list[LostFailure] = []
        for status in statuses:
            time = status.latest_valid_time or 0
            failure = _failure(status, 0, time) if status.started < self.started_at else None
            if failure is not None and failure.reason == EPISODE and status.episodes is not None:
                latest = status.episodes.latest_episodes[-1]
                at = latest.decided_at
                failure = FormulaFailure(EPISODE, at, at, latest.explanation)
            if failure is not None and failure.time > begin:
                error = 'the formula has failed while no recorder ran: there is no black box of it'
                found.append(LostFailure(status, failure, error))
        return found

    def request(self, name: str, now: int) -> tuple[list[OpenBox], list[LostFailure]]:
        """Open boxes of the formulas of a name, or of all if it is empty, as if they failed now."""
        found = [key for key in self.watched if name in {'', key[0]}]
        lost = [
            each for key in found for each in self._fail(key, FormulaFailure(REQUEST, now), now)
        ]
        boxes = [self.watched[key].box for key in found]
        return [each for each in boxes if each is not None], lost

    def due(self, now: int) -> list[OpenBox]:
        """Close the boxes whose time is over, and return them."""
        open_boxes = [each.box for each in self.watched.values() if each.box is not None]
        # A box of before a jump back of simulated time would never end.
        boxes = [each for each in open_boxes if not each.begin <= now < each.end]
        for box in boxes:
            watched = self.watched[box.key]
            watched.box = None
            if box.key in self._ended:
                del self.watched[box.key]
        return boxes

    def kept_from(self, key: FormulaKey, now: int) -> int:
        """Return the time from which on the messages of a watched formula are needed."""
        watched = self.watched[key]
        if watched.box is not None and key in self._ended:
            return watched.box.begin
        earliest = now - watched.options.before - REPORT_DELAY_NS
        return earliest if watched.box is None else min(earliest, watched.box.begin)

    def _note(
        self, key: FormulaKey, status: EvaluationStatus, options: BlackBoxOptions, now: int
    ) -> Sequence[LostFailure]:
        is_new = key not in self.watched
        count = 0 if status.episodes is None else status.episodes.episode_count
        if is_new:
            # What happened before the recorder was started is over.
            before = count if status.started < self.started_at else 0
            self.watched[key] = BoxedFormula(options, status, before)
        watched = self.watched[key]
        watched.status = status
        failure = _failure(status, watched.episodes, now)
        watched.episodes = count
        has_ended = status.phase is EvaluationPhase.ENDED
        lost: Sequence[LostFailure] = ()
        if is_new and has_ended:
            if (
                failure is not None
                and status.started >= self.started_at
                and not self._goes_on(key, now)
            ):
                error = 'the formula has failed before its topics could be recorded'
                lost = (LostFailure(status, failure, error),)
        elif failure is not None:
            lost = self._fail(key, failure, now)
        if has_ended:
            self._end(key)
        return lost

    def _fail(self, key: FormulaKey, failure: FormulaFailure, now: int) -> Sequence[LostFailure]:
        watched = self.watched[key]
        before, after = watched.options.before, watched.options.after
        if watched.extend(now):
            return ()
        if error := self._refusal(key[0], failure.reason, now):
            return (LostFailure(watched.status, failure, error),)
        self._opened.append((now, key[0], failure.reason))
        watched.box = OpenBox(
            key,
            failure,
            watched.status,
            min(failure.time - before, now),
            max(now, failure.time) + after,
            max(now, failure.time) + before + after,
        )
        return ()

    def _refusal(self, name: str, reason: str, now: int) -> str:
        """Return why a failure of a formula gets no box; empty if it gets one."""
        while self._opened and self._opened[0][0] <= now - _MINUTE_NS:
            self._opened.popleft()
        count, kept = len(self._opened), 0
        if reason != REQUEST and any(each[1:] == (name, reason) for each in self._opened):
            # Between two retries, a formula is not watched.
            names = {each for each, _ in self.watched} | {each for _, each, _ in self._opened}
            kept = min(self.limit // 2, len(names))
        if count + kept < self.limit:
            return ''
        others = '; further ones are kept for other failures' if count < self.limit else ''
        return (
            f'{count} black boxes have been written within a minute{others} (the limit '
            f"'max_per_minute' is {self.limit}); raise it, or make the formula fail less often"
        )

    def _goes_on(self, key: FormulaKey, now: int) -> bool:
        """Return True if a box of an earlier evaluation of a formula records its failure, too."""
        earlier = [each for (name, _), each in self.watched.items() if name == key[0]]
        return any(each.extend(now) for each in earlier)

    def _end(self, key: FormulaKey) -> None:
        self._ended.add(key)
        if self.watched[key].box is None:
            del self.watched[key]


def _failure(status: EvaluationStatus, episodes: int, now: int) -> FormulaFailure | None:
    """Return the failure that a status reports.

    Args:
        status: the status of a formula.
        episodes: their number in the report before.
        now: the time.
    """
    verdicts = status.episodes
    if verdicts is not None and verdicts.episode_count > episodes:
        # The first one that is new, if it is among the latest.
        new = verdicts.latest_episodes[-(verdicts.episode_count - episodes) :]
        if new:
            return FormulaFailure(EPISODE, new[0].decided_at, new[0].decided_at, new[0].explanation)
    if status.phase is not EvaluationPhase.ENDED:
        return None
    if status.error is not None:
        is_violation = status.error.code is ExitCode.CONSTRAINT_VIOLATION
        return FormulaFailure(VIOLATION, now, None, status.error.message) if is_violation else None
    if status.verdict is Verdict.FALSE and verdicts is None:
        time = now if status.decided_at is None else status.decided_at
        return FormulaFailure(FALSE, time, status.decided_at, status.explanation)
    return None
