"""Serialised messages as they lie in a buffer, in numpy vectors."""

from __future__ import annotations

import mmap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

_LOOSEST: Final = 2
"""The size of a buffer, in times of its messages, from which on these are copied."""

MessageBuffer = bytes | mmap.mmap
Numbers = Sequence[int] | NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class StoredMessages:
    """Serialised messages in one buffer; all vectors are of shape (n,).

    Args:
        data: the buffer: a file that is mapped into memory, or a part of it without compression.
        times: the log times in nanoseconds.
        channels: the number in the bag of each message's channel.
        starts: the positions of the messages in the buffer.
        sizes: their numbers of bytes.
        sent: the times at which they were sent in nanoseconds; the log times if these are unknown.
    """

    data: MessageBuffer
    times: NDArray[np.int64]
    channels: NDArray[np.int64]
    starts: NDArray[np.int64]
    sizes: NDArray[np.int64]
    sent: NDArray[np.int64]

    @classmethod
    def of(cls, times: Numbers, channels: Numbers, messages: Sequence[bytes]) -> StoredMessages:
        """Return messages in a buffer of their own."""
        sizes = np.fromiter(map(len, messages), np.int64, len(messages))
        starts = np.cumsum(sizes) - sizes
        log_times, numbers = np.array(times, np.int64), np.array(channels, np.int64)
        return cls(b''.join(messages), log_times, numbers, starts, sizes, log_times)

    def __len__(self) -> int:
        return len(self.times)

    @property
    def memory(self) -> int:
        """The number of bytes that these messages hold in memory."""
        return len(self.data) if isinstance(self.data, bytes) else 0

    def rows(self, rows: Any) -> StoredMessages:
        """Return some of the messages, given by an index of numpy."""
        return StoredMessages(
            self.data,
            self.times[rows],
            self.channels[rows],
            self.starts[rows],
            self.sizes[rows],
            self.sent[rows],
        )

    def packed(self) -> tuple[bytes, NDArray[np.int64]]:
        """Return a buffer with these messages and little else, and where they start in it."""
        size = int(self.sizes.sum())
        if isinstance(self.data, bytes) and len(self.data) <= _LOOSEST * size:
            return self.data, self.starts
        return b''.join(self.contents()), np.cumsum(self.sizes) - self.sizes

    def contents(self) -> Iterator[bytes]:
        """Yield each message."""
        data = self.data
        ends = (self.starts + self.sizes).tolist()
        return (data[start:end] for start, end in zip(self.starts.tolist(), ends, strict=True))


StoredBlock = tuple[int, Callable[[], StoredMessages]]
"""The log time that no message of a block is before, and a function that reads the messages."""


def joined(parts: Sequence[StoredMessages]) -> StoredMessages:
    """Return messages of several buffers in one, sorted by their times.

    Messages of equal times keep their order. Messages in one mapped file are not copied.
    """
    times = np.concatenate([part.times for part in parts])
    channels = np.concatenate([part.channels for part in parts])
    sizes = np.concatenate([part.sizes for part in parts])
    sent = np.concatenate([part.sent for part in parts])
    if all(part.data is parts[0].data for part in parts):
        data = parts[0].data
        starts = np.concatenate([part.starts for part in parts])
    else:
        packed = [part.packed() for part in parts]
        data = b''.join([buffer for buffer, _ in packed])
        begins = accumulate((len(buffer) for buffer, _ in packed), initial=0)
        starts = np.concatenate(
            [begin + starts for begin, (_, starts) in zip(begins, packed, strict=False)]
        )
    messages = StoredMessages(data, times, channels, starts, sizes, sent)
    if (np.diff(times) < 0).any():
        return messages.rows(np.argsort(times, kind='stable'))
    return messages
