"""Silence of streams and topics, and its reasons in words."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from difflib import get_close_matches
from typing import Final

from dyknow_common import SECOND_NS
from dyknow_stream_processing.reporting.stream_report import StreamReport, StreamState

SILENT_PERIODS: Final = 3
"""The least number of seconds after which a stream without new samples counts as silent."""

MAX_LAG_NS: Final = SECOND_NS
"""The time for which messages may wait in a node that keeps up."""

PEER_STREAMS: Final = 'dyknow/federation'
"""The beginning of the topics of other hosts, relative to a namespace."""

SPARSE_NS: Final = 30 * SECOND_NS
"""The time for which a stream of another host may be silent: a sample comes each 10 s."""

MAX_NAME: Final = 200
"""Longer names of topics are not compared: that takes quadratic time."""

MAX_TOPICS: Final = 1000
"""The number of topics that are compared."""

_MAX_REASONS: Final = 5
_MAX_NODES: Final = 5


class ActivityMeter:
    """Decides whether a stream is silent, from the number of its samples at the end of each second.

    A stream with a long sample period is silent only after three such periods.
    """

    def __init__(self) -> None:
        self._samples = 0
        self._periods = 0
        self._idle = 0

    def measure(self, samples: int) -> None:
        """End a second, given the number of all samples so far."""
        self._idle = 0 if samples > self._samples else self._idle + 1
        self._samples = samples
        self._periods += 1

    def is_silent(self, samples: int) -> bool:
        """Return True if no samples come, given the number of all samples so far."""
        if samples == 0 or samples > self._samples:
            return samples == 0
        return self._idle >= SILENT_PERIODS * max(1, (self._periods - self._idle) / samples)

    @property
    def is_overdue(self) -> bool:
        """True if there was no sample in the last SILENT_PERIODS seconds."""
        return self._idle >= SILENT_PERIODS


def topic_reason(
    topic: str,
    *,
    is_published: bool = False,
    has_received: bool = False,
    is_silent: bool = True,
    is_latched: bool = False,
    fault: str = '',
    nearest: Sequence[str] = (),
) -> str:
    """Return why no messages of a topic come; empty if they come or none need come.

    Args:
        topic: its absolute name.
        is_published: True if it has a publisher.
        has_received: True if a message has come.
        is_silent: True if none came lately.
        is_latched: True if its publishers keep their messages: then silence is normal.
        fault: why its messages cannot be used.
        nearest: published topics with a similar name.
    """
    if fault:
        return fault
    if not is_published and has_received:
        return f'nobody publishes {topic} any more'
    if not is_published:
        hint = f' (did you mean {" or ".join(nearest)}?)' if nearest else ''
        return f'nobody publishes {topic}{hint}'
    if not has_received:
        return f'{topic} has a publisher but no message has come'
    return f'{topic} has fallen silent' if is_silent and not is_latched else ''


def last_sign(topic: str, latest: int, promised: int) -> int:
    """Return until when a topic has not fallen silent, in nanoseconds.

    Other hosts leave out samples that make no difference, and promise so.

    Args:
        topic: its absolute name.
        latest: the time of the latest message.
        promised: its watermark.
    """
    if f'/{PEER_STREAMS}/' not in topic:
        return latest
    return max(latest, min(promised, latest + SPARSE_NS))


def nearest_topics(topic: str, others: Iterable[str]) -> tuple[str, ...]:
    """Return the topics with the most similar names, or else the topics in other namespaces."""
    if len(topic) > MAX_NAME:
        return ()
    known = [each for each in others if len(each) <= MAX_NAME and each != topic][:MAX_TOPICS]
    base = topic.rpartition('/')[2]
    namesakes = [each for each in known if each.rpartition('/')[2] == base]
    return tuple(get_close_matches(topic, known) or namesakes)


def several_publishers(nodes: Iterable[str]) -> str:
    """Return the number of publishers of a topic and their nodes, given the node of each."""
    names = sorted(nodes)
    if len(set(names)) == 1:
        # The middleware lists a killed node for another 20 s, beside its successor.
        return f'{len(names)} publishers, all of {names[0]} (one may be gone)'
    more = ', ...' if len(names) > _MAX_NODES else ''
    return f'{len(names)} publishers: {", ".join(names[:_MAX_NODES])}{more}'


def with_origins(reports: Collection[StreamReport]) -> Iterator[StreamReport]:
    """Yield reports; a waiting stream's has the reasons of the streams that it is made of."""
    by_topic = {each.topic: each for each in reports if each.topic}

    def message(report: StreamReport, *consumers: StreamReport) -> str:
        origins = [by_topic[each.topic] for each in report.sources if each.topic in by_topic]
        further = [
            f'stream {each.name} waits: {message(each, report, *consumers)}'
            for each in origins
            # Streams may be made of each other, if their specifications name topics.
            if each.state is StreamState.WAITING and each not in (report, *consumers)
        ]
        return joined_reasons([report.message, *further])

    for each in reports:
        is_waiting = each.state is StreamState.WAITING
        yield replace(each, message=message(each)) if is_waiting else each


def joined_reasons(reasons: Collection[str]) -> str:
    """Return reasons as one text; only the first ones of many."""
    listed = '; '.join(list(reasons)[:_MAX_REASONS])
    more = len(reasons) - _MAX_REASONS
    return f'{listed}; and {more} more' if more > 0 else listed
