"""A recording on disk, whatever its format: topics, faults, losses, and messages as columns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from dyknow_common import (
    SECOND_NS,
    ExitCode,
    TypeConstants,
    ValueType,
    format_time,
    round_duration,
    unknown,
)
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.columns import MessageColumns, TopicContent
from dyknow_stream_processing import OTHER_CLOCK_NS

BEGINNING: Final = -(1 << 63)
"""A time before all others, in nanoseconds."""

END: Final = (1 << 63) - 1
"""A time after all others."""

_MAX_RUNS: Final = 16
"""The most runs of lost messages in a part of a recording that are told apart."""

MAX_SILENCE_NS: Final = 3600 * SECOND_NS
"""The longest time without a message that is no fault."""

MAX_STEP_BACK_NS: Final = SECOND_NS
"""The longest step back of the log time that is no fault: recorders write from several threads."""

_MAX_LOSSES: Final = 100
"""The most losses that are told apart: what follows is lost together."""

MISSING: Final = 'a message is missing by the sequence numbers'
"""The reason of the fault that counts the messages that the recorder has not received."""

MAX_TIME: Final = 2**63
"""All times in nanoseconds are below."""

_BEGIN_NS: Final = SECOND_NS
"""The begin of a recording that shows whether its stamps are of another clock."""

_TF_TYPE: Final = 'tf2_msgs/msg/TFMessage'
"""Its messages have no stamp, but their transforms do."""


@dataclass(frozen=True, slots=True)
class LostMessages:
    """Messages that a recording is known to lack.

    Args:
        topics: the topics that lack messages; None if any may.
        first: no lost message has an earlier log time, in nanoseconds; BEGINNING if unknown.
        last: no lost message has a later one; END if unknown.
        reason: the place and the kind of the damage.
    """

    topics: frozenset[str] | None
    first: int
    last: int
    reason: str

    def __str__(self) -> str:
        if self.first == BEGINNING:
            when = 'at an unknown time' if self.last == END else f'before {format_time(self.last)}'
        elif self.last == END:
            when = f'from {format_time(self.first)} on'
        else:
            when = f'between {format_time(self.first)} and {format_time(self.last)}'
        return f'messages that are lost {when}: {self.reason}'

    def concerns(self, topics: Collection[str]) -> bool:
        """Return True if one of some topics may lack messages."""
        return self.topics is None or not self.topics.isdisjoint(topics)

    def surrounds(self, topic: str, times: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return True for messages, by their log times, before and after which others are lost."""
        found: NDArray[np.bool_] = (times >= self.first) & (times <= self.last)
        return found & self.concerns((topic,))


def lost_runs(times: NDArray[np.int64], lost: NDArray[np.bool_]) -> Sequence[tuple[int, int]]:
    """Return the first and last times of runs of lost messages, or of all if there are many.

    Args:
        times: the log times of the messages of a topic in nanoseconds, in order; of shape (n,).
        lost: True for each lost message; of shape (n,).
    """
    edges = np.diff(np.concatenate([[False], lost, [False]]).astype(np.int8))
    begins, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    if len(begins) > _MAX_RUNS:
        begins, ends = begins[:1], ends[-1:]
    return list(zip(times[begins].tolist(), times[ends].tolist(), strict=True))


@dataclass(frozen=True, slots=True)
class QualityOfService:
    """Quality of service that a topic was offered with.

    Args:
        reliable: True if lost messages were sent again.
        transient_local: True if late subscribers got the latest messages.
        depth: the number of messages that were kept; 0 for all or unknown.
        publishers: the number of publishers when the recording began.
    """

    reliable: bool
    transient_local: bool
    depth: int
    publishers: int = 1


@dataclass(frozen=True, slots=True)
class RecordedTopic:
    """A topic of a recording; a topic that changes its type is one for each type.

    Args:
        message_type: such as `nav_msgs/msg/Odometry`.
        quality_of_service: None if the recording does not contain it.
    """

    name: str
    message_type: str
    message_count: int
    quality_of_service: QualityOfService | None


@dataclass(frozen=True, slots=True)
class RecordingFault:
    """A fault of a recording; the rest of it was read.

    Args:
        place: a file, a byte in a file, or a topic.
        reason: such as `the file ends within a record`.
        count: how often the fault was found; for messages that were lost, their number.
        unit: what is counted.
    """

    place: str
    reason: str
    count: int
    unit: str = 'times'

    def __str__(self) -> str:
        return f'{self.place}: {self.reason}' + f' ({self.count} {self.unit})' * (self.count > 1)


def messages_text(count: int) -> str:
    """Return a number of messages, for people."""
    return f'{count} message{"s" * (count != 1)}'


