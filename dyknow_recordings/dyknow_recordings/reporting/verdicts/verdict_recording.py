"""Recordings of verdicts: a file of MCAP with what the nodes would have published."""

from __future__ import annotations

import heapq
import os
import sys
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count, groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from dyknow_common import SECOND_NS, DyKnowError
from dyknow_coordinator import EvaluationStatus, verdict_token
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.results import RecordingReport
from dyknow_recordings.markers import (
    DEFAULT_AXES,
    LIFETIME_NS,
    ODOMETRY,
    PERIOD_NS,
    Point,
    formula_markers,
    objects_of,
)
from dyknow_recordings.reading.opening import open_recording
from dyknow_recordings.reading.recording import in_order
from dyknow_recordings.reporting.verdicts.message_types import message_types, serialized
from dyknow_recordings.reporting.verdicts.timeline import StatusChange, status_changes
from dyknow_recordings.reporting.verdicts.verdict_messages import (
    UNDECIDED,
    diagnostic_status,
    diagnostics_message,
    markers_message,
    number_message,
    result_message,
    verdict_number,
    violation_message,
)

RESULTS: Final = '/dyknow/results'
VIOLATIONS: Final = '/dyknow/violations'
VERDICTS: Final = '/dyknow/verdicts'
MARKERS: Final = '/dyknow/markers'
DIAGNOSTICS: Final = '/diagnostics'

_BAG_VERSION: Final = 9
_REPORTER: Final = 'dyknow check'
_MAX_TICKS: Final = 10_000
"""The number of regular reports, and of sets of markers; in longer recordings they are rarer."""


TimedMessage = tuple[int, str, Any]
"""A log time in nanoseconds, a topic and a message."""

_TYPE: Final = 'nav_msgs/msg/Odometry'
_FRAME: Final = 'header.frame_id'
_POSITION: Final = tuple(f'pose.pose.position.{axis}' for axis in 'xyz')


class VerdictRecordings:
    """The recordings of verdicts of a command: an output, see `CheckOutput`.

    Args:
        target: a file that ends in `.mcap`, for one recording; otherwise a folder, which gets a
            file for each recording.
        number: of recordings.

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
        try:
            (target.parent if self._is_file else target).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordingError(f'cannot write to {target}: {error.strerror}') from None
        message_types()  # An error comes before the work.

    def add(self, report: RecordingReport) -> None:
        """Write the recording of the verdicts over a recording."""
        path = self._path(report)
        try:
            write_verdicts(report, path)
        except OSError as error:
            raise RecordingError(f'cannot write {path}: {error.strerror}') from None

    def add_failure(self, recording: str | None, error: DyKnowError) -> None:
        """Do nothing: there is no verdict."""

    def close(self, unchecked: Sequence[str]) -> None:
        """Do nothing: each recording is complete."""

    def _path(self, report: RecordingReport) -> Path:
        if self._is_file:
            return self._target
        stem = Path(report.recording).resolve().stem
        names = (stem if number == 1 else f'{stem}_{number}' for number in count(1))
        path = next(
            path for name in names if (path := self._target / f'{name}.mcap') not in self._used
        )
        self._used.add(path)
        return path


def write_verdicts(report: RecordingReport, path: Path) -> None:
    """Write the verdicts over a recording to a file, which is replaced.

    Args:
        report: the results. The positions for markers are read from its recording.
        path: of the file, which ends in `.mcap`.

    Raises:
        OSError: if it cannot be written.
    """
    # A trace may begin before 0, which a file of MCAP cannot.
    origin = min(report.start_time, 0)
    with TemporaryDirectory(prefix='.dyknow_', dir=path.parent) as folder:
        bag = Path(folder, path.stem)
        writer = Writer(bag, version=_BAG_VERSION, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            connections: dict[str, Any] = {}
            for time, topic, message in _messages(report):
                if topic not in connections:
                    connections[topic] = writer.add_connection(
                        topic, message.__msgtype__, typestore=message_types()
                    )
                writer.write(connections[topic], time - origin, serialized(message))
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
        yield time, DIAGNOSTICS, diagnostics_message(time, diagnoses)


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
            yield time - 1, topics[index], number_message(numbers[index])
        for index in changed:
            numbers[index] = found[index]
        for index in range(len(topics)) if time in ticks else changed:
            yield time, topics[index], number_message(numbers[index])


def _markers(report: RecordingReport, changes: Sequence[StatusChange]) -> Iterator[TimedMessage]:
    """Yield the markers of the formulas, where the positions of vehicles are recorded."""
    vehicles = {name for each in report.formulas for name in objects_of(each.groundings)}
    regions = report.map.regions if report.map else ()
    statuses = _Statuses(changes)
    positions: dict[str, Point] = {}
    not_shown: set[str] = set()
    frame, due = '', report.start_time
    period = max(PERIOD_NS, (report.end_time - report.start_time) // _MAX_TICKS)
    for each in recorded_positions(Path(report.recording), vehicles):
        frame = frame or each.frame
        if each.frame != frame:
            not_shown.add(each.vehicle)
            continue
        positions[each.vehicle] = each.position
        time = each.log_time
        if time >= due:
            due = time + period
            # The marker has the time of the latest state: there is no silence to show.
            shown = [replace(status, latest_valid_time=time) for status in statuses.at(time)]
            markers = formula_markers(shown, positions, DEFAULT_AXES, time, regions, frame)
            yield time, MARKERS, markers_message(time, frame, markers, max(LIFETIME_NS, 2 * period))
    for vehicle in sorted(not_shown):
        sys.stderr.write(
            f'{report.recording}: {vehicle} is not shown by markers: its positions are not in the '
            f"frame '{frame}' of the others\n"
        )


def _topics(names: Sequence[str]) -> list[str]:
    """Return the topics of the numbers of formulas."""
    topics: list[str] = []
    for name in names:
        word = verdict_token(name)
        numbered = (word if number == 1 else f'{word}_{number}' for number in count(1))
        topics.append(
            next(topic for each in numbered if (topic := f'{VERDICTS}/{each}') not in topics)
        )
    return topics


@dataclass(frozen=True, slots=True)
class VehiclePosition:
    """The position of a vehicle at a time.

    Args:
        log_time: in nanoseconds.
        frame: the frame of the position.
    """

    log_time: int
    vehicle: str
    frame: str
    position: Point


def recorded_positions(path: Path, vehicles: Collection[str]) -> Iterator[VehiclePosition]:
    """Yield the recorded positions of vehicles, in the order of their log times.

    A recording that cannot be read has none: what is wrong with it has been reported before.

    Args:
        path: of the recording.
        vehicles: their names, which are in the names of their topics.
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
                    vehicle, frame = topics[each.topic], str(each.values[_FRAME])
                    yield VehiclePosition(each.log_time, vehicle, frame, (x, y, z))
    except DyKnowError:
        return
