"""Several hosts: their clocks, links, and what they share."""

from dyknow_federation.clocks import Offset, OwnTime, PairClock
from dyknow_federation.errors import FederationError, VersionError
from dyknow_federation.events import (
    ClockJumped,
    Event,
    LinkRestored,
    LinkStale,
    PeerFault,
    PeerJoined,
    PeerLeft,
    RemoteSample,
    SamplesArrived,
    SamplesLost,
    SharesChanged,
    StreamRefused,
    StreamUnwanted,
    StreamViolated,
    StreamWanted,
    WatermarkArrived,
)
from dyknow_federation.messages import (
    Packet,
    SharedFeature,
    SharedObject,
    Shares,
    StreamFault,
    decode,
    encode,
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
    'LinkRestored',
    'LinkStale',
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
    'RemoteSample',
    'SamplesArrived',
    'SamplesLost',
    'SharedFeature',
    'SharedObject',
    'Shares',
    'SharesChanged',
    'StreamFault',
    'StreamRefused',
    'StreamUnwanted',
    'StreamViolated',
    'StreamWanted',
    'VersionError',
    'WatermarkArrived',
    'decode',
    'encode',
]
