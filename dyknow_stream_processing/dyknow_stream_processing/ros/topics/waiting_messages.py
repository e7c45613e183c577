"""Messages that the middleware has received, and no callback has processed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from dyknow_common.ros import MessageGuard
from dyknow_stream_processing.ros.topics.publications import QUEUE_DEPTH


def take_waiting(subscription: Any) -> Iterator[tuple[Any, Any]]:
    """Take the messages that wait for the callback of a subscription, with their infos."""
    guard = subscription.callback
    take = guard.take if isinstance(guard, MessageGuard) and guard.needs_sender else _take
    with subscription.handle:
        # A fast publisher must not keep the caller busy without end.
        for _ in range(QUEUE_DEPTH):
            taken = take(subscription)
            if taken is None:
                return
            yield taken


def _take(subscription: Any) -> Any:
    return subscription.handle.take_message(subscription.msg_type, subscription.raw)
