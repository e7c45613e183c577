"""Callback groups of nodes that create and destroy entities as long as they run.

The groups of rclpy keep a dead reference for each entity that they ever had: a node that subscribes
to new topics again and again would grow by a quarter of a kilobyte each time.
"""

from __future__ import annotations

from typing import Any
from weakref import ref

from rclpy.callback_groups import (
    CallbackGroup,
    MutuallyExclusiveCallbackGroup,
    ReentrantCallbackGroup,
)


class _Pruned(CallbackGroup):
    """A callback group without the entities that are gone."""

    def add_entity(self, entity: Any) -> None:
        """Add a subscription, timer, client, service or waitable, for as long as it exists."""
        self.entities.add(ref(entity, self.entities.discard))


class PrunedCallbackGroup(_Pruned, ReentrantCallbackGroup):
    """A reentrant callback group without the entities that are gone."""


class PrunedExclusiveCallbackGroup(_Pruned, MutuallyExclusiveCallbackGroup):
    """A mutually exclusive callback group without the entities that are gone."""
