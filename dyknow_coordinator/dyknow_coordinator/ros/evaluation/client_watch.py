"""Whether those who ask are still there."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dyknow_common.ros import DyKnowNode

PERIOD: Final = 1.0
"""Seconds between two looks."""


class ClientWatch:
    """Notices that nobody on the graph can take an answer any more.

    Args:
        service: by which one asks, its absolute name; an action has a hidden one for its results.
        on_gone: is called when no client of it is left, at each look.
    """

    def __init__(self, node: DyKnowNode, service: str, on_gone: Callable[[], None]) -> None:
        self._node = node
        self._service = service
        self._on_gone = on_gone
        # One look may miss a client that is just being discovered.
        self._missed = 0
        node.create_timer(PERIOD, self._look, clock=node.wall_clock)

    def _look(self) -> None:
        self._missed = 0 if self._node.count_clients(self._service) else self._missed + 1
        if self._missed > 1:
            self._on_gone()
