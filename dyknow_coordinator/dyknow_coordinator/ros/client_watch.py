"""Watch on the clients of a service or an action."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dyknow_common.ros import DyKnowNode

PERIOD_S: Final = 1.0


class ClientWatch:
    """Detects that a service has no client left on the ROS graph.

    Args:
        service: the absolute name of the service; of an action, the hidden one for its results.
        on_gone: called every second while no client is left.
    """

    def __init__(self, node: DyKnowNode, service: str, on_gone: Callable[[], None]) -> None:
        self._node = node
        self._service = service
        self._on_gone = on_gone
        self._missed = 0
        node.create_timer(PERIOD_S, self._check, clock=node.wall_clock)

    def _check(self) -> None:
        self._missed = 0 if self._node.count_clients(self._service) else self._missed + 1
        # One check may miss a client that is just being discovered.
        if self._missed > 1:
            self._on_gone()
