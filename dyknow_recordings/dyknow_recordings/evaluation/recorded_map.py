"""Maps of recordings: the regions of a robot, and where its objects were."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import NO_CONSTRAINTS, DyKnowError
from dyknow_configuration import RobotMap, TextSource
from dyknow_coordinator import parse_sources
from dyknow_recordings.evaluation.streams import RecordedStreams
from dyknow_recordings.reading.recording import RecordingReader, batches, parts_by_topic, rows_of
from dyknow_space import Region
from dyknow_stream_processing import Sample

MAX_POINTS: Final = 2_000
"""The most points of a track: all points, or points at equal distances and at failures."""

Track = tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]
"""Times in nanoseconds, and the coordinates then."""

Outlines = Sequence[tuple[int, str]]
"""Times in nanoseconds, and the polygons from then on, in well-known text."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedMap:
    """Regions, and where objects were.

    Args:
        frame: the frame of the map; shapes in other frames are not drawn.
        regions: the regions that stand still.
        tracks: the tracks of objects, by name.
        outlines: the outlines of regions that move, by name.
    """

    frame: str = ''
    regions: tuple[Region, ...] = ()
    tracks: Mapping[str, Track] = field(default_factory=dict)
    outlines: Mapping[str, Outlines] = field(default_factory=dict)


def recorded_map(
    recording: RecordingReader,
    known: RobotMap,
    files: Iterable[TextSource] = (),
    moments: Collection[int] = (),
) -> RecordedMap:
    """Return the map of a recording; an object whose stream cannot be made has no track.

    Args:
        recording: the recording.
        known: the regions, and the streams.
        files: in the stream language, for positions from streams.
        moments: the times, in nanoseconds, at which all places are shown, beside the end.
    """
    streams = RecordedStreams(recording.contents, files, recording.fault_of, any_delay=True)
    fields = streams.prepare(parse_sources(known.streams.values()))
    traces: dict[str, _Trace] = {}
    for name, text in known.streams.items():
        traces[name] = trace = _Trace(moments, is_outline=name in known.outlines)
        with suppress(DyKnowError):
            streams.create(_LABEL + name, text, NO_CONSTRAINTS, trace.samples.append)
    for batch in batches(recording.columns(fields)) if fields else ():
        found = streams.step_many(parts_by_topic(batch), max(int(p.log_times[-1]) for p in batch))
        for message in rows_of(batch) if found is None else ():
            streams.push(message)
        for name, trace in traces.items():
            trace.add_samples()
            if samples := (found or {}).get(_LABEL + name):
                trace.add(samples.valid_times, samples.columns)
    if fields:
        streams.dataflow.advance(recording.end_time)
    return RecordedMap(
        known.frame,
        known.regions,
        {name: track for name in known.positions if (track := traces[name].track())},
        {name: lines for name in known.outlines if (lines := traces[name].outlines())},
    )


_LABEL: Final = 'map of '
"""Begins the names of the streams of maps; no stream of a file has such a name."""


class _Trace:
    """The samples of a stream that a map may show."""

    def __init__(self, moments: Collection[int], *, is_outline: bool) -> None:
        self.samples: list[Sample] = []
        """Those that have come one by one; see `add_samples`."""
        self._moments, self._is_outline = [*moments], is_outline
        self._parts: list[tuple[NDArray[np.int64], Mapping[str, NDArray[Any]]]] = []

    def add_samples(self) -> None:
        """Add the samples that have come one by one."""
        if samples := [*self.samples]:
            self.samples.clear()
            times = np.array([each.valid_time for each in samples], np.int64)
            names = samples[0].fields
            columns = {name: np.array([s.fields[name] for s in samples]) for name in names}
            self.add(times, columns)

    def add(self, times: NDArray[np.int64], columns: Mapping[str, NDArray[Any]]) -> None:
        """Add samples as columns."""
        self._parts.append((times, columns))
        if self._is_outline:
            # Outlines are large: keep only the outlines that are shown.
            self._keep(0)

    def track(self) -> Track | None:
        """Return the track; None without numbers."""
        self.add_samples()
        self._keep(MAX_POINTS)
        for times, columns in self._parts:
            x, y = columns['x'], columns['y']
            if {x.dtype.kind, y.dtype.kind} <= {*'biuf'}:
                return times, x.astype(np.float64), y.astype(np.float64)
        return None

    def outlines(self) -> Outlines:
        """Return the outlines."""
        self.add_samples()
        for times, columns in self._parts:
            return [*zip(times.tolist(), map(str, columns['outline']), strict=True)]
        return ()

    def _keep(self, count: int) -> None:
        """Keep `count` samples at equal distances, the samples at the moments, and the last one."""
        if not self._parts:
            return
        times = np.concatenate([each for each, _ in self._parts])
        names = self._parts[0][1]
        columns = {name: np.concatenate([part[name] for _, part in self._parts]) for name in names}
        ends = np.searchsorted(times, self._moments, 'right') - 1
        regular = range(0, len(times), -(-len(times) // count) or 1) if count else ()
        kept = sorted({*regular, *ends.tolist(), len(times) - 1} - {-1})
        self._parts = [(times[kept], {name: each[kept] for name, each in columns.items()})]
