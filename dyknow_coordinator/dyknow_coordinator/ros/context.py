"""What the parts of the coordinator have in common."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from dyknow_common import SECOND_NS
from dyknow_common.ros import DyKnowNode
from dyknow_coordinator.ros.evaluation.cleanup import Cleanup
from dyknow_coordinator.ros.evaluation.results import Results
from dyknow_coordinator.ros.service_clients import ServiceClients
from dyknow_coordinator.ros.streams_mirror import StreamsMirror


@dataclass(frozen=True, slots=True)
class CoordinatorContext:
    """What every evaluation works with.

    Args:
        node: the coordinator.
        clients: the services that it calls.
        streams: all streams of the system.
        results: of the reasoning engine.
        disposal: ends what is not needed any more.
        names: of formula groups and streams of states; unique in the system.
    """

    node: DyKnowNode
    clients: ServiceClients
    streams: StreamsMirror
    results: Results
    disposal: Cleanup
    names: Iterator[str]

    def wall_time(self) -> float:
        """Seconds of a clock that goes on while simulated time stands still."""
        return float(self.node.wall_clock.now().nanoseconds) / SECOND_NS

    def state_topic(self, name: str) -> str:
        """Where engines in the namespace of the coordinator publish a stream of states."""
        return self.node.resolve_topic_name(f'dyknow/streams/{name}')
