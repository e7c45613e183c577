"""Recordings of verdicts: a file of MCAP with what the nodes would have published."""

from __future__ import annotations

import heapq
import os
import sys
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from dyknow_common import SECOND_NS, DyKnowError, numbered_names
from dyknow_coordinator import EvaluationPhase, EvaluationStatus, verdict_token
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.results import Episode, FormulaReport, Outcome, RecordingReport
from dyknow_recordings.markers import (
    DEFAULT_AXES,
    LIFETIME_NS,
    ODOMETRY,
    PERIOD_NS,
    Point,
    formula_markers,
    objects_of,
)
from dyknow_recordings.reading.bags.bag_writing import bag_writer
from dyknow_recordings.reading.opening import open_recording
from dyknow_recordings.reading.recording import in_order
from dyknow_recordings.reporting.outputs import CheckOutput
from dyknow_recordings.reporting.pictures.timeline import extent
from dyknow_recordings.reporting.verdict_messages import (
    UNDECIDED,
    diagnostic_status,
    header,
    markers_message,
    message,
    message_types,
    result_message,
    serialized,
    verdict_number,
    violation_message,
)

RESULTS: Final = '/dyknow/results'

VIOLATIONS: Final = '/dyknow/violations'

VERDICTS: Final = '/dyknow/verdicts'
MARKERS: Final = '/dyknow/markers'
DIAGNOSTICS: Final = '/diagnostics'
_DIAGNOSES: Final = 'diagnostic_msgs/msg/DiagnosticArray'
_REPORTER: Final = 'dyknow check'
_MAX_TICKS: Final = 10_000
"""The number of regular reports, and of sets of markers; in longer recordings they are rarer."""

TimedMessage = tuple[int, str, Any]
"""A log time in nanoseconds, a topic and a message."""

_TYPE: Final = 'nav_msgs/msg/Odometry'
_FRAME: Final = 'header.frame_id'
_POSITION: Final = tuple(f'pose.pose.position.{axis}' for axis in 'xyz')


@dataclass(frozen=True, slots=True)
class StatusChange:
    """The status of a formula from a time on.

    Args:
        log_time: in nanoseconds.
        index: the index of the formula.
        status: shown until its next change.
        episode: the number of the episode that has ended; None if none has.
    """

    log_time: int
    index: int
    status: EvaluationStatus
    episode: int | None = None


class LogTimes:
    """Places valid times on the time axis of a recording: its log times.

    They are the same, unless stamps are of another clock, such as a simulation's: then the
    first state is placed at the start.

    Args:
        report: the results over the recording.
    """

    def __init__(self, report: RecordingReport) -> None:
        self._start, self._end = report.start_time, report.end_time
        self._offset = self._start - extent(report).origin

    def of(self, valid_time: int | None) -> int:
        """Return a log time within the recording; the start for None, which needs no state."""
        if valid_time is None:
            return self._start
        return min(max(valid_time + self._offset, self._start), self._end)


def status_changes(report: RecordingReport) -> list[StatusChange]:
    """Return the changes of the statuses of all formulas, in the order of their times.

    Each formula has one at the start. After the end of an episode, its verdict is shown until that
    of the next one.
    """
    times = LogTimes(report)
    found = [
        change
        for index, formula in enumerate(report.formulas)
        for change in _changes_of(index, formula, report, times)
    ]
    return sorted(found, key=lambda change: change.log_time)


