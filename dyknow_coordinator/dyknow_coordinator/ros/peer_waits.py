"""Why the peers of this host have no verdict yet of the parts of formulas that they evaluate."""

from __future__ import annotations

import json
from typing import Any

from std_msgs.msg import String

from dyknow_common.ros import DyKnowNode
from dyknow_coordinator.reporting.peer_reasons import PEER_WAITS, with_waits_of_peers


class PeerWaits:
    """The reasons of peers, as the federation node reports them.

    Args:
        node: the coordinator.
        federation: the name of the federation node.
    """

    def __init__(self, node: DyKnowNode, federation: str) -> None:
        self._waits: dict[str, str] = {}
        topic = f'{federation}/{PEER_WAITS}'
        node.create_report_subscription(String, topic, self._take, callback_group=node.reentrant)

    def _take(self, message: Any) -> None:
        self._waits = json.loads(message.data)

    def explained(self, waits_for: str) -> str:
        """Return why no state comes, with the reasons of peers."""
        return with_waits_of_peers(waits_for, self._waits)
