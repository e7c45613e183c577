"""Maps of recordings: the regions of a robot, and where its objects were."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dyknow_configuration import RobotMap
from dyknow_recordings.reading.columns import MessageColumns
from dyknow_recordings.reading.recording import RecordingReader
from dyknow_space import Region

MAX_POINTS: Final = 2_000
"""The number of points of a track: all, or some at equal distances in the recording."""

Track = tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]
"""Times in nanoseconds, and the coordinates then."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedMap:
    """Regions, and the tracks of objects by name."""

    regions: tuple[Region, ...] = ()
    tracks: dict[str, Track] = field(default_factory=dict)


def recorded_map(recording: RecordingReader, known: RobotMap) -> RecordedMap:
    """Return the map of a recording; an object whose topic lacks the fields has no track."""
    fields: defaultdict[str, set[str]] = defaultdict(set)
    for topic, *axes in known.positions.values():
        content = recording.contents.get(topic)
        if content is not None and content.fields and {*axes} <= content.fields.keys():
            fields[topic].update(axes)
    parts: dict[str, list[MessageColumns]] = {}
    for part in recording.columns(fields) if fields else ():
        parts.setdefault(part.topic, []).append(part)
    tracks: dict[str, Track] = {}
    for name, (topic, *axes) in known.positions.items():
        if topic in parts:
            tracks[name] = _track(parts[topic], *axes)
    return RecordedMap(known.regions, tracks)


def _track(parts: Sequence[MessageColumns], *axes: str) -> Track:
    step = -(-sum(len(each.log_times) for each in parts) // MAX_POINTS)
    times = [each.log_times if each.stamps is None else each.stamps for each in parts]
    x, y = (
        np.concatenate([each.values[axis] for each in parts]).astype(np.float64) for axis in axes
    )
    return np.concatenate(times)[::step], x[::step], y[::step]