def _changes_of(
    index: int, formula: FormulaReport, report: RecordingReport, times: LogTimes
) -> Iterator[StatusChange]:
    first = number = 0
    for each in formula.attempts:
        end = report.end_time if each.failed_at is None else each.failed_at
        part = replace(report, start_time=each.begin, end_time=end)
        for change in _changes_of(index, each.report, part, times):
            if change.episode is None:
                yield change
            else:
                number = first + change.episode
                yield replace(change, episode=number)
        first = number + 1
    if formula.attempts:
        return
    running = EvaluationStatus(
        formula.name,
        formula.formula,
        EvaluationPhase.RUNNING,
        report.start_time,
        groundings=formula.groundings,
        latest_valid_time=report.start_time if formula.states else None,
    )
    yield StatusChange(report.start_time, index, running)
    ended = [
        StatusChange(
            _time_of(episode, formula, report, times), index, _ended(running, episode), number
        )
        for number, episode in enumerate(formula.episodes)
        if episode.outcome is not Outcome.UNDECIDED
    ]
    first = min((change.log_time for change in ended), default=report.end_time)
    yield from _interruptions(index, running, formula, times, first)
    yield from ended
    yield from _end(index, running, formula, report)


def _interruptions(
    index: int, running: EvaluationStatus, formula: FormulaReport, times: LogTimes, before: int
) -> Iterator[StatusChange]:
    """Yield the gaps before the first verdict."""
    for gap in formula.gaps:
        begin = times.of(gap.after)
        if begin < before:
            causes = (each.message for each in formula.violations if each.valid_time >= gap.after)
            reason = next(causes, 'states may be missing')
            status = replace(running, phase=EvaluationPhase.INTERRUPTED, events=(reason,))
            yield StatusChange(begin, index, status)
            if gap.before is not None and times.of(gap.before) < before:
                yield StatusChange(times.of(gap.before), index, running)


def _end(
    index: int, running: EvaluationStatus, formula: FormulaReport, report: RecordingReport
) -> Iterator[StatusChange]:
    """Yield the status at the end of a recording, if it is not a verdict."""
    if formula.error is not None and not any(each.error for each in formula.episodes):
        failed = replace(running, phase=EvaluationPhase.ENDED, error=formula.error)
        yield StatusChange(_failure_time(formula, report), index, failed, len(formula.episodes))
    elif formula.outcome is Outcome.UNDECIDED:
        open_episodes = [each for each in formula.episodes if each.outcome is Outcome.UNDECIDED]
        residual = open_episodes[0].residual_formula if open_episodes else ''
        status = replace(
            running,
            phase=EvaluationPhase.WAITING if formula.waits_for else EvaluationPhase.RUNNING,
            waits_for=formula.waits_for,
            states_progressed=formula.states,
            residual_formula=residual,
            presumably_false=formula.presumably_false,
        )
        yield StatusChange(report.end_time, index, status)


def _ended(running: EvaluationStatus, episode: Episode) -> EvaluationStatus:
    return replace(
        running,
        phase=EvaluationPhase.ENDED,
        verdict=episode.verdict,
        decided_at=episode.decided_at,
        explanation=episode.explanation,
        margin=episode.margin,
        error=episode.error,
    )


def _time_of(
    episode: Episode, formula: FormulaReport, report: RecordingReport, times: LogTimes
) -> int:
    if episode.error is None:
        return times.of(episode.begin if episode.decided_at is None else episode.decided_at)
    return _failure_time(formula, report)


def _failure_time(formula: FormulaReport, report: RecordingReport) -> int:
    """Return when a formula has failed: with its last violation, or where no states come."""
    violations: Sequence[int] = [each.available_time for each in formula.violations]
    time = max(violations, default=report.end_time if formula.states else report.start_time)
    return min(max(time, report.start_time), report.end_time)


class VerdictRecordings(CheckOutput):
    """The recordings of verdicts of a command.

    Args:
        target: a file that ends in `.mcap`, for one recording; otherwise a folder, which gets a
            file for each recording.
        number: the number of recordings.

    Raises:
        RecordingError: if the target cannot be written, or does not suit the number of recordings.
    """

    def __init__(self, target: Path, number: int) -> None:
        self._target = target
        self._is_file = target.suffix == '.mcap'
        self._used: set[Path] = set()
        if self._is_file and number > 1:
            raise RecordingError(
                f'{target}: the verdicts of {number} recordings need a folder; give the name of '
                'one, without .mcap'
            )
        folder = target.parent if self._is_file else target
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            mend = f'{folder} is a file; give FILE.mcap, or a folder for its recordings'
            reason = mend if folder.is_file() else error.strerror
            raise RecordingError(f'cannot write to {target}: {reason}') from None
        message_types()  # An error comes before the work.

    def add(self, report: RecordingReport) -> None:
        """Write the recording of the verdicts over a recording."""
        path = self._path(report)
        try:
            write_verdicts(report, path)
        except OSError as error:
            raise RecordingError(f'cannot write {path}: {error.strerror}') from None

    def _path(self, report: RecordingReport) -> Path:
        if self._is_file:
            return self._target
        names = numbered_names(Path(report.recording).resolve().stem)
        path = next(
            path for name in names if (path := self._target / f'{name}.mcap') not in self._used
        )
        self._used.add(path)
        return path


