"""What a peer tells its host of the others. All times are in nanoseconds of the own clock."""

from __future__ import annotations

from dataclasses import dataclass

from dyknow_common import Value
from dyknow_federation.messages import Shares


@dataclass(frozen=True, slots=True)
class PeerEvent:
    """An event of a peer."""

    peer: str


@dataclass(frozen=True, slots=True)
class PeerLeft(PeerEvent):
    """A peer has not been heard for `peer_timeout`. Requests to it stay, in case it returns."""

    reason: str


@dataclass(frozen=True, slots=True)
class PeerFault(PeerEvent):
    """A message of a peer, or of another sender, is refused."""

    message: str


@dataclass(frozen=True, slots=True)
class SharesChanged(PeerEvent):
    """The shares of a peer."""

    shares: Shares


@dataclass(frozen=True, slots=True)
class ValueKnown(PeerEvent):
    """The value of a stream since a time; it has alternatives where the clocks leave it open."""

    stream: str
    time: int
    value: Value


@dataclass(frozen=True, slots=True)
class StreamViolated(PeerEvent):
    """A violation of a stream, after all values that are known.

    The host of the stream has noticed it, or refuses the request, or the times of samples are too
    uncertain, or samples after the last one that arrived are lost for good.
    """

    stream: str
    constraint: str
    reason: str
    valid_time: int | None = None
    """The valid time from which samples are in doubt; None: from the latest sample on."""


@dataclass(frozen=True, slots=True)
class WatermarkArrived(PeerEvent):
    """What is not known yet of the values of a stream holds after a time."""

    stream: str
    time: int


@dataclass(frozen=True, slots=True)
class FormulaAnswered(PeerEvent):
    """A peer will evaluate a formula, or refuses it, or has not answered in time."""

    stream: str
    refusal: str


@dataclass(frozen=True, slots=True)
class FormulaWaits(PeerEvent):
    """Why a formula has no state that a peer evaluates; until something is known of its verdict."""

    stream: str
    reason: str


@dataclass(frozen=True, slots=True)
class ClockJumped(PeerEvent):
    """The clock of a peer, whose samples may have wrong times, or the own one, has jumped."""

    since: int | None
    """The last time at which the clocks agreed with what was known; None without one."""
