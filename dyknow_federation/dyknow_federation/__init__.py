"""Several hosts: their clocks, links, and what they share."""

from dyknow_federation.clocks import Offset, OwnTime, PairClock
from dyknow_federation.errors import FederationError, VersionError
from dyknow_federation.events import (
    AnswerArrived,
    ClockJumped,
    Event,
    LinkRestored,
    LinkStale,
    PeerFault,
    PeerJoined,
    PeerLeft,
    QuestionAsked,
    RemoteSample,
    SamplesArrived,
    SamplesLost,
    SharesChanged,
    StreamRefused,
    StreamUnwanted,
    StreamWanted,
    WatermarkArrived,
)
from dyknow_federation.messages import (
    Answer,
    Packet,
    Question,
    SharedFeature,
    SharedObject,
    Shares,
    decode,
    encode,
)
from dyknow_federation.peer import Effects, Peer
from dyknow_federation.remote import RemotePeer
from dyknow_federation.sending import StreamKey
from dyknow_federation.settings import PeerSettings

__all__ = [
    'Answer',
    'AnswerArrived',
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
    'Question',
    'QuestionAsked',
    'RemotePeer',
    'RemoteSample',
    'SamplesArrived',
    'SamplesLost',
    'SharedFeature',
    'SharedObject',
    'Shares',
    'SharesChanged',
    'StreamKey',
    'StreamRefused',
    'StreamUnwanted',
    'StreamWanted',
    'VersionError',
    'WatermarkArrived',
    'decode',
    'encode',
]
