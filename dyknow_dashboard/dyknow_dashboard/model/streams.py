"""Streams as the page shows them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from dyknow_common import round_duration
from dyknow_coordinator import EvaluationStatus
from dyknow_stream_processing.reporting.stream_report import StreamReport, StreamState

MAX_STREAMS: Final = 500
"""The number of streams that are shown."""

OWN: Final = '_'
"""The beginning of the names of the streams that the coordinator makes."""


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
        """Return all streams, each with the formulas that it is a stand-in for."""
        stand_ins = _stand_ins(evaluations)
        rows = [_row(each, stand_ins) for each in self.reports[:MAX_STREAMS]]
        hidden = max(len(self.reports) - MAX_STREAMS, 0)
        return {'engines': list(self.engines), 'streams': rows, 'hidden': hidden}


def _row(report: StreamReport, stand_ins: Mapping[str, list[str]]) -> dict[str, Any]:
    is_flowing = report.state is StreamState.FLOWING
    return {
        'name': report.name,
        'is_own': report.name.startswith(OWN),
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
