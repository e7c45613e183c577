"""The map of a running system: its regions, and where its objects were lately."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from dyknow_configuration import PositionFields, RobotMap
from dyknow_coordinator import EvaluationPhase, EvaluationStatus
from dyknow_dashboard.model.live_reports import WINDOW_NS, live_report
from dyknow_recordings import FormulaReport
from dyknow_recordings.evaluation.recorded_map import RecordedMap, Track
from dyknow_recordings.evaluation.results import Outcome
from dyknow_recordings.markers import objects_of
from dyknow_recordings.reporting.pictures.maps import map_image
from dyknow_recordings.reporting.pictures.timeline import Span

MAX_POSITIONS: Final = 1200
"""The positions that are kept of an object: at 10 Hz, those of two minutes."""

MAX_POINTS: Final = 5000
"""The points that a map shows of all tracks: 80 KB, which a page gets once a second."""

Position = tuple[str, int, float, float]
"""An object, a valid time in nanoseconds, and x and y then."""


class LiveMap:
    """The regions of a robot, and the tracks of the objects that formulas are about.

    The map of a formula that has ended is that of its end.

    Args:
        known: the regions, and the topics of positions.
    """

    def __init__(self, known: RobotMap) -> None:
        self._known = known
        self._tracks: dict[str, deque[tuple[int, float, float]]] = {}
        self._ended: dict[str, str] = {}
        self.topics: Mapping[str, PositionFields] = {}
        """The topic of each object that a running formula is about."""

    def follow(self, evaluations: Mapping[str, EvaluationStatus]) -> None:
        """Keep the tracks that the maps of some evaluations show, by their keys, and no others."""
        if not self._known.regions:
            return
        self._ended = {key: each for key, each in self._ended.items() if key in evaluations}
        running: list[EvaluationStatus] = []
        for key, status in evaluations.items():
            if status.phase is not EvaluationPhase.ENDED:
                running.append(status)
            elif key not in self._ended:
                self._ended[key] = self._drawn(status)
        names = {name for each in running for name in objects_of(each.groundings)}
        topics = self._known.positions
        self.topics = {name: topics[name] for name in names & topics.keys()}
        self._tracks = {name: each for name, each in self._tracks.items() if name in names}

    def add(self, positions: Iterable[Position]) -> None:
        """Add positions; one that is not later than those before is not drawn."""
        for name, time, x, y in positions:
            if name in self.topics:
                track = self._tracks.setdefault(name, deque(maxlen=MAX_POSITIONS))
                if not track or track[-1][0] < time:
                    track.append((time, x, y))

    def image(self, key: str, status: EvaluationStatus) -> str:
        """Return the map of an evaluation as SVG; empty if it is about nothing on it."""
        return self._ended[key] if key in self._ended else self._drawn(status)

    def _drawn(self, status: EvaluationStatus) -> str:
        objects = objects_of(status.groundings)
        if objects.isdisjoint(each.name for each in self._known.regions):
            return ''
        tracks = {
            name: _track(self._tracks[name]) for name in sorted(objects & self._tracks.keys())
        }
        most = max(MAX_POINTS // max(len(tracks), 1), 2)
        latest = status.decided_at or status.latest_valid_time or status.started
        report = _lately(live_report(status), latest - WINDOW_NS)
        whole = Span(status.started, latest)
        return map_image(RecordedMap(self._known.regions, tracks), [report], whole, most)


def _track(points: Iterable[tuple[int, float, float]]) -> Track:
    times, x, y = zip(*points, strict=True)
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
