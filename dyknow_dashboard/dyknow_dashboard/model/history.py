"""The history of failures, in an SQLite file that outlives the page.

All work with the file is in a thread of its own. Failures wait in memory until it has written them:
also while the file is locked or damaged, until there are too many.
"""

from __future__ import annotations

import sqlite3
from asyncio import wrap_future
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, TypeVar

from dyknow_common import SECOND_NS, DyKnowError, ExitCode, Verdict, date_time, shortened
from dyknow_dashboard.errors import DashboardError
from dyknow_dashboard.model.verdict_events import FAILURES, EventCounts, VerdictEvent
from dyknow_recordings import Episode, FormulaReport, Judgement, RecordingReport
from dyknow_recordings.reporting.junit import JUnitSuites
from dyknow_semantics import SemanticsError
from dyknow_semantics.sqlite_files import opened_store, store_errors

MAX_FAILURES: Final = 10_000
"""The number of failures in the file."""

MAX_AGE_NS: Final = 90 * 86_400 * SECOND_NS

MAX_WAITING: Final = 1000
"""The number of failures that wait to be written."""

LAST: Final = 2**63 - 1
"""The largest integer of SQLite."""

_KIND: Final = 'history of failures'
_WRITTEN: Final = 'name, formula, event, verdict, started, valid_time, explanation, known_at'
_SHOWN: Final = f'id, {_WRITTEN}, acknowledged_by, acknowledged_at'
_TABLE: Final = f"""
CREATE TABLE IF NOT EXISTS failure (
  id INTEGER PRIMARY KEY AUTOINCREMENT, {_WRITTEN}, acknowledged_by, acknowledged_at, begin
);
CREATE INDEX IF NOT EXISTS identity ON failure (name, started);
"""
_INSERT: Final = f"""
INSERT INTO failure (begin, {_WRITTEN}) SELECT :begin, :{_WRITTEN.replace(', ', ', :')}
WHERE NOT (:may_be_known AND EXISTS (
  SELECT id FROM failure
  WHERE name = :name AND started = :started AND event = :event AND begin = :begin
))
"""

Result = TypeVar('Result')


@dataclass(frozen=True, slots=True)
class HistoryQuery:
    """Which failures are asked for: the latest first, of the span of time in which they got known.

    The name is a part of the names of formulas, in upper or lower case.
    """

    since: int = 0
    until: int = LAST
    name: str = ''
    before_id: int = LAST
    limit: int = MAX_FAILURES


@dataclass(frozen=True, slots=True)
class HistoryState:
    """The state of the history, as pages show it.

    Args:
        fault: why it cannot be used, with the mend; empty if it can.
        count: the count of the failures in it.
        unacknowledged: the number of failures that nobody has acknowledged.
        version: changes with every change.
    """

    fault: str = 'no history of failures is kept (--history none)'
    count: int = 0
    unacknowledged: int = 0
    version: int = 0