class FaultCounter:
    """Faults in the order in which they are found first."""

    def __init__(self) -> None:
        self.losses: list[LostMessages] = []
        """The messages that are lost by these faults."""
        self._counts: Counter[tuple[str, str]] = Counter()
        self._details: dict[tuple[str, str], str] = {}
        self._units: dict[tuple[str, str], str] = {}

    def add(self, place: str, reason: str, count: int = 1, detail: str = '') -> None:
        """Count a fault.

        Args:
            place: a file, a byte in a file, or a topic.
            reason: the kind of the fault; faults of one kind at one place are counted together.
            count: for messages that were lost, their number.
            detail: the detail of the first fault of a kind only.
        """
        self._counts[place, reason] += count
        self._details.setdefault((place, reason), f', first {detail}' if detail else '')

    def lose(
        self,
        place: str,
        reason: str,
        count: int = 1,
        *,
        topics: Collection[str] | None = None,
        first: int = BEGINNING,
        last: int = END,
        detail: str = '',
        unit: str = 'times',
    ) -> None:
        """Count a fault by which messages are lost; see `add`, `RecordingFault`, `LostMessages`."""
        self.add(place, reason, count, detail)
        self._units[place, reason] = unit
        self._note(topics, first, last, f'{place}: {reason}')

    def _note(self, topics: Collection[str] | None, first: int, last: int, reason: str) -> None:
        if len(self.losses) >= _MAX_LOSSES - 1:
            if len(self.losses) == _MAX_LOSSES and first >= self.losses[-1].first:
                return
            topics, last, reason = None, END, f'{reason}, and more from there on'
            del self.losses[_MAX_LOSSES - 1 :]
        names = None if topics is None else frozenset(topics)
        first = min(max(first, BEGINNING), END)
        self.losses.append(LostMessages(names, first, min(max(first, last), END), reason))

    def lost_rows(
        self, place: str, reason: str, topic: str, times: NDArray[np.int64], lost: NDArray[np.bool_]
    ) -> None:
        """Note messages that are lost, which are counted among the faults already.

        Args:
            place: the place, for the reason.
            reason: why they are lost.
            topic: the topic of the messages.
            times: the log times of messages in nanoseconds, in order; of shape (n,).
            lost: True for each lost message; of shape (n,).
        """
        for first, last in lost_runs(times, lost):
            self._note({topic}, first, last, f'{place}: {reason}')

    def miscounted(
        self,
        place: str,
        topics: Collection[str] | None,
        found: int,
        stated: int,
        source: str,
        *,
        more_is_damage: bool = False,
    ) -> None:
        """Count a number of messages that is another one than the recording states.

        Args:
            place: the file or folder.
            topics: the topics of the messages; None if they are unknown.
            found: the number of messages.
            stated: the number that `source` states.
            source: where the number is stated.
            more_is_damage: True if damage may have made a message of what was something else.
        """
        name = 'the file' if topics is None else f"topic '{min(topics)}'"
        reason = f'{name} has {messages_text(found)}, not {stated} as in the {source}'
        if stated > found or more_is_damage:
            self.lose(place, reason, topics=topics)
        else:
            self.add(place, reason)

    @property
    def faults(self) -> tuple[RecordingFault, ...]:
        """The faults."""
        return tuple(
            RecordingFault(
                key[0], f'{key[1]}{self._details[key]}', count, self._units.get(key, 'times')
            )
            for key, count in self._counts.items()
        )


def count_silences(times: NDArray[np.int64], place: str, faults: FaultCounter) -> None:
    """Count long times without a message, given all log times in order."""
    _count_steps(times, np.diff(times) > MAX_SILENCE_NS, 'no message is recorded', place, faults)


def count_steps_back(times: NDArray[np.int64], place: str, faults: FaultCounter) -> None:
    """Count jumps back, given log times in the order in which they were recorded."""
    found = np.diff(times) < -MAX_STEP_BACK_NS
    _count_steps(times, found, 'the log time jumps back', place, faults)


def _count_steps(
    times: NDArray[np.int64],
    found: NDArray[np.bool_],
    reason: str,
    place: str,
    faults: FaultCounter,
) -> None:
    if found.any():
        before, after = times[int(np.argmax(found)) :].tolist()[:2]
        detail = f'for {round_duration(abs(after - before))} after {format_time(before)}'
        faults.add(place, reason, int(found.sum()), detail)


@dataclass(frozen=True, slots=True)
class RecordingSpan:
    """A part of a recording.

    Args:
        begin: the log time of its begin, in nanoseconds.
        end: the log time of its end; messages at this time are included.
        reasons: what the span shows, for people.
        repeated: topics whose last message before the begin is repeated there, with its time.
    """

    begin: int
    end: int
    reasons: tuple[str, ...]
    repeated: Mapping[str, int] = field(default_factory=dict)


