"""The version of what a node knows, by which others learn that it has changed."""

from __future__ import annotations

from collections.abc import Iterable

from dyknow_interfaces.msg import SemanticsVersion
from std_msgs.msg import Header

from dyknow_common.ros import LATCHED, NO_PUBLISHER_EVENTS, DyKnowNode


class Version:
    """Counts changes, and tells each on the latched topic `~/version`.

    Args:
        node: the node that knows it.
    """

    def __init__(self, node: DyKnowNode) -> None:
        self.number = 0
        self._node = node
        self._publisher = node.create_publisher(
            SemanticsVersion, '~/version', LATCHED, event_callbacks=NO_PUBLISHER_EVENTS
        )

    def __str__(self) -> str:
        """The number."""
        return str(self.number)

    def advance(self, concepts: Iterable[str] = ()) -> None:
        """Tells of a change.

        Args:
            concepts: those whose matches or instances may be others now; none if any may be.
        """
        self.number += 1
        self._publisher.publish(
            SemanticsVersion(
                header=Header(stamp=self._node.get_clock().now().to_msg()),
                version=self.number,
                concepts=list(concepts),
            )
        )
