"""Messages that the middleware lost, told by the numbers that it gives them."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


class Numbering:
    """Follows the numbers of the messages of a topic, which each of its publishers counts itself.

    A publisher that was killed is counted for another 20 s, beside the one that took its place.

    Args:
        count_publishers: how many publishers the topic has.
        missed: is told how many messages were lost, before the message that shows it; 0 where the
            numbers begin anew: another publisher has come, and nobody knows what was before.
    """

    def __init__(self, count_publishers: Callable[[], int], missed: Callable[[int], None]) -> None:
        self._count_publishers = count_publishers
        self._missed = missed
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
        expected.append(number + 1)

    def _judge(self, number: int) -> None:
        """Finds out why a number comes that is nobody's next one."""
        expected, publishers = self._expected, max(self._count_publishers(), 1)
        if len(expected) < publishers:
            self._missed(0)
            return
        # Those that were not heard for the longest time are gone.
        del expected[: len(expected) - publishers]
        before = max((each for each in expected if each < number), default=None)
        if before is None:
            del expected[0]
            self._missed(0)
        else:
            expected.remove(before)
            self._missed(number - before)