class FailureHistory:
    """The failures in a file.

    Args:
        path: the path of the file; None keeps nothing.
        clock: returns the present time, nanoseconds.
        counts: the counts of the failures that were written, dropped and removed.
    """

    def __init__(self, path: Path | None, clock: Callable[[], int], counts: EventCounts) -> None:
        self.state = HistoryState() if path is None else HistoryState(fault='')
        self._path, self._clock, self._counts = path, clock, counts
        self._waiting: deque[VerdictEvent] = deque()
        self._thread = ThreadPoolExecutor(1, 'history')
        self._file: sqlite3.Connection | None = None
        self._job: Future[None] | None = None

    def put(self, events: Sequence[VerdictEvent]) -> None:
        """Have the failures among events written."""
        found = [each for each in events if each.event in FAILURES]
        if self._path is None or not found:
            return
        room = MAX_WAITING - len(self._waiting)
        self._waiting.extend(found[:room])
        self._counts['history', 'too many wait'] += len(found[room:])
        # A job that has begun may not see them.
        if self._job is None or self._job.running() or self._job.done():
            self._job = self._thread.submit(self._work, self._path, lambda _: None)

    async def open(self) -> None:
        """Open the file, and write the failures that wait; the state tells if that fails."""
        with suppress(DashboardError):
            await self.do(lambda _: None)

    async def close(self) -> None:
        """Write the failures that wait, and release the file."""
        await self.open()
        await wrap_future(self._thread.submit(self._release))
        self._thread.shutdown()

    async def do(self, work: Callable[[sqlite3.Connection], Result]) -> Result:
        """Return the result of some work with the file.

        Raises:
            DashboardError: UNAVAILABLE, with the mend, if the file cannot be used.
        """
        if self._path is None:
            raise DashboardError(self.state.fault, ExitCode.UNAVAILABLE)
        return await wrap_future(self._thread.submit(self._work, self._path, work))

    def _work(self, path: Path, work: Callable[[sqlite3.Connection], Result]) -> Result:
        """Write the failures that wait and do some work with the file: all of it, or nothing."""
        waiting, state = list(self._waiting), self.state
        try:
            with store_errors(_KIND, path):
                self._file = file = self._file or _opened(path)
                before = file.total_changes
                with file:
                    added, removed = _insert(file, waiting, self._clock() - MAX_AGE_NS)
                    result = work(file)
                    text = 'SELECT count(*), count(*) - count(acknowledged_at) FROM failure'
                    count, unacknowledged = file.execute(text).fetchone()
        except SemanticsError as error:
            self._release()
            version = state.version + (error.message != state.fault)
            self.state = replace(state, fault=error.message, version=version)
            raise DashboardError(error.message, ExitCode.UNAVAILABLE) from None
        for _ in waiting:
            self._waiting.popleft()
        self._counts['history', 'written'] += added
        self._counts['history', 'known already'] += len(waiting) - added
        self._counts['history', 'removed, as too old or too many'] += removed
        version = state.version + (file.total_changes > before or bool(state.fault))
        self.state = HistoryState('', count, unacknowledged, version)
        return result

    def _release(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None


def _opened(path: Path) -> sqlite3.Connection:
    with suppress(OSError):  # The next line tells what is wrong.
        path.parent.mkdir(parents=True, exist_ok=True)
    file = opened_store(path, _KIND, 1, {'failure': _TABLE})
    file.create_function('has', 2, lambda text, part: part.casefold() in text.casefold())
    return file


def _insert(
    file: sqlite3.Connection, events: Sequence[VerdictEvent], oldest: int
) -> tuple[int, int]:
    """Write the events that the file lacks; remove failures that are too old or too many.

    Args:
        file: the file.
        events: failures.
        oldest: the time before which failures are too old.

    Returns:
        The numbers of written and removed failures.
    """
    added = file.executemany(_INSERT, map(asdict, events)).rowcount if events else 0
    too_many = f'(SELECT id FROM failure ORDER BY id DESC LIMIT 1 OFFSET {MAX_FAILURES})'
    text = f'DELETE FROM failure WHERE known_at < ? OR id <= {too_many}'
    return added, file.execute(text, (oldest,)).rowcount


def failures(file: sqlite3.Connection, query: HistoryQuery) -> list[dict[str, Any]]:
    """Return the failures that are asked for."""
    text = f"""
        SELECT {_SHOWN} FROM failure
        WHERE id < :before_id AND known_at >= :since AND known_at < :until AND has(name, :name)
        ORDER BY id DESC LIMIT :limit
    """
    names = _SHOWN.split(', ')
    return [dict(zip(names, row, strict=True)) for row in file.execute(text, asdict(query))]


def acknowledge(file: sqlite3.Connection, ids: Sequence[int], by: str, now: int) -> int:
    """Acknowledge failures; return the number of newly acknowledged ones."""
    text = 'UPDATE failure SET acknowledged_by = ?, acknowledged_at = ? WHERE id = ?'
    text += ' AND acknowledged_at IS NULL'
    return file.executemany(text, [(by, now, each) for each in ids]).rowcount


def clear(file: sqlite3.Connection, ids: Sequence[int]) -> int:
    """Delete failures, and return their number.

    Raises:
        DashboardError: ALREADY_EXISTS if one is not acknowledged; then none is deleted.
    """
    for each in ids:
        text = 'SELECT name FROM failure WHERE id = ? AND acknowledged_at IS NULL'
        if found := file.execute(text, (each,)).fetchone():
            reason = f"the failure {each} of '{shortened(found[0])}' is not acknowledged"
            raise DashboardError(f'{reason}; acknowledge it first', ExitCode.ALREADY_EXISTS)
    return file.executemany('DELETE FROM failure WHERE id = ?', [(each,) for each in ids]).rowcount


def junit(file: sqlite3.Connection, query: HistoryQuery) -> bytes:
    """Return the failures that are asked for as a report of JUnit, with a test case for each."""
    found = failures(file, query)
    known = [each['known_at'] for each in found] or [query.since]
    formulas = tuple(map(_formula_report, reversed(found)))
    suites = JUnitSuites(Judgement.AUTO)
    suites.add(RecordingReport('history of failures', min(known), max(known), formulas))
    return suites.document('dyknow dashboard')


def _formula_report(failure: Mapping[str, Any]) -> FormulaReport:
    """Return a failure as a check would report it, with the time in its name."""
    known_at, text, seen = failure['known_at'], failure['explanation'], failure['acknowledged_at']
    by = failure['acknowledged_by']
    notes = () if seen is None else (f'acknowledged by {by} at {date_time(seen)}',)
    code = ExitCode.__members__.get(failure['verdict'].upper().replace(' ', '_'))
    error = None if code is None else DyKnowError(text, code)
    episode = Episode(failure['started'], Verdict.FALSE, known_at, text, error)
    name = f'{failure["name"]} at {date_time(known_at)}'
    return FormulaReport(name, failure['formula'], (episode,), events=notes)
