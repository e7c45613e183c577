"""The graph from topics over streams and states to formulas."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from dyknow_coordinator import EvaluationStatus
from dyknow_dashboard.model.streams import source_of
from dyknow_stream_processing.reporting.stream_report import StreamReport, StreamState, is_hidden

MAX_NODES: Final = 300
"""The number of nodes of the graph."""

LAYERS: Final = ('topic', 'stream', 'states', 'formula')


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
