"""Streams as the page shows them, and the graph from topics over streams and states to formulas."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from dyknow_common import round_duration
from dyknow_coordinator import EvaluationStatus
from dyknow_stream_processing.reporting.stream_report import StreamReport, StreamState, is_hidden
from dyknow_stream_processing.reporting.stream_users import (
    StreamUser,
    UsedTopic,
    shown_name,
    used_topics,
)

MAX_STREAMS: Final = 500
"""The number of streams that are shown."""

MAX_NODES: Final = 300
"""The number of nodes of the graph."""

LAYERS: Final = ('topic', 'stream', 'states', 'formula')


class StreamTable:
    """The latest report of the stream manager."""

    def __init__(self) -> None:
        self.reports: tuple[StreamReport, ...] = ()
        self.engines: tuple[str, ...] = ()
        self.version = 0

    def update(self, reports: Iterable[StreamReport], engines: Iterable[str]) -> None:
        """Take a report."""
        self.reports, self.engines = tuple(reports), tuple(engines)
        self.version += 1

    def document(self, evaluations: Sequence[EvaluationStatus]) -> dict[str, Any]:
        """Return all streams and topics, with the formulas that use them.

        Args:
            evaluations: the running evaluations.
        """
        users = [StreamUser(each.name, each.state_stream, each.topics) for each in evaluations]
        stand_ins = _stand_ins(evaluations)
        rows = [_row(each, users, stand_ins) for each in self.reports[:MAX_STREAMS]]
        topics = used_topics(self.reports, users)
        return {
            'engines': list(self.engines),
            'streams': rows,
            'topics': [_topic_row(each) for each in topics[:MAX_STREAMS]],
            'hidden': max(len(self.reports) - MAX_STREAMS, 0) + max(len(topics) - MAX_STREAMS, 0),
        }


def _topic_row(used: UsedTopic) -> dict[str, Any]:
    source = used.source
    return {
        'name': source.topic,
        'rate': round(source.rate, 1),
        'delay': '' if source.latest is None else round_duration(source.delay),
        'received': source.samples,
        'lost': used.lost,
        'dropped': used.dropped,
        'drops': dict(source.drops),
        'formulas': list(used.formulas),
        'streams': list(used.streams),
        'message': used.reason,
    }


def _row(
    report: StreamReport, users: Sequence[StreamUser], stand_ins: Mapping[str, list[str]]
) -> dict[str, Any]:
    is_flowing = report.state is StreamState.FLOWING
    return {
        'name': report.name,
        'shown': shown_name(report, users),
        'is_own': is_hidden(report.name),
        'state': report.state.name.lower(),
        'message': report.message,
        'rate': round(report.flow.rate, 1) if is_flowing else None,
        'delay': round_duration(report.flow.mean_delay) if report.flow.rate else '',
        'max_delay': round_duration(report.flow.max_delay) if report.flow.rate else '',
        'samples': report.samples,
        'dropped': sum(report.drops.values()),
        'drops': dict(report.drops),
        'violations': report.violations,
        'stand_in_for': stand_ins.get(report.name, []),
        'engine': report.engine,
        'topic': report.topic,
        'type': report.message_type,
        'constraints': str(report.constraints),
        'specification': report.specification,
        'sources': [each.topic for each in report.sources],
    }


def _stand_ins(evaluations: Iterable[EvaluationStatus]) -> dict[str, list[str]]:
    """Return the features that each stream could carry in the place of the stream in use."""
    found: dict[str, dict[str, None]] = {}
    for status in evaluations:
        for grounding in status.groundings:
            for each in grounding.stand_ins:
                found.setdefault(source_of(each), {})[grounding.symbol] = None
    return {name: list(symbols) for name, symbols in found.items()}


def source_of(specification: str) -> str:
    """Return the stream that a stream of a feature is made of: the last word before `where`."""
    source = specification.rpartition(' from ')[2].partition(' where ')[0]
    return source.partition(' with ')[0].strip().strip('"')


def graph(reports: Sequence[StreamReport], evaluations: Sequence[EvaluationStatus]) -> Any:
    """Return the nodes and edges of the graph.

    If there are too many nodes, streams without a formula are left out first.
    """
    found = _Graph(reports)
    for number, status in enumerate(evaluations):
        found.add_formula(f'formula {number}', status)
    for report in reports:
        is_shown = report.state is not StreamState.REGISTERED and not is_hidden(report.name)
        if is_shown:
            found.add_stream(report)
    kept = dict(list(found.nodes.items())[:MAX_NODES])
    return {
        'layers': list(LAYERS),
        'nodes': list(kept.values()),
        'edges': [[*each] for each in found.edges if each[0] in kept and each[1] in kept],
        'hidden': len(found.nodes) - len(kept),
    }


class _Graph:
    """Nodes by key, and edges as pairs of keys."""

    def __init__(self, reports: Sequence[StreamReport]) -> None:
        self.nodes: dict[str, dict[str, Any]] = {}
        self.edges: dict[tuple[str, str], None] = {}
        self._by_name = {each.name: each for each in reports}
        self._by_topic = {
            each.topic: each
            for each in reports
            if each.topic and each.state is not StreamState.REGISTERED
        }

    def add_formula(self, key: str, status: EvaluationStatus) -> None:
        self._add(key, 'formula', status.name)
        if not status.state_stream:
            return
        states = f'states {status.state_stream}'
        self.edges[states, key] = None
        if states in self.nodes:  # Formulas over the same streams share their states.
            self.nodes[states]['name'] += f', {status.name}'
            return
        report = self._by_topic.get(status.state_stream)
        state = '' if report is None else report.state.name.lower()
        self._add(states, 'states', f'of {status.name}', state)
        for name in dict.fromkeys(source_of(each.stream) for each in status.groundings):
            stream = self._by_name.get(name)
            source = self._add_topic(name) if stream is None else self.add_stream(stream)
            self.edges[source, states] = None

    def add_stream(self, report: StreamReport) -> str:
        key = f'stream {report.name}'
        if key not in self.nodes:
            self._add(key, 'stream', report.name, report.state.name.lower())
            for source in report.sources:
                self.edges[self._add_topic(source.topic), key] = None
        return key

    def _add_topic(self, topic: str) -> str:
        if topic in self._by_topic:
            return self.add_stream(self._by_topic[topic])
        key = f'topic {topic}'
        self._add(key, 'topic', topic)
        return key

    def _add(self, key: str, layer: str, name: str, state: str = '') -> None:
        node = {'id': key, 'layer': LAYERS.index(layer), 'name': name, 'state': state}
        self.nodes.setdefault(key, node)
