"""What a peer tells its host of the others. All times are in nanoseconds of the own clock."""

from __future__ import annotations

from dataclasses import dataclass

from dyknow_common import Value
from dyknow_federation.messages import Shares, StreamFault


@dataclass(frozen=True, slots=True)
class PeerJoined:
    """A peer is heard for the first time, again after it had left, or in a new run."""

    peer: str


@dataclass(frozen=True, slots=True)
class PeerLeft:
    """A peer has not been heard for `peer_timeout`. Requests to it stay, in case it returns."""

    peer: str
    reason: str


@dataclass(frozen=True, slots=True)
class PeerFault:
    """A message that is refused; the peer may be empty if it is not known."""

    peer: str
    message: str


@dataclass(frozen=True, slots=True)
class SharesChanged:
    """The shares of a peer."""

    peer: str
    shares: Shares


@dataclass(frozen=True, slots=True)
class StreamWanted:
    """A peer has asked for an own stream that nobody asked for: `publish` its samples."""

    stream: str


@dataclass(frozen=True, slots=True)
class StreamUnwanted:
    """Nobody has asked for an own stream for the time of the history."""

    stream: str


@dataclass(frozen=True, slots=True)
class StreamRefused:
    """A peer does not grant a request."""

    peer: str
    stream: str
    reason: str


@dataclass(frozen=True, slots=True)
class RemoteSample:
    """A sample of a peer.

    Args:
        valid_time: the middle of what is possible.
        uncertainty: the valid time is at most this far from the middle.
        value: the value of the feature.
    """

    valid_time: int
    uncertainty: int
    value: Value

    @property
    def earliest(self) -> int:
        """The earliest possible valid time."""
        return self.valid_time - self.uncertainty

    @property
    def latest(self) -> int:
        """The latest possible valid time."""
        return self.valid_time + self.uncertainty


@dataclass(frozen=True, slots=True)
class SampleArrived:
    """The next sample of a stream; their order is that of their true valid times."""

    peer: str
    stream: str
    sample: RemoteSample


@dataclass(frozen=True, slots=True)
class SamplesLost:
    """Samples between the last one that arrived and the next one cannot be had any more."""

    peer: str
    stream: str
    count: int
    reason: str


@dataclass(frozen=True, slots=True)
class StreamViolated:
    """The host of a stream has noticed a violation, after all samples that have arrived.

    Its valid time is the earliest one that is possible.
    """

    peer: str
    stream: str
    fault: StreamFault


@dataclass(frozen=True, slots=True)
class WatermarkArrived:
    """All later samples of a stream are certainly valid after a time."""

    peer: str
    stream: str
    time: int


@dataclass(frozen=True, slots=True)
class ClockJumped:
    """The clock of a peer, or the own one, has jumped.

    Args:
        peer: whose samples may have wrong times.
        since: the last time at which the clocks agreed with what was known; None without one.
    """

    peer: str
    since: int | None


Event = (
    PeerJoined
    | PeerLeft
    | PeerFault
    | SharesChanged
    | StreamWanted
    | StreamUnwanted
    | StreamRefused
    | SampleArrived
    | SamplesLost
    | StreamViolated
    | WatermarkArrived
    | ClockJumped
)
"""An event."""
