"""Receivers of the messages of a topic."""

from __future__ import annotations

from typing import Any, Protocol

from dyknow_stream_processing.violation import Violation


class MessageListener(Protocol):
    """A receiver of the messages of a topic."""

    def on_type(self, class_: Any) -> None:
        """Receive the type of the messages, once or again.

        Raises:
            StreamError: the first time, if it cannot use them.
        """

    def on_publishers(self, count: int, *, is_latched: bool) -> None:
        """Receive the number of publishers, and whether all keep messages, again and again."""

    def valid_time(self, message: Any) -> int | None:
        """Return the stamp of a message in nanoseconds; None if it has none."""

    def on_message(self, message: Any, now: int, sent_at: int, *, is_initial: bool) -> None:
        """Receive a message.

        Args:
            message: the message.
            now: the time of its receipt in nanoseconds.
            sent_at: the time at which it was sent, by the clock of its sender; 0 if unknown.
            is_initial: True if it was sent before the topic was subscribed to.
        """

    def on_watermark(self, watermark: int, now: int) -> None:
        """Receive a watermark of the engine whose stream the topic is; nanoseconds."""

    def on_dropped(self, reason: str, count: int) -> None:
        """Receive the number of messages that were lost or dropped before the next one."""

    def on_violation(self, violation: Violation) -> None:
        """Receive a violation of the topic."""
