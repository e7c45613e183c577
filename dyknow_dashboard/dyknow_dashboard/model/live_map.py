"""The map of a running system: its regions, and where its objects were lately."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from dyknow_common import SECOND_NS, Value
from dyknow_configuration import RobotMap
from dyknow_coordinator import EvaluationPhase, EvaluationStatus
from dyknow_dashboard.model.live_reports import WINDOW_NS, live_report
from dyknow_recordings import FormulaReport
from dyknow_recordings.evaluation.recorded_map import RecordedMap, Track
from dyknow_recordings.evaluation.results import Outcome
from dyknow_recordings.markers import objects_of
from dyknow_recordings.reporting.pictures.maps import map_image
from dyknow_recordings.reporting.pictures.timeline import Span

MAX_POSITIONS: Final = 1200
"""The positions that are kept of an object: at 10 Hz, the positions of two minutes."""

MAX_OUTLINES: Final = 300
"""The outlines that are kept of a region that moves."""

MAX_POINTS: Final = 5000
"""The points that a map shows of all tracks: 80 KB, which a page gets once a second."""

LATE_NS: Final = 3 * SECOND_NS
"""How long the positions at the end of a formula are waited for."""

MapSample = tuple[str, int, Mapping[str, Value]]
"""An object or a region that moves, a valid time in nanoseconds, and the fields of its stream."""


class LiveMap:
    """The regions of a robot, and the tracks of the objects that formulas are about.

    After a formula has ended, its map stays as it was at the end.

    Args:
        known: the regions, and the streams.
    """

    def __init__(self, known: RobotMap) -> None:
        self._known = known
        self._traces: dict[str, deque[tuple[int, Mapping[str, Value]]]] = {}
        self._ended: dict[str, str] = {}
        self._now = 0
        self.streams: Mapping[str, str] = {}
        """The stream of each object that a running formula is about."""

    def follow(self, evaluations: Mapping[str, EvaluationStatus], now: int) -> None:
        """Keep the tracks that the maps of some evaluations show, by their keys, and no others."""
        if not self._known.frame:
            return
        self._ended = {key: each for key, each in self._ended.items() if key in evaluations}
        was, self._now = self._now, now
        running: list[EvaluationStatus] = []
        for key, status in evaluations.items():
            if key in self._ended:
                continue
            # After simulated time was set back, no position from before comes.
            is_past = now < was and (status.decided_at or 0) > now
            is_complete = is_past or self._is_complete(status, now)
            if status.phase is EvaluationPhase.ENDED and is_complete:
                self._ended[key] = self._drawn(status)
            else:
                running.append(status)
        names = {name for each in running for name in objects_of(each.groundings)}
        self.streams = {name: text for name, text in self._known.streams.items() if name in names}
        self._traces = {
            name: each
            for name, each in self._traces.items()
            if name in names and not (now < was and each[-1][0] > now)
        }

    def _is_complete(self, status: EvaluationStatus, now: int) -> bool:
        """Return True if all positions at the end of a formula have come, or will not come."""
        end = status.decided_at or 0
        traces = map(self._traces.get, objects_of(status.groundings) & self._known.streams.keys())
        return now - end > LATE_NS or all(each and each[-1][0] >= end for each in traces)

    def add(self, samples: Iterable[MapSample]) -> None:
        """Add samples; a sample that is not later than earlier ones is not drawn."""
        for name, time, fields in samples:
            is_outline = name in self._known.outlines
            is_drawn = is_outline or all(isinstance(fields[axis], int | float) for axis in 'xy')
            if is_drawn and name in self.streams:
                most = MAX_OUTLINES if is_outline else MAX_POSITIONS
                trace = self._traces.setdefault(name, deque(maxlen=most))
                if not trace or trace[-1][0] < time:
                    trace.append((time, fields))

    def image(self, key: str, status: EvaluationStatus) -> str:
        """Return the map of an evaluation as SVG; empty if it is about nothing on it."""
        return self._ended[key] if key in self._ended else self._drawn(status)

    def _drawn(self, status: EvaluationStatus) -> str:
        objects = objects_of(status.groundings)
        known = self._known
        if objects.isdisjoint([*(each.name for each in known.regions), *known.outlines]):
            return ''
        traces = {name: self._traces[name] for name in sorted(objects & self._traces.keys())}
        outlines = {
            name: [(time, str(fields['outline'])) for time, fields in traces[name]]
            for name in traces
            if name in known.outlines
        }
        tracks = {name: _track(each) for name, each in traces.items() if name not in outlines}
        most = max(MAX_POINTS // max(len(tracks), 1), 2)
        latest = status.decided_at or status.latest_valid_time or status.started
        report = _lately(live_report(status), latest - WINDOW_NS)
        whole = Span(status.started, latest)
        found = RecordedMap(known.frame, known.regions, tracks, outlines)
        return map_image(found, [report], whole, most)


def _track(trace: Iterable[tuple[int, Mapping[str, Value]]]) -> Track:
    times, x, y = zip(*((time, fields['x'], fields['y']) for time, fields in trace), strict=True)
    return np.array(times, np.int64), np.array(x, np.float64), np.array(y, np.float64)


def _lately(report: FormulaReport, since: int) -> FormulaReport:
    """Return the report of the present episode and the later failures, the latest first."""
    latest_first = report.episodes[::-1]
    recent = (
        each
        for each in latest_first[1:]
        if each.outcome is Outcome.FALSE and each.decided_at is not None and each.decided_at > since
    )
    return replace(report, episodes=(*latest_first[:1], *recent))