def write_verdicts(report: RecordingReport, path: Path) -> None:
    """Write the verdicts over a recording to a file, which is replaced.

    Args:
        report: the results. The positions for markers are read from its recording.
        path: the path of the file, which ends in `.mcap`.

    Raises:
        OSError: if it cannot be written.
    """
    # A trace may begin before 0, which a file of MCAP cannot.
    origin = min(report.start_time, 0)
    with TemporaryDirectory(prefix='.dyknow_', dir=path.parent) as folder:
        bag = Path(folder, path.stem)
        with bag_writer(bag) as writer:
            connections: dict[str, Any] = {}
            for time, topic, each in _messages(report):
                if topic not in connections:
                    connections[topic] = writer.add_connection(
                        topic, each.__msgtype__, typestore=message_types()
                    )
                writer.write(connections[topic], time - origin, serialized(each))
        os.replace(bag / f'{bag.name}.mcap', path)  # noqa: PTH105 - errors name both


def _messages(report: RecordingReport) -> Iterator[TimedMessage]:
    """Return all messages, in the order of their log times."""
    changes = status_changes(report)
    return heapq.merge(
        _results(changes),
        _violations(report),
        _diagnostics(report, changes),
        _numbers(report, changes),
        _markers(report, changes),
        key=lambda timed: timed[0],
    )


class _Statuses:
    """The statuses of all formulas at times that only increase."""

    def __init__(self, changes: Sequence[StatusChange]) -> None:
        self._changes = changes
        self._next = 0
        self._statuses: dict[int, EvaluationStatus] = {}

    def at(self, time: int) -> Sequence[EvaluationStatus]:
        """Return the statuses at a time, in the order of the formulas."""
        while self._next < len(self._changes) and self._changes[self._next].log_time <= time:
            change = self._changes[self._next]
            self._statuses[change.index] = change.status
            self._next += 1
        return tuple(self._statuses.values())


def _results(changes: Sequence[StatusChange]) -> Iterator[TimedMessage]:
    for change in changes:
        if change.episode is not None:
            time = change.log_time
            yield time, RESULTS, result_message(time, change.status, change.episode)


def _violations(report: RecordingReport) -> Iterator[TimedMessage]:
    """Yield each violation once: formulas share streams."""
    found = {each for formula in report.formulas for each in formula.violations}
    for each in sorted(found, key=lambda each: (each.available_time, each.message)):
        time = min(max(each.available_time, report.start_time), report.end_time)
        yield time, VIOLATIONS, violation_message(each)


