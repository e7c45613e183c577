"""The positions of vehicles over the time of a recording."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from dyknow_common import DyKnowError
from dyknow_recordings.markers.fences import Point
from dyknow_recordings.markers.markers import ODOMETRY
from dyknow_recordings.reading.opening import open_recording
from dyknow_recordings.reading.recording import in_order

_TYPE: Final = 'nav_msgs/msg/Odometry'
_FRAME: Final = 'header.frame_id'
_POSITION: Final = tuple(f'pose.pose.position.{axis}' for axis in 'xyz')


@dataclass(frozen=True, slots=True)
class VehiclePosition:
    """The position of a vehicle at a time.

    Args:
        log_time: in nanoseconds.
        frame: the frame of the position.
    """

    log_time: int
    vehicle: str
    frame: str
    position: Point


def recorded_positions(path: Path, vehicles: Collection[str]) -> Iterator[VehiclePosition]:
    """Yield the positions of vehicles in the order of their log times, as far as they are recorded.

    A recording that cannot be read has none: what is wrong with it has been reported before.

    Args:
        path: of the recording.
        vehicles: their names, which are in the names of their topics.
    """
    try:
        with open_recording(path) as recording:
            names = [each.name for each in recording.topics if each.message_type == _TYPE]
            topics = {
                topic: vehicle
                for vehicle in sorted(vehicles)
                for topic in names
                if topic.endswith(f'/{ODOMETRY.replace("<vehicle>", vehicle)}')
            }
            if not topics:
                return
            fields = dict.fromkeys(topics, (_FRAME, *_POSITION))
            for each in in_order(recording.columns(fields)):
                if not each.absent:
                    x, y, z = (float(each.values[name]) for name in _POSITION)
                    vehicle, frame = topics[each.topic], str(each.values[_FRAME])
                    yield VehiclePosition(each.log_time, vehicle, frame, (x, y, z))
    except DyKnowError:
        return
