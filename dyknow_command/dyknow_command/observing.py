"""Topics of the running robot, for proposals and checks of a robot.yaml."""

from __future__ import annotations

import argparse
from collections.abc import Collection

from dyknow_common import DyKnowError, ExitCode, duration_option
from dyknow_common.executables import SOURCE_ENVIRONMENT
from dyknow_configuration import ObservedTopic, ReadFields


def absolute_topic(name: str) -> str:
    """Return the absolute name of a topic."""
    return f'/{name.lstrip("/")}'


def observe(
    duration: int, fields: ReadFields, topic: str = '', named: Collection[str] = ()
) -> tuple[ObservedTopic, ...]:
    """Return the topics of the running robot.

    Args:
        duration: how long they are observed, in nanoseconds.
        fields: returns the fields of a topic whose values are wanted.
        topic: the only topic to observe; empty for all.
        named: the topics to observe even if they are of ROS or DyKnow itself.

    Raises:
        DyKnowError: UNAVAILABLE, without ROS.
    """
    try:
        # Observing a recording needs no ROS.
        from dyknow_command.ros.listening import observe_running  # noqa: PLC0415
    except ImportError as error:
        text = f'listening to a running robot needs ROS: {error}; {SOURCE_ENVIRONMENT}'
        raise DyKnowError(text, ExitCode.UNAVAILABLE) from None
    return observe_running(duration, fields, topic, named)


def add_duration_option(parser: argparse.ArgumentParser) -> None:
    """Add the time for which the running robot is observed."""
    parser.add_argument(
        '--duration',
        type=duration_option,
        default='5 s',
        metavar='TIME',
        help='how long to listen to the running robot (default: 5 s)',
    )
