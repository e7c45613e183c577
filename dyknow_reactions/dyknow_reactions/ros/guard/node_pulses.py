"""The pulses of the nodes that a guard depends on."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Final

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
        on_pulse: receives the name of the node of each pulse.
    """

    def __init__(
        self, node: DyKnowNode, names: Iterable[str], on_pulse: Callable[[str], None]
    ) -> None:
        def note(name: str, _message: object) -> None:
            on_pulse(name)

        for name in names:
            node.create_subscription(
                Heartbeat,
                f'{name}/pulse',
                partial(note, name),
                HEARTBEAT,
                refusal=only_owner,
                callback_group=node.reentrant,
            )
