"""Several hosts: their clocks, links, and what they share."""

from dyknow_federation.clocks import Offset, OwnTime, PairClock
from dyknow_federation.encoding import decode, encode
from dyknow_federation.errors import FederationError
from dyknow_federation.events import (
    ClockJumped,
    Event,
    PeerFault,
    PeerJoined,
    PeerLeft,
    SamplesLost,
    SharesChanged,
    StreamUnwanted,
    StreamViolated,
    StreamWanted,
    ValueKnown,
    WatermarkArrived,
)
from dyknow_federation.messages import (
    Packet,
    SharedFeature,
    SharedObject,
    Shares,
    StreamFault,
)
from dyknow_federation.peer import Effects, Peer
from dyknow_federation.possible_values import PossibleValues
from dyknow_federation.remote import RemotePeer
from dyknow_federation.settings import PeerSettings

__all__ = [
    'ClockJumped',
    'Effects',
    'Event',
    'FederationError',
    'Offset',
    'OwnTime',
    'Packet',
    'PairClock',
    'Peer',
    'PeerFault',
    'PeerJoined',
    'PeerLeft',
    'PeerSettings',
    'PossibleValues',
    'RemotePeer',
    'SamplesLost',
    'SharedFeature',
    'SharedObject',
    'Shares',
    'SharesChanged',
    'StreamFault',
    'StreamUnwanted',
    'StreamViolated',
    'StreamWanted',
    'ValueKnown',
    'WatermarkArrived',
    'decode',
    'encode',
]
