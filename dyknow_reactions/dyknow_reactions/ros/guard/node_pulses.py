"""The pulses of the nodes that a guard depends on."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, Final

from dyknow_interfaces.msg import Heartbeat

from dyknow_common.ros import HEARTBEAT, DyKnowNode, only_owner

WATCHED: Final = ('stream_reasoning_coordinator', 'stream_reasoning_engine', 'stream_manager')
"""The nodes without which no formula is evaluated, or its states are not replaced.

The engines that make the states are not among them: they give signs of life by the states.
"""


class NodePulses:
    """Subscriptions to the pulses of other nodes.

    Args:
        node: that subscribes.
        names: of the other nodes, relative to its namespace.
        on_pulse: receives the name of the node of each pulse, and the time since its receipt.
    """

    def __init__(
        self, node: DyKnowNode, names: Iterable[str], on_pulse: Callable[[str, int], None]
    ) -> None:
        def note(name: str, _message: object, info: Mapping[str, Any]) -> None:
            on_pulse(name, age_of(info))

        for name in names:
            node.create_subscription(
                Heartbeat,
                f'{name}/_pulse',
                partial(note, name),
                HEARTBEAT,
                refusal=only_owner,
                callback_group=node.reentrant,
            )


def age_of(info: Mapping[str, Any]) -> int:
    """Return the time since the middleware received a message, in nanoseconds.

    A busy process may take messages late; until then they wait in a queue.
    """
    received = info.get('received_timestamp') or 0
    return max(time.time_ns() - received, 0) if received else 0
