"""Messages of transforms and of the statuses of actions, without ROS."""

from __future__ import annotations

from types import SimpleNamespace as Fields
from typing import Any

from recorded_flow import MILLISECOND, Flow

from dyknow_stream_processing import Sample, WholeMessage

UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def stamp(milliseconds: float) -> Any:
    sec, nanosec = divmod(round(milliseconds * MILLISECOND), 10**9)
    return Fields(sec=sec, nanosec=nanosec)


def transform(
    parent: str,
    child: str,
    at: float,
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0),
    rotation: tuple[float, float, float, float] = UPRIGHT,
) -> Any:
    """Return a geometry_msgs/msg/TransformStamped; the time is in milliseconds."""
    return Fields(
        header=Fields(stamp=stamp(at), frame_id=parent),
        child_frame_id=child,
        transform=Fields(
            translation=Fields(**dict(zip('xyz', translation, strict=True))),
            rotation=Fields(**dict(zip('xyzw', rotation, strict=True))),
        ),
    )


def push(flow: Flow, topic: str, now: float, message: Any) -> None:
    """Push a whole message at a time in milliseconds."""
    time = round(now * MILLISECOND)
    flow.dataflow.push(topic, Sample(time, time, WholeMessage({}, message)))


def push_transforms(flow: Flow, now: float, *transforms: Any, static: bool = False) -> None:
    push(flow, '/tf_static' if static else '/tf', now, Fields(transforms=list(transforms)))
