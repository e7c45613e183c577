"""Messages that the middleware lost, told by the numbers that it gives them."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


class Numbering:
    """Follows the numbers of the messages of a topic.

    Args:
        count_publishers: how many publishers the topic has; where there are several, each numbers
            its messages for itself, and nothing can be told.
        missed: is told how many messages were lost; 0 where the numbers begin anew.
    """

    def __init__(self, count_publishers: Callable[[], int], missed: Callable[[int], None]) -> None:
        self._count_publishers = count_publishers
        self._missed = missed
        self._next: int | None = None
        self._several = False

    def look_again(self) -> None:
        """Has the publishers counted anew when numbers do not follow each other."""
        self._several = False

    def note(self, number: int | None) -> None:
        """Takes the number of a message."""
        if number is None:
            return  # Not all middleware numbers its messages.
        expected, self._next = self._next, number + 1
        if expected in {None, number} or self._several:
            return
        self._several = self._count_publishers() > 1
        if not self._several:
            self._missed(max(number - (expected or 0), 0))
