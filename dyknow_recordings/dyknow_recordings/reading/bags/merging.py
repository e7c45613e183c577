"""Messages of several files, merged into the order of their log times."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from dyknow_recordings.reading.bags.storage import ZSTD_MAGIC, decompressed
from dyknow_recordings.reading.messages.stored_messages import StoredBlock, StoredMessages, joined
from dyknow_recordings.reading.recording import FaultCounter, count_silences, count_steps_back

_BATCH_BYTES: Final = 1 << 24
_BATCH_MESSAGES: Final = 1 << 15


def merged(
    sources: Sequence[Iterator[StoredBlock]],
    place: str,
    topics: Sequence[str],
    faults: FaultCounter,
) -> Iterator[StoredMessages]:
    """Yield the messages in batches; no message is earlier than one of the batches before.

    Args:
        sources: the blocks of each file, in the order of their first times.
        place: the recording, in the faults.
        topics: of the channels, by their numbers.
        faults: where faults are counted.
    """
    upcoming = [(block[0], number, block[1]) for number, block in _firsts(sources)]
    heapq.heapify(upcoming)
    pending: list[StoredMessages] = []
    reached: int | None = None
    while upcoming:
        while upcoming and not _is_full(pending):
            _, number, read = heapq.heappop(upcoming)
            block = _without_compression(read(), place, topics, faults)
            count_steps_back(block.times, place, faults)
            pending.append(block)
            following = next(sources[number], None)
            if following is not None:
                heapq.heappush(upcoming, (following[0], number, following[1]))
        messages = joined(pending)
        late = 0 if reached is None else int(np.searchsorted(messages.times, reached))
        if late:
            reason = 'a message is in the wrong part of the file: it is left out'
            _lose(messages.rows(slice(late)), place, reason, topics, faults)
        end = int(np.searchsorted(messages.times, upcoming[0][0])) if upcoming else len(messages)
        pending = [messages.rows(slice(max(late, end), None))]
        batch = messages.rows(slice(late, end))
        if len(batch):
            first = batch.times[0] if reached is None else reached
            count_silences(np.insert(batch.times, 0, first), place, faults)
            reached = int(batch.times[-1])
            yield batch


def _is_full(blocks: Sequence[StoredMessages]) -> bool:
    # The first block is what the batch before has left.
    new = blocks[1:]
    return (
        sum(block.memory for block in new) > _BATCH_BYTES
        or sum(len(block) for block in new) > _BATCH_MESSAGES
    )


def _firsts(sources: Sequence[Iterator[StoredBlock]]) -> Iterator[tuple[int, StoredBlock]]:
    for number, source in enumerate(sources):
        block = next(source, None)
        if block is not None:
            yield number, block


def _lose(
    messages: StoredMessages, place: str, reason: str, topics: Sequence[str], faults: FaultCounter
) -> None:
    lacking = {topics[number] for number in np.unique(messages.channels).tolist()}
    first, last = int(messages.times.min()), int(messages.times.max())
    faults.lose(place, reason, len(messages), topics=lacking, first=first, last=last)


def _without_compression(
    block: StoredMessages, place: str, topics: Sequence[str], faults: FaultCounter
) -> StoredMessages:
    if not next(block.contents(), b'').startswith(ZSTD_MAGIC):
        return block
    plain = [decompressed(data) for data in block.contents()]
    rows = [row for row, data in enumerate(plain) if data is not None]
    if len(rows) < len(block):
        lost = block.rows([row for row, data in enumerate(plain) if data is None])
        _lose(lost, place, 'the compression of a message is damaged', topics, faults)
    found = [data for data in plain if data is not None]
    messages = StoredMessages.of(block.times[rows], block.channels[rows], found)
    return replace(messages, sent=block.sent[rows])
