"""The version of the contents of a semantic node."""

from __future__ import annotations

from collections.abc import Iterable

from dyknow_interfaces.msg import SemanticsVersion
from std_msgs.msg import Header

from dyknow_common.ros import LATCHED, DyKnowNode


class VersionPublisher:
    """Counts changes, and publishes each on the latched topic `~/version`."""

    def __init__(self, node: DyKnowNode) -> None:
        self.number = 0
        self._node = node
        self._publisher = node.create_publisher(SemanticsVersion, '~/version', LATCHED)

    def publish_change(self, concepts: Iterable[str] = ()) -> None:
        """Publish the concepts whose matches or instances may have changed; empty: any concept."""
        self.number += 1
        self._publisher.publish(
            SemanticsVersion(
                header=Header(stamp=self._node.get_clock().now().to_msg()),
                version=self.number,
                concepts=list(concepts),
            )
        )
