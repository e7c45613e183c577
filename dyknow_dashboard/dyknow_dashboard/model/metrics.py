"""The content of the page, as metrics of Prometheus.

Gauges are of the latest reports. Counters count since a node was started, so they fall where one is
started again, as Prometheus expects.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from collections.abc import Set as AbstractSet
from math import isfinite
from typing import Final

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from dyknow_common import SECOND_NS, shortened
from dyknow_coordinator import EvaluationStatus
from dyknow_coordinator.reporting.evaluation_status import outcome
from dyknow_coordinator.reporting.node_status import diagnose_node
from dyknow_dashboard.model.board import Board
from dyknow_dashboard.model.streams import MAX_STREAMS
from dyknow_stream_processing.reporting.stream_report import StreamReport, StreamState, is_hidden

CONTENT_TYPE: Final = 'text/plain; version=0.0.4; charset=utf-8'


def metrics_of(board: Board) -> bytes:
    """Return the metrics of a system in the text format of Prometheus.

    A formula is labelled with its name, a stream and a node with theirs. Of evaluations with one
    name, the latest counts, and a failure until a later one has had a state.
    """
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_BoardCollector(board))
    return generate_latest(registry)


class _BoardCollector(Collector):
    def __init__(self, board: Board) -> None:
        self._board = board

    def collect(self) -> Iterator[Metric]:
        """Yield all metrics; metrics of formulas and streams only while their node runs.

        If they stayed after the last report, an alarm on a node that is gone would stay silent.
        """
        gone = {
            each.name.rpartition('/')[2]
            for each in self._board.health.nodes
            if not (each.state.alive or each.state.is_new)
        }
        if 'stream_reasoning_coordinator' not in gone:
            formulas = self._board.formulas
            yield from _of_formulas(formulas.statuses(), formulas.failing())
        if 'stream_manager' not in gone:
            yield from self._of_streams()
        yield from self._of_nodes()
        yield from self._of_events()

    def _of_streams(self) -> Iterator[Metric]:
        # Streams of states get new names again and again: each would be a series of its own.
        named = [each for each in self._board.streams.reports if not is_hidden(each.name)]
        yield from _of_streams(named[:MAX_STREAMS])

    def _of_events(self) -> Iterator[Metric]:
        events = _counter('events', 'Changes of verdicts, and their fate.', 'place', 'fate')
        for labels, count in list(self._board.counts.items()):
            events.add_metric(labels, count)
        state = self._board.history.state
        failures = _gauge('history_failures', 'Failures in the history.', 'acknowledged')
        failures.add_metric(['no'], state.unacknowledged)
        failures.add_metric(['yes'], state.count - state.unacknowledged)
        yield from (events, failures)

    def _of_nodes(self) -> Iterator[Metric]:
        alive = _gauge('node_alive', 'Whether a node of DyKnow runs.', 'node')
        level = _gauge('node_level', 'Its diagnosis: 0 ok, 1 warning, 2 error.', 'node')
        for each in self._board.health.nodes:
            if each.state.is_new:
                continue
            alive.add_metric([each.name], float(each.state.alive))
            level.add_metric([each.name], float(diagnose_node(each.state).level))
        yield from (alive, level)


def _of_formulas(
    statuses: Sequence[EvaluationStatus], failed: AbstractSet[str]
) -> Iterator[Metric]:
    text = 'Whether a formula is false, violated or ended by an error.'
    failing = _gauge('formula_failing', text, 'formula')
    state = _gauge('formula_state', 'The state of a formula, as a label.', 'formula', 'state')
    states = _counter('formula_states', 'States that a formula was progressed over.', 'formula')
    episodes = _counter('formula_episodes', 'Episodes in which a formula failed.', 'formula')
    margin = _gauge('formula_margin', 'A bound of the margin of a formula.', 'formula', 'bound')
    shown = set(map(shortened, failed))
    for name, status in {shortened(each.name): each for each in statuses}.items():
        word = outcome(status)
        failing.add_metric([name], float(name in shown))
        state.add_metric([name, word], 1.0)
        states.add_metric([name], status.states_progressed)
        if status.episodes is not None:
            episodes.add_metric([name], status.episodes.episode_count)
        if status.margin is not None:
            bounds = {'lower': status.margin.lower, 'upper': status.margin.upper}
            for bound, value in bounds.items():
                if isfinite(value):
                    margin.add_metric([name, bound], value)
    yield from (failing, state, states, episodes, margin)


def _of_streams(reports: Sequence[StreamReport]) -> Iterator[Metric]:
    flowing = _gauge('stream_flowing', 'Whether a stream has samples.', 'stream')
    rate = _gauge('stream_rate_hertz', 'Samples in the last second.', 'stream')
    delay = _gauge('stream_delay_seconds', 'Mean delay in the last second.', 'stream')
    samples = _counter('stream_samples', 'Samples of a stream.', 'stream')
    violations = _counter('stream_violations', 'Violations of its constraints.', 'stream')
    drops = _counter(
        'stream_drops', 'Samples that were dropped, by the reason.', 'stream', 'reason'
    )
    for each in reports:
        is_flowing = each.state is StreamState.FLOWING
        flowing.add_metric([each.name], float(is_flowing))
        rate.add_metric([each.name], each.flow.rate if is_flowing else 0.0)
        if each.flow.rate:
            delay.add_metric([each.name], each.flow.mean_delay / SECOND_NS)
        samples.add_metric([each.name], each.samples)
        violations.add_metric([each.name], each.violations)
        for reason, count in each.drops.items():
            drops.add_metric([each.name, reason], count)
    yield from (flowing, rate, delay, samples, violations, drops)


def _gauge(name: str, text: str, *labels: str) -> GaugeMetricFamily:
    return GaugeMetricFamily(f'dyknow_{name}', text, labels=labels)


def _counter(name: str, text: str, *labels: str) -> CounterMetricFamily:
    return CounterMetricFamily(f'dyknow_{name}', text, labels=labels)
