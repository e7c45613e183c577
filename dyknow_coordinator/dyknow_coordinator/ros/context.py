"""Shared parts of the coordinator."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from rclpy.impl.rcutils_logger import RcutilsLogger

from dyknow_common import SECOND_NS
from dyknow_common.ros import Background, DyKnowNode, ParameterLimits
from dyknow_coordinator.evaluation import FOLLOWED
from dyknow_coordinator.grounding.known_streams import stream_topic
from dyknow_coordinator.ros.cleanup import Cleanup
from dyknow_coordinator.ros.results import Results
from dyknow_coordinator.ros.service_clients import ServiceClients
from dyknow_coordinator.ros.streams_mirror import StreamsMirror


@dataclass(frozen=True, slots=True)
class CoordinatorContext:
    """Parts of the coordinator that every evaluation uses.

    Args:
        clients: clients of the services that it calls.
        streams: all streams of the system.
        results: of the reasoning engine.
        cleanup: destroys unused streams and formula groups.
        background: runs long computations.
        limits: of all evaluations, and of each one.
        names: of formula groups and state streams; unique in the system.
    """

    node: DyKnowNode
    clients: ServiceClients
    streams: StreamsMirror
    results: Results
    cleanup: Cleanup
    background: Background
    limits: ParameterLimits
    names: Iterator[str]

    def outcome_logger(self, *, is_followed: bool) -> RcutilsLogger:
        """Return the logger of what becomes of formulas.

        Args:
            is_followed: True if their clients report it, too: the name of the logger says so.
        """
        logger: RcutilsLogger = self.node.get_logger()
        if is_followed:
            logger = logger.get_child(FOLLOWED)
        return logger

    def wall_time(self) -> int:
        """Return the time of a clock that does not depend on simulated time, in nanoseconds."""
        return int(self.node.wall_clock.now().nanoseconds)

    def wall_time_s(self) -> float:
        """Return the same time in seconds."""
        return self.wall_time() / SECOND_NS

    def state_topic(self, name: str) -> str:
        """Return the topic of a state stream, if an engine in the coordinator's namespace has it.

        So the reasoning engine can subscribe before the stream exists.
        """
        return self.node.resolve_topic_name(stream_topic(name))