def _ticks(report: RecordingReport) -> set[int]:
    """Return the times of regular reports."""
    start, end = report.start_time, report.end_time
    return {*range(start, end, max(SECOND_NS, (end - start) // _MAX_TICKS)), end}


def _diagnostics(
    report: RecordingReport, changes: Sequence[StatusChange]
) -> Iterator[TimedMessage]:
    """Yield the diagnoses of all formulas regularly and, unless there are too many, at changes."""
    times = _ticks(report)
    if len(changes) <= _MAX_TICKS:
        times |= {change.log_time for change in changes}
    statuses = _Statuses(changes)
    before: Sequence[EvaluationStatus] = ()
    diagnoses: list[Any] = []
    for time in sorted(times):
        current = statuses.at(time)
        if current != before:
            diagnoses = [diagnostic_status(status, _REPORTER) for status in current]
            before = current
        yield time, DIAGNOSTICS, message(_DIAGNOSES, header=header(time), status=diagnoses)


def _numbers(report: RecordingReport, changes: Sequence[StatusChange]) -> Iterator[TimedMessage]:
    """Yield the verdicts as numbers regularly and at changes."""
    topics = _topics([formula.name for formula in report.formulas])
    numbers = [UNDECIDED] * len(topics)
    ticks = _ticks(report)
    by_time = {time: [*some] for time, some in groupby(changes, lambda each: each.log_time)}
    for time in sorted(ticks | by_time.keys()):
        found = {each.index: verdict_number(each.status) for each in by_time.get(time, ())}
        changed = [index for index, number in found.items() if numbers[index] != number]
        # A plot draws lines between its points: each step needs two.
        for index in changed if time > report.start_time else ():
            yield time - 1, topics[index], message('std_msgs/msg/Int8', data=numbers[index])
        for index in changed:
            numbers[index] = found[index]
        for index in range(len(topics)) if time in ticks else changed:
            yield time, topics[index], message('std_msgs/msg/Int8', data=numbers[index])


def _markers(report: RecordingReport, changes: Sequence[StatusChange]) -> Iterator[TimedMessage]:
    """Yield the markers of the formulas, where the positions of vehicles are recorded."""
    vehicles = {name for each in report.formulas for name in objects_of(each.groundings)}
    regions = report.map.regions if report.map else ()
    statuses = _Statuses(changes)
    positions: dict[str, Point] = {}
    not_shown: set[str] = set()
    shown_frame, due = '', report.start_time
    period = max(PERIOD_NS, (report.end_time - report.start_time) // _MAX_TICKS)
    for time, vehicle, frame, position in recorded_positions(Path(report.recording), vehicles):
        shown_frame = shown_frame or frame
        if frame != shown_frame:
            not_shown.add(vehicle)
            continue
        positions[vehicle] = position
        if time >= due:
            due = time + period
            # The marker has the time of the latest state: there is no silence to show.
            shown = [replace(status, latest_valid_time=time) for status in statuses.at(time)]
            markers = formula_markers(shown, positions, DEFAULT_AXES, time, regions, frame)
            yield time, MARKERS, markers_message(time, frame, markers, max(LIFETIME_NS, 2 * period))
    for vehicle in sorted(not_shown):
        sys.stderr.write(
            f'{report.recording}: {vehicle} is not shown by markers: its positions are not in the '
            f"frame '{shown_frame}' of the others\n"
        )


def _topics(names: Sequence[str]) -> list[str]:
    """Return the topics of the numbers of formulas."""
    topics: list[str] = []
    for name in names:
        numbered = numbered_names(f'{VERDICTS}/{verdict_token(name)}')
        topics.append(next(topic for topic in numbered if topic not in topics))
    return topics


def recorded_positions(
    path: Path, vehicles: Collection[str]
) -> Iterator[tuple[int, str, str, Point]]:
    """Yield log times in order, each with a vehicle, a frame, and its position in it then.

    A recording that cannot be read has none: what is wrong with it has been reported before.

    Args:
        path: the path of the recording.
        vehicles: the names of the vehicles; the names of their topics contain them.
    """
    try:
        with open_recording(path) as recording:
            names = [each.name for each in recording.topics if each.message_type == _TYPE]
            topics = {
                topic: vehicle
                for vehicle in sorted(vehicles)
                for topic in names
                if topic.endswith(f'/{ODOMETRY.replace("<vehicle>", vehicle)}')
            }
            if not topics:
                return
            fields = dict.fromkeys(topics, (_FRAME, *_POSITION))
            for each in in_order(recording.columns(fields)):
                if not each.absent:
                    x, y, z = (float(each.values[name]) for name in _POSITION)
                    yield each.log_time, topics[each.topic], str(each.values[_FRAME]), (x, y, z)
    except DyKnowError:
        return
