"""The verdict of a formula that is evaluated for a peer, as far as the peer is told.

A promise that a formula is undecided until a time covers the states that have been evaluated, and
the times that are known to have no state:

     0.0 s  the evaluation begins: nothing is told, as no state has been evaluated
     0.4 s  the first state is at 0.3 s: `undecided` since then, and no verdict until 0.3 s
     1.4 s  all samples until 1.3 s have come: no verdict until 1.1 s
     2.0 s  a sensor falls silent: nothing is promised, as later states are not known
     5.0 s  the evaluation waits: the peer is told why
     7.2 s  the state of 7.1 s decides it: `false`, since 7.1 s
"""

from __future__ import annotations

from typing import Final

from dyknow_common import NANOSECONDS, SECOND_NS, Verdict
from dyknow_coordinator import Answer, Progress
from dyknow_federation.clocks import BEGINNING
from dyknow_federation.messages import MAX_REASON, StreamFault
from dyknow_federation.peer import Peer
from dyknow_federation.push_down import PRESUMABLY_FALSE, UNDECIDED, verdict_text
from dyknow_stream_processing import ViolationKind

EVALUATION_NS: Final = 200 * NANOSECONDS['ms']
"""How long the verdict on a state may come after its samples: it is not promised away before."""

REPEAT_NS: Final = 2 * SECOND_NS
"""The time of states after which a verdict is told again: no reader takes it for silent."""

WAIT_REPEAT_NS: Final = SECOND_NS
"""The time after which a peer is told again why no state comes."""


class OwnVerdict:
    """The verdict of a formula that is evaluated for a peer.

    Args:
        peer: the own host among its peers.
        name: the name of the stream of the verdict.
    """

    def __init__(self, peer: Peer, name: str) -> None:
        self._peer = peer
        self._name = name
        self._told = ''
        """The verdict that was told last; empty before the first state."""
        self._told_until = self._promised = BEGINNING
        self._waits_for = ''
        self._explained_at = BEGINNING
        self._is_decided = self._has_failed = False

    def wait(self, reason: str, now: int) -> None:
        """Note why no state comes; empty if states come."""
        if reason != self._waits_for:
            self._waits_for, self._explained_at = reason, BEGINNING
            self._explain(now)

    def note(self, progress: Progress, now: int) -> None:
        """Tell if it would be false without further states, when that has changed."""
        if self._has_ended:
            return  # Feedback may arrive after the verdict.
        self.wait(progress.waits_for, now)
        if not progress.states_progressed:
            return
        verdict = PRESUMABLY_FALSE if progress.presumably_false else UNDECIDED
        if verdict != self._told:
            self._tell(verdict, progress.latest_valid_time, now)

    def advance(self, known_until: int | None, now: int) -> None:
        """Promise that the latest verdict told is still valid, as far as this is known.

        Args:
            known_until: until when all samples are known that it depends on; None if nothing is
                known of some stream.
            now: the time.
        """
        if self._has_failed:
            return
        if self._is_decided:
            known_until = now - 1
        else:
            self._explain(now)
            if not self._told or self._waits_for or known_until is None:
                return
            known_until -= EVALUATION_NS
        if known_until <= self._promised:
            return
        if known_until - self._told_until >= REPEAT_NS:
            self._tell(self._told, known_until, now)
        self._promise(known_until, now)

    def decide(self, answer: Answer, reason: str, now: int) -> None:
        """Tell the verdict of an answer, since the state that has decided it, and its reason."""
        if self._has_ended:
            return
        self._is_decided = True
        verdict = verdict_text(is_true=answer.verdict is Verdict.TRUE, reason=reason)
        self._tell(verdict, now - 1 if answer.decided_at is None else answer.decided_at, now)
        self._promise(now - 1, now)

    def fail(self, reason: str, now: int) -> None:
        """Tell why there is no verdict."""
        if self._has_ended:
            return
        self._has_failed = True
        fault = StreamFault(now, str(ViolationKind.MESSAGE), reason[:MAX_REASON])
        self._peer.violate(self._name, fault, now)

    @property
    def _has_ended(self) -> bool:
        return self._is_decided or self._has_failed

    def _tell(self, verdict: str, time: int, now: int) -> None:
        time = max(time, self._promised + 1)
        self._peer.publish(self._name, time, verdict, now)
        self._told, self._told_until = verdict, time
        self._promise(time, now)

    def _promise(self, time: int, now: int) -> None:
        self._promised = max(self._promised, time)
        self._peer.promise(self._name, self._promised, now)

    def _explain(self, now: int) -> None:
        if self._waits_for and now - self._explained_at >= WAIT_REPEAT_NS:
            self._explained_at = now
            self._peer.explain(self._name, self._waits_for)
