"""Sequence gaps in a stream of messages: messages that the middleware lost.

Each publisher of a topic numbers its messages. A killed publisher stays listed for another 20 s,
beside its successor. For example:

    publishers                      numbers         reported
    a                               7 8 11          2 before 11: 9 and 10 are lost
    a, restarted                    7 8 1 2         0 before 1: unknown how many of a are lost
    a killed, b appears             55 56 1 2 5     0 before 1, 2 before 5
    a and b from the beginning      20 10 21 11     none: each counts for itself
    a and b from the beginning      1 2 57          0 before 57: the first of b, or a gap of a
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from collections.abc import Set as AbstractSet


class SequenceGaps:
    """Detector of gaps in the sequence numbers of a topic's messages.

    Args:
        publishers: returns identifiers of the publishers of the topic.
        on_gap: is called with the number of lost messages, before the message that reveals the
            gap; 0 if the number is unknown, as another publisher may have appeared.
    """

    def __init__(
        self, publishers: Callable[[], AbstractSet[Hashable]], on_gap: Callable[[int], None]
    ) -> None:
        self._publishers = publishers
        self._on_gap = on_gap
        self._known: AbstractSet[Hashable] = frozenset()
        # The next number of each publisher; the latest publisher is at the end.
        self._expected: list[int] = []
        # Those of publishers whose messages may be lost.
        self._doubted: list[int] = []

    def doubt(self, publishers: int) -> None:
        """Note that messages of any of the publishers may be lost, given how many there are."""
        self._forget(max(publishers, 1))
        self._doubted = [*self._expected]

    def note(self, number: int | None, *, is_proof: bool = False) -> bool:
        """Check the number of a message; None if the middleware does not number messages.

        Returns:
            True if it ends the doubt: since `doubt`, each publisher has sent a message that is
            proof, and every gap before these is reported.

        Args:
            number: the number.
            is_proof: True if the message was sent after all of which there is doubt.
        """
        if number is None:
            return False
        is_doubted = bool(self._doubted)
        if number in self._expected:
            self._expected.remove(number)
            self._prove(number, number, is_proof=is_proof)
        elif self._expected:
            self._report_gap(number, is_proof=is_proof)
        else:
            self._known = self._publishers()
        self._expected.append(number + 1)
        return is_doubted and not self._doubted

    def _prove(self, expected: int, number: int, *, is_proof: bool) -> None:
        """Note a message of the publisher from which another number was expected."""
        if expected in self._doubted:
            self._doubted.remove(expected)
            if not is_proof:
                self._doubted.append(number + 1)

    def _forget(self, publishers: int) -> None:
        """Forget the publishers that were silent for longest, if fewer are left: they are gone."""
        del self._expected[: max(len(self._expected) - publishers, 0)]

    def _report_gap(self, number: int, *, is_proof: bool) -> None:
        """Attribute an unexpected number to a gap, a new publisher or a silent one."""
        known, self._known = self._known, self._publishers()
        expected, publishers = self._expected, max(len(self._known), 1)
        self._forget(publishers)
        before = max((each for each in expected if each < number), default=None)
        if len(expected) < publishers:
            # Either a new publisher's first message, or a loss by a known one.
            if before is not None or not self._known <= known:
                self._on_gap(0)
        elif before is None:
            self._prove(expected.pop(0), number, is_proof=is_proof)
            self._on_gap(0)
        else:
            expected.remove(before)
            self._prove(before, number, is_proof=is_proof)
            self._on_gap(number - before)
