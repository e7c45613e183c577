"""Times of the messages in a log of PX4.

A message has the time that its publisher has stamped it with, which may be outside of the log:

    the log                      20.3 s to 27.0 s
    /vehicle_status              20.2 s, 20.7 s, ...  the first is the value at the start
    /parameter_update            0 s                  the value at the start
    /sensor_preflight            0 s, 0 s, 0 s, ...   left out: it is unknown when each was sent
    /mission                     1194 s               left out: those of 27.0 s follow in the file
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from struct import Struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import SECOND_NS

HEADER_SIZE: Final = 16
RECORD: Final = Struct('<HB')

_TOPIC: Final = Struct('<H')
_DATA: Final = ord('D')
_FAR_NS: Final = 5 * SECOND_NS
"""The shortest time without any message after which it is checked that later stamps are true."""

_BURST_NS: Final = SECOND_NS
"""The time in which the values at the start are written."""


@dataclass(frozen=True, slots=True)
class TimedRows:
    """Messages of a topic in the order of their times; all vectors are of shape (n,).

    Args:
        times: in nanoseconds.
        rows: their numbers in the topic.
        positions: their numbers in the file; None if it is damaged, so that they are unknown.
    """

    times: NDArray[np.int64]
    rows: NDArray[np.int64]
    positions: NDArray[np.int64] | None

    def __len__(self) -> int:
        return len(self.times)

    def part(self, rows: slice) -> TimedRows:
        """Return some of the messages."""
        positions = None if self.positions is None else self.positions[rows]
        return TimedRows(self.times[rows], self.rows[rows], positions)


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield the code, begin and end of the content of each record; the last may be cut."""
    position = HEADER_SIZE
    while position + RECORD.size <= len(data):
        size, code = RECORD.unpack_from(data, position)
        begin, position = position + RECORD.size, position + RECORD.size + size
        yield code, begin, position


def file_order(data: bytes, topics: Collection[int]) -> Mapping[int, NDArray[np.int64]]:
    """Return the number in the file of each message, by the id of its topic."""
    found: dict[int, list[int]] = {each: [] for each in topics}
    for number, (code, begin, end) in enumerate(records(data)):
        if code == _DATA and begin + _TOPIC.size <= end <= len(data):
            (topic,) = _TOPIC.unpack_from(data, begin)
            if topic in found:
                found[topic].append(number)
    return {topic: np.array(each, np.int64) for topic, each in found.items()}


def log_span(topics: Collection[TimedRows], start: int) -> tuple[int, int]:
    """Return the times of the first and last message since the start of a log.

    Messages that are stamped long after the end of the log do not count: others follow them in the
    file that end long before their stamps.

    Args:
        topics: of which one has a message since the start.
        start: in nanoseconds.
    """
    times = np.concatenate([each.times for each in topics])
    by_time = np.argsort(times, kind='stable')
    by_time = by_time[np.searchsorted(times[by_time], start) :]
    times = times[by_time]
    found = [each.positions for each in topics if each.positions is not None]
    stop = len(times)
    if len(found) == len(topics):
        positions = np.concatenate(found)[by_time]
        for end in reversed(np.flatnonzero(np.diff(times) > _FAR_NS).tolist()):
            if positions[end + 1 : stop].max() > positions[end]:
                break
            stop = end + 1
    # Where the start is not known, the first message is.
    first, last = int(times[0]), int(times[stop - 1])
    return start if first - start <= _FAR_NS else first, last


def first_written_late(topics: Iterable[TimedRows], span: tuple[int, int]) -> int | None:
    """Return the number in the file from which on no message is a value at the start.

    Args:
        topics: the messages.
        span: the times of the first and last message of the log, in nanoseconds.

    Returns:
        None if there is none, or it is unknown.
    """
    late = [
        each.positions[(each.times >= span[0] + _BURST_NS) & (each.times <= span[1])]
        for each in topics
        if each.positions is not None
    ]
    found = [int(each.min()) for each in late if len(each)]
    return min(found, default=None)


def placed(
    topic: TimedRows, start: int, span: tuple[int, int], late: int | None
) -> tuple[TimedRows, int, int]:
    """Return the messages of a topic within a log; its value at the start is the first of them.

    Args:
        topic: its messages.
        start: stamps before are from before the log, in nanoseconds.
        span: the times of the first and last message of the log, in nanoseconds.
        late: see `first_written_late`.

    Returns:
        The messages, the number of those from before the log that may not be from its start, and
        of those from after its end.
    """
    begin, end = np.searchsorted(topic.times, (start, span[1] + 1)).tolist()
    inner, early = topic.part(slice(begin, end)), topic.part(slice(begin))
    strays = len(topic) - end
    if not len(early):
        return inner, 0, strays
    repeats = len(early) > 1 and early.times[-1] == early.times[-2]
    is_late = late is not None and early.positions is not None and early.positions.max() > late
    if repeats or is_late:
        return inner, len(early), strays
    if len(inner) and inner.times[0] == span[0]:
        return inner, 0, strays
    times = topic.times[begin - 1 : end].copy()
    times[0] = span[0]
    return replace(topic.part(slice(begin - 1, end)), times=times), 0, strays
