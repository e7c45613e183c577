"""The settings of a peer."""

from __future__ import annotations

from dataclasses import dataclass

from dyknow_common import NANOSECONDS, SECOND_NS


@dataclass(frozen=True, slots=True)
class PeerSettings:
    """The settings of a peer; durations are in nanoseconds.

    Args:
        name: the name of the host, unique among all peers.
        incarnation: the number of this run, unique among all its runs, as the time of its start.
        peer_timeout: a peer that has not been heard for this long has left.
        history: how long samples are kept for peers that are cut off.
        max_uncertainty: a sample whose valid time is less certain is a violation.
    """

    name: str
    incarnation: int
    peer_timeout: int = 10 * SECOND_NS
    history: int = 60 * SECOND_NS
    max_uncertainty: int = 100 * NANOSECONDS['ms']

    @property
    def stale_after(self) -> int:
        """A link over which nothing has been heard for this long is stale."""
        return self.peer_timeout // 3

    @property
    def hello_period(self) -> int:
        """The time between two signs of life: some of those in `peer_timeout` may be lost."""
        return min(SECOND_NS, self.peer_timeout // 10)
