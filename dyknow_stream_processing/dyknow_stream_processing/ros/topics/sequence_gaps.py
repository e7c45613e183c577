"""Messages that the middleware lost, told by the numbers that it gives them."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from collections.abc import Set as AbstractSet

from rclpy.node import Node


class SequenceGaps:
    """Follows the numbers of the messages of a topic, which each of its publishers counts itself.

    A publisher that was killed is listed for another 20 s, beside the one that took its place.

    Args:
        publishers: lists those of the topic.
        missed: is told how many messages were lost, before the message that shows it; 0 where
            that cannot be known: another publisher may have come meanwhile.
    """

    def __init__(
        self, publishers: Callable[[], AbstractSet[Hashable]], missed: Callable[[int], None]
    ) -> None:
        self._publishers = publishers
        self._missed = missed
        self._known: AbstractSet[Hashable] = frozenset()
        # The next number of each publisher; that of the one that was heard last at the end.
        self._expected: list[int] = []

    def note(self, number: int | None) -> None:
        """Takes the number of a message."""
        if number is None:
            return  # Not all middleware numbers its messages.
        expected = self._expected
        if expected and expected[-1] == number:
            expected[-1] += 1
            return
        if number in expected:
            expected.remove(number)
        elif expected:
            self._judge(number)
        else:
            self._known = self._publishers()
        expected.append(number + 1)

    def _judge(self, number: int) -> None:
        """Finds out why a number comes that is nobody's next one."""
        known, self._known = self._known, self._publishers()
        expected, publishers = self._expected, max(len(self._known), 1)
        # Those that were not heard for the longest time are gone.
        del expected[: max(len(expected) - publishers, 0)]
        before = max((each for each in expected if each < number), default=None)
        if len(expected) < publishers:
            # One that was there from the beginning, unless one that was heard has lost some.
            if before is not None or not self._known <= known:
                self._missed(0)
        elif before is None:
            del expected[0]
            self._missed(0)
        else:
            expected.remove(before)
            self._missed(number - before)


def publishers_of(node: Node, topic: str) -> frozenset[tuple[int, ...]]:
    """What tells the publishers of a topic from each other."""
    found = node.get_publishers_info_by_topic(topic)
    return frozenset(tuple(each.endpoint_gid) for each in found)