def unchecked_delay(topic: str) -> str:
    """Return the note that no `max_delay` is checked of a topic; see `other_clock`."""
    return (
        f"topic '{topic}': max_delay is not checked, as the stamps are of another clock than the "
        'log times; record a simulation with: ros2 bag record --use-sim-time'
    )


class RecordingReader(ABC):
    """A recording on disk, opened for reading; a context manager that closes it.

    Args:
        path: the path of the file or folder.
    """

    is_suffix = False
    """True if this is cut from a recording that has earlier messages."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._opening = FaultCounter()
        self._reading = FaultCounter()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:  # noqa: B027 - most formats need not close anything
        """Close the files."""

    @property
    def faults(self) -> tuple[RecordingFault, ...]:
        """The faults found on opening, and by the latest reading so far."""
        return self._opening.faults + self._reading.faults

    def fault_of(self, topic: str) -> str:
        """Return the first fault of the messages of a topic so far; empty if there is none."""
        place = f"topic '{topic}'"
        faults = (*self._reading.faults, *self._opening.faults)
        return next((each.reason for each in faults if each.place == place), '')

    @property
    def losses(self) -> Sequence[LostMessages]:
        """The messages that are known to be lost, as far as the latest reading has found them.

        A loss is known before messages with a later log time are read, with the exception of
        messages that were recorded far out of order.
        """
        return [*self._opening.losses, *self._reading.losses]

    @property
    def topics(self) -> tuple[RecordedTopic, ...]:
        """The recorded topics, sorted by name."""
        return tuple(
            RecordedTopic(name, each.message_type, each.count, None)
            for name, each in self.contents.items()
        )

    @property
    @abstractmethod
    def contents(self) -> Mapping[str, TopicContent]:
        """The contents of the messages of each topic, sorted by its name."""

    @property
    def constants(self) -> TypeConstants:
        """The constants of message types; none if the format defines no types."""
        return {}

    @property
    def start_time(self) -> int:
        """The log time of the first message, in nanoseconds since the epoch.

        Raises:
            RecordingError: for a recording without messages.
        """
        return self._span()[0]

    @property
    def end_time(self) -> int:
        """The log time of the last message, in nanoseconds since the epoch.

        Raises:
            RecordingError: for a recording without messages.
        """
        return self._span()[1]

    @cached_property
    def other_clock(self) -> frozenset[str]:
        """The topics whose stamps are of another clock than the log times, as in a simulation.

        The stamps of one topic may be wrong, if those of others are not: then none is of another
        clock. Only the begin is read, until each topic has a message.
        """
        stamped = {
            name: each
            for name, each in self.contents.items()
            if each.fields is not None and (each.has_stamp or each.message_type == _TF_TYPE)
        }
        found = {name: () for name, each in stamped.items() if each.has_stamp and not each.is_kept}
        reading, is_other = self._reading, False
        try:
            for delays in self._first_delays(found):
                if (delays <= OTHER_CLOCK_NS).any():
                    return frozenset()
                is_other = is_other or len(delays) > 0
        finally:
            self._reading = reading
        return frozenset(stamped if is_other else ())

    def _first_delays(self, fields: Mapping[str, Collection[str]]) -> Iterator[NDArray[np.int64]]:
        """Yield the delays of messages in the first second, or until each topic has one."""
        first, lacking = END, set(fields)
        for batch in batches(self.columns(fields)) if fields else ():
            for part in batch:
                if part.stamps is not None:
                    yield (part.log_times - part.stamps)[part.stamps != 0]
            lacking -= {part.topic for part in batch}
            first = min(first, *(int(part.log_times[0]) for part in batch))
            latest = max(int(part.log_times[-1]) for part in batch)
            if not lacking or latest - first > _BEGIN_NS:
                return

    def fields(self, topic: str) -> Mapping[str, ValueType]:
        """Return the paths of the single values in the messages of a topic, with their types.

        The elements of an array are one entry, see `dyknow_common.field_paths`.

        Raises:
            RecordingError: for a topic that was not recorded, or whose messages cannot be read.
        """
        self._check_topics([topic])
        return self.contents[topic].fields or {}

    @abstractmethod
    def columns(self, fields: Mapping[str, Collection[str]]) -> Iterator[MessageColumns]:
        """Return fields of the messages of some topics, in parts of bounded size.

        Parts follow each other in batches: no message of a batch has an earlier log time than one
        of the batches before. `in_order` returns single messages in order.

        Args:
            fields: paths of fields by the name of the topic. A topic may have no path: then there
                are only the times of its messages. There are only the times, too, of messages
                that have another type than the first of the topic and lack one of the fields.

        Raises:
            RecordingError: for topics or fields that the recording lacks, or cannot be read.
        """

    def cut(
        self,
        spans: Sequence[RecordingSpan],  # noqa: ARG002 - of formats that are written
        folder: Path,  # noqa: ARG002
        read: Collection[str],  # noqa: ARG002
    ) -> Iterator[tuple[Path, int]]:
        """Write a recording for each span; yield their paths and the numbers of their messages.

        Args:
            spans: in their order; they do not overlap.
            folder: the folder of the recordings, which exists.
            read: the topics that formulas read.

        Raises:
            RecordingError: if this format is not written.
            OSError: if one cannot be written.
        """
        raise RecordingError(f'{self.path}: recordings of this format are read, not written')

    @abstractmethod
    def _times(self) -> tuple[int, int] | None:
        """Return the log times of the first and last message; None if there is no message."""

    def _span(self) -> tuple[int, int]:
        times = self._times()
        if times is None:
            faults = ''.join(f'; {each}' for each in self.faults)
            raise RecordingError(f'{self.path}: the recording has no messages{faults}')
        return times

    def _check_topics(self, topics: Collection[str]) -> None:
        recorded = sorted({topic.name for topic in self.topics})
        for topic in topics:
            if topic not in recorded:
                message = f'{self.path}: {unknown("topic", topic, recorded)}'
                raise RecordingError(message, ExitCode.NOT_FOUND)


@dataclass(frozen=True, slots=True)
class RecordedFields:
    """Fields of a message.

    Args:
        log_time: the time of recording, in nanoseconds since the epoch.
        topic: its name.
        message_type: such as `nav_msgs/msg/Odometry`.
        stamp: the stamp of the header in nanoseconds; None if the type has no header.
        values: the values by the path of the field, without fields that the message lacks.
        absent: the reason for each field that it lacks, by path.
    """

    log_time: int
    topic: str
    message_type: str
    stamp: int | None
    values: Mapping[str, Any]
    absent: Mapping[str, str]


def in_order(columns: Iterator[MessageColumns]) -> Iterator[RecordedFields]:
    """Yield the messages of several topics one by one, in the order of their log times."""
    for batch in batches(columns):
        yield from rows_of(batch)


def batches(columns: Iterator[MessageColumns]) -> Iterator[Sequence[MessageColumns]]:
    """Yield the parts of each batch: no message is earlier than one of the batches before."""
    batch: list[MessageColumns] = []
    next_position = waiting = 0
    for part in columns:
        batch.append(part)
        waiting += len(part.positions)
        # A batch is complete if no position between its messages is missing.
        if max(int(each.positions[-1]) for each in batch) + 1 == next_position + waiting:
            yield batch
            next_position, waiting, batch = next_position + waiting, 0, []


def split(
    batch: Sequence[MessageColumns], time: int
) -> tuple[Sequence[MessageColumns], Sequence[MessageColumns]]:
    """Return the messages of a batch before a log time, and the others."""
    early = [part.log_times < time for part in batch]
    return _selected(batch, early), _selected(batch, [~rows for rows in early])


def without(batch: Sequence[MessageColumns], lost: LostMessages) -> Sequence[MessageColumns]:
    """Return a batch without the messages among which others are lost."""
    if not any(lost.concerns((part.topic,)) for part in batch):
        return batch
    return _selected(batch, [~lost.surrounds(part.topic, part.log_times) for part in batch])


def _selected(
    batch: Sequence[MessageColumns], found: Sequence[NDArray[np.bool_]]
) -> Sequence[MessageColumns]:
    return [part.rows(rows) for part, rows in zip(batch, found, strict=True) if rows.any()]


def parts_by_topic(batch: Sequence[MessageColumns]) -> dict[str, list[MessageColumns]]:
    """Return the parts of a batch by topic; the parts of a topic are in their order."""
    found: dict[str, list[MessageColumns]] = {}
    for part in batch:
        found.setdefault(part.topic, []).append(part)
    return found


def rows_of(batch: Sequence[MessageColumns]) -> Iterator[RecordedFields]:
    """Yield the messages of a batch one by one, in the order of their log times."""
    rows = [row for each in batch for row in _rows(each)]
    return (row for _, row in sorted(rows, key=lambda pair: pair[0]))


def _rows(part: MessageColumns) -> Iterator[tuple[int, RecordedFields]]:
    stamps = [None] * len(part.positions) if part.stamps is None else part.stamps.tolist()
    values = {path: column.tolist() for path, column in part.values.items()}
    times = zip(part.positions.tolist(), part.log_times.tolist(), stamps, strict=True)
    for row, (position, log_time, stamp) in enumerate(times):
        absent = {path: found[row] for path, found in part.absent.items() if row in found}
        present = {path: value[row] for path, value in values.items() if path not in absent}
        yield (
            position,
            RecordedFields(log_time, part.topic, part.message_type, stamp, present, absent),
        )
