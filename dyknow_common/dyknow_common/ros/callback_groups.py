"""Callback groups of nodes that create and destroy entities as long as they run."""

from __future__ import annotations

from typing import Any
from weakref import ref

from rclpy.callback_groups import ReentrantCallbackGroup


class PrunedCallbackGroup(ReentrantCallbackGroup):
    """A reentrant callback group without the entities that are gone.

    The groups of rclpy keep a dead reference for each entity that they ever had: a node that
    subscribes to new topics again and again would grow by half a kilobyte each time.
    """

    def add_entity(self, entity: Any) -> None:
        """Add a subscription, timer, client, service or waitable, for as long as it exists."""
        self.entities.add(ref(entity, self.entities.discard))
