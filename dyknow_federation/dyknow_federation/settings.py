"""The settings of a peer."""

from __future__ import annotations

from dataclasses import dataclass

from dyknow_common import NANOSECONDS, SECOND_NS
from dyknow_federation.clocks import MAX_DRIFT_PPM


@dataclass(frozen=True, slots=True)
class PeerSettings:
    """The settings of a peer; durations are in nanoseconds.

    Args:
        name: the name of the host, unique among all peers.
        incarnation: the number of this run, unique among all its runs, as the time of its start.
        peer_timeout: a peer that has not been heard for this long has left.
        stale_after: a link over which nothing has been heard for this long is stale.
        history: how long samples are kept for peers that are cut off.
        hello_period: the time between two signs of life.
        probe_period: the time between two measures of a clock.
        retry: the least time until an unanswered request is repeated.
        batch_delay: how long a sample waits for others to be sent with.
        watermark_delay: how long a watermark without a sample waits.
        max_drift_ppm: by how much two clocks drift apart, in millionths.
    """

    name: str
    incarnation: int
    peer_timeout: int = 10 * SECOND_NS
    stale_after: int = 3 * SECOND_NS
    history: int = 60 * SECOND_NS
    hello_period: int = SECOND_NS
    probe_period: int = SECOND_NS
    retry: int = 100 * NANOSECONDS['ms']
    batch_delay: int = 2 * NANOSECONDS['ms']
    watermark_delay: int = 50 * NANOSECONDS['ms']
    max_drift_ppm: int = MAX_DRIFT_PPM
