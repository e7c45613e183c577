"""The formulas that use streams, and the topics that these are made of.

A formula over topics needs no named stream: its states are made of the topics themselves, in a
stream that has only an internal name.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

from dyknow_stream_processing.reporting.stream_report import SourceReport, StreamReport, is_hidden
from dyknow_stream_processing.violation import ViolationKind


@dataclass(frozen=True, slots=True)
class StreamUser:
    """A formula that is evaluated.

    Args:
        name: for people.
        states: the topic of its states; empty without one.
        topics: the topics that its states are made of.
    """

    name: str
    states: str
    topics: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class UsedTopic:
    """A topic that streams are made of.

    Args:
        streams: the named streams that are made of it.
        formulas: the names of the formulas whose states are made of it.
        reason: why no messages come, if that is known.
    """

    source: SourceReport
    streams: tuple[str, ...]
    formulas: tuple[str, ...]
    reason: str

    @property
    def lost(self) -> int:
        """The number of its messages that are missing, by their sequence numbers."""
        return self.source.drops.get(ViolationKind.LOST, 0)

    @property
    def dropped(self) -> int:
        """The number of its messages that streams have dropped."""
        return sum(self.source.drops.values()) - self.lost


def used_topics(reports: Collection[StreamReport], users: Iterable[StreamUser]) -> list[UsedTopic]:
    """Return the topics that streams are made of, by name, except topics of streams."""
    made = {each.topic for each in reports if each.engine}
    sources: dict[str, SourceReport] = {}
    streams: dict[str, list[StreamReport]] = {}
    for report in reports:
        for source in report.sources:
            if source.topic not in made:
                streams.setdefault(source.topic, []).append(report)
                # Among several engines, the first to subscribe has received the most samples.
                known = sources.get(source.topic, source)
                sources[source.topic] = max(known, source, key=lambda each: each.samples)
    formulas: dict[str, dict[str, None]] = {}
    for user in users:
        for topic in user.topics:
            formulas.setdefault(topic, {})[user.name] = None
    return [
        UsedTopic(
            source,
            tuple(each.name for each in streams[topic] if not is_hidden(each.name)),
            tuple(formulas.get(topic, ())),
            '' if source.latest else _reason(topic, streams[topic]),
        )
        for topic, source in sorted(sources.items())
    ]


def _reason(topic: str, reports: Iterable[StreamReport]) -> str:
    return next((each.message for each in reports if topic in each.message), '')


def formulas_over(report: StreamReport, users: Iterable[StreamUser]) -> list[str]:
    """Return the names of the formulas whose states are the samples of a stream."""
    found = (each.name for each in users if each.states and each.states == report.topic)
    return list(dict.fromkeys(found))


def shown_name(report: StreamReport, users: Iterable[StreamUser]) -> str:
    """Return the name of a stream for people; states are named after their formulas."""
    if not is_hidden(report.name):
        return report.name
    formulas = formulas_over(report, users)
    return f'states of {", ".join(formulas)}' if formulas else report.name
