"""Messages between peers, and their encoding.

A packet is encoded as JSON with the values of the fields of its messages in order, and compressed
unless it is short, with what all packets have in common as a dictionary:

    [1, "carrier1", 17…, "basestation", ["Hello", [3]]]

Nothing of a peer is trusted: `decode` checks the size before it reads, and the type, the length
and the range of every value. All times are in nanoseconds of the sender's clock.
"""

from __future__ import annotations

import json
import types
import zlib
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cache
from itertools import pairwise
from typing import Any, Final, Union, get_args, get_origin, get_type_hints

from dyknow_common import Value, check_name, shortened
from dyknow_federation.errors import FederationError

VERSION: Final = 1
"""The version of the protocol; peers of different versions refuse each other, and say so."""

MAX_PACKET: Final = 1024 * 1024
"""The number of bytes of a packet, before and after compression."""

MAX_TEXT: Final = 10_000
"""The length of a text in a message, as of a value."""

MAX_ITEMS: Final = 10_000
"""The number of items of a list in a message."""

MAX_BATCH: Final = 500
"""The number of samples of a batch."""

MAX_MESSAGES: Final = 20
"""The number of messages of a packet."""

MAX_REASON: Final = 1_000
"""The length of the description of a violation; longer ones are cut."""

MAX_RANGES: Final = 20
"""The number of ranges of missing samples that a request names; later requests name others."""

_HEADER: Final = 4
"""The number of values of a packet before its messages."""

_MAX_INTEGER: Final = 2**63
_COMPRESSED: Final = b'z'
_COMPRESSES: Final = 64
"""The number of bytes from which a packet is compressed."""

COMMON: Final = (
    b'"SharesRequest",["Shares",["RequestRefusal",["Request",["Release",["ProbeReply",["Probe",['
    b'"Hello",[false,true],"Watermark",["Samples",[],[[0.'
)
"""What packets have in common: with it, one of a sample has three quarters of its length."""


@dataclass(frozen=True, slots=True)
class Hello:
    """A sign of life of a peer, sent to all.

    Args:
        shares_version: the version of its shares; a peer that has another one asks for them.
    """

    shares_version: int


@dataclass(frozen=True, slots=True)
class SharesRequest:
    """A request for the shares of a peer."""


@dataclass(frozen=True, slots=True)
class SharedObject:
    """An object that a peer knows.

    Args:
        name: its name at that peer.
        sorts: the sorts that it belongs to.
    """

    name: str
    sorts: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class SharedFeature:
    """A feature that a peer lets others ask for.

    Args:
        name: the feature in the ontology.
        objects: that it is about.
        stream: the stream that carries it; requests name it.
        value_type: of its values, in the stream language.
        unit: of its values; empty for none.
    """

    name: str
    objects: tuple[str, ...]
    stream: str
    value_type: str
    unit: str = ''


@dataclass(frozen=True, slots=True)
class Shares:
    """All that a peer shares.

    Args:
        version: increases with each change.
        objects: the objects that it knows.
        features: what others may ask for.
    """

    version: int
    objects: tuple[SharedObject, ...] = ()
    features: tuple[SharedFeature, ...] = ()


@dataclass(frozen=True, slots=True)
class Request:
    """A request for a stream: it subscribes, acknowledges, and asks for what is missing.

    It is repeated while the stream is needed; a peer ends subscriptions that are not repeated.

    Args:
        stream: the name of the stream.
        epoch: the epoch of the numbers below; 0 if no sample has been received yet.
        number: all samples before this number have been received, or are lost.
        missing: the first and the last number of each range that is missing after it.
    """

    stream: str
    epoch: int = 0
    number: int = 0
    missing: tuple[tuple[int, int], ...] = ()

    def __post_init__(self) -> None:
        if len(self.missing) > MAX_RANGES:
            raise FederationError(f'{len(self.missing)} ranges are missing; name {MAX_RANGES}')


@dataclass(frozen=True, slots=True)
class Release:
    """The end of a request."""

    stream: str


@dataclass(frozen=True, slots=True)
class RequestRefusal:
    """The answer to a request that is not granted.

    Args:
        stream: the name of the stream.
        reason: why, with the remedy.
    """

    stream: str
    reason: str


@dataclass(frozen=True, slots=True)
class Samples:
    """Samples of a stream with consecutive numbers.

    Args:
        stream: the name of the stream.
        epoch: numbers of different epochs have nothing to do with each other.
        first: the number of the first sample.
        valid_times: of each sample, strictly increasing, in the clock of the sender.
        values: of each sample.
    """

    stream: str
    epoch: int
    first: int
    valid_times: tuple[int, ...]
    values: tuple[Value, ...]

    def __post_init__(self) -> None:
        count = len(self.valid_times)
        if not 0 < count <= MAX_BATCH:
            raise FederationError(f'a batch has {count} samples; send 1 to {MAX_BATCH}')
        if len(self.values) != count:
            raise FederationError(f'a batch has {count} samples, but {len(self.values)} values')
        if any(later <= former for former, later in pairwise(self.valid_times)):
            raise FederationError('the valid times of a batch do not increase')
        _check_numbers(self.epoch, self.first)


@dataclass(frozen=True, slots=True)
class StreamFault:
    """A violation of a stream, as its host has noticed it.

    Args:
        valid_time: from which on samples are in doubt.
        constraint: its kind, such as `max_gap`.
        reason: the description for users.
    """

    valid_time: int
    constraint: str
    reason: str

    def __post_init__(self) -> None:
        check_name(self.constraint, FederationError)
        if len(self.reason) > MAX_REASON:
            raise FederationError(f'a reason has {len(self.reason)} characters; cut it')


@dataclass(frozen=True, slots=True)
class ViolationNotice:
    """A violation of a stream. It has a number as samples have, and arrives as they do.

    Args:
        stream: the name of the stream.
        epoch: of the number.
        number: its own; the next sample has the next one.
        fault: what has happened, in the clock of the sender.
    """

    stream: str
    epoch: int
    number: int
    fault: StreamFault

    def __post_init__(self) -> None:
        _check_numbers(self.epoch, self.number)


@dataclass(frozen=True, slots=True)
class Watermark:
    """A promise: all samples from a number on are valid later than a time.

    Args:
        stream: the name of the stream.
        epoch: of the numbers.
        number: of the next sample.
        oldest: the least number that can still be asked for; earlier ones are lost.
        time: later samples are valid after it, in the clock of the sender.
    """

    stream: str
    epoch: int
    number: int
    oldest: int
    time: int

    def __post_init__(self) -> None:
        _check_numbers(self.epoch, self.number)


@dataclass(frozen=True, slots=True)
class Probe:
    """The first half of an exchange that measures a clock.

    Args:
        number: repeated by the reply.
        sent_at: when the probe was sent.
    """

    number: int
    sent_at: int


@dataclass(frozen=True, slots=True)
class ProbeReply:
    """The second half of an exchange that measures a clock.

    Args:
        number: of the probe.
        probe_sent_at: as in the probe, in the clock of its sender.
        received_at: when the probe was received.
        sent_at: when the reply was sent.
    """

    number: int
    probe_sent_at: int
    received_at: int
    sent_at: int


StreamMessage = Samples | ViolationNotice | Watermark
"""A message that answers a request."""

Message = (
    Hello
    | SharesRequest
    | Shares
    | Request
    | Release
    | RequestRefusal
    | StreamMessage
    | Probe
    | ProbeReply
)
"""A message between peers."""

_KINDS: Final[dict[str, type]] = {each.__name__: each for each in get_args(Message)}


@dataclass(frozen=True, slots=True)
class Packet:
    """Messages with their sender.

    Args:
        sender: the name of the peer that sent it.
        incarnation: the number of its run, unique among all its runs.
        receiver: the name of the peer that it is for; empty for all.
        messages: the messages, in order.
    """

    sender: str
    incarnation: int
    receiver: str
    messages: tuple[Message, ...]


def encode(packet: Packet) -> bytes:
    """Return the bytes of a packet.

    Raises:
        FederationError: if it is too large.
    """
    content = [VERSION, packet.sender, packet.incarnation, packet.receiver]
    content += [[type(each).__name__, _values(each)] for each in packet.messages]
    data = json.dumps(content, separators=(',', ':')).encode()
    if len(data) > MAX_PACKET:
        raise FederationError(
            f'{type(packet.messages[0]).__name__} has {len(data)} bytes, more than {MAX_PACKET}; '
            'share less'
        )
    if len(data) < _COMPRESSES:
        return data
    compressor = zlib.compressobj(zdict=COMMON)
    return _COMPRESSED + compressor.compress(data) + compressor.flush()


def decode(data: bytes) -> Packet:
    """Return the packet that another peer has encoded.

    Raises:
        FederationError: for another version of the protocol, or what is not as it must be.
    """
    try:
        content = json.loads(_plain(data))
    except (ValueError, RecursionError) as error:
        raise FederationError(f'it is no JSON: {error}') from None
    if not (isinstance(content, list) and len(content) >= 2):  # noqa: PLR2004
        raise FederationError('it is no packet')
    version, sender = _checked(int, content[0]), _checked(str, content[1])
    if version != VERSION:
        raise FederationError(
            f"peer '{sender}' speaks version {version} of the protocol, this one {VERSION}; "
            'install the same version of DyKnow on both',
        )
    if not _HEADER < len(content) <= _HEADER + MAX_MESSAGES:
        raise FederationError(f'it has {len(content) - _HEADER} messages; send 1 to {MAX_MESSAGES}')
    if not sender:
        raise FederationError('its sender has no name')
    incarnation, receiver = _checked(int, content[2]), _checked(str, content[3])
    return Packet(sender, incarnation, receiver, tuple(map(_message, content[_HEADER:])))


def _message(content: Any) -> Message:
    if not isinstance(content, list) or len(content) != 2:  # noqa: PLR2004
        raise FederationError(f"'{shortened(content)}' is no message")
    kind, values = content
    if not isinstance(kind, str) or kind not in _KINDS:
        raise FederationError(f"unknown message '{shortened(kind)}'")
    found: Message = _checked(_KINDS[kind], values)
    return found


def _plain(data: bytes) -> bytes:
    if len(data) > MAX_PACKET:
        raise FederationError(f'it has {len(data)} bytes, more than {MAX_PACKET}')
    if not data.startswith(_COMPRESSED):
        return data
    decompressor = zlib.decompressobj(zdict=COMMON)
    try:
        plain = decompressor.decompress(data[1:], MAX_PACKET)
    except zlib.error as error:
        raise FederationError(f'it cannot be decompressed: {error}') from None
    if not decompressor.eof:
        raise FederationError(f'it is cut off, or has more than {MAX_PACKET} bytes')
    return plain


def _check_numbers(epoch: int, number: int) -> None:
    if epoch < 1 or number < 1:
        raise FederationError(f'epoch {epoch}, number {number}: both count from 1')


def _values(value: Any) -> Any:
    """Return a value as JSON can tell it: dataclasses as the list of their values."""
    if isinstance(value, tuple):
        return [_values(each) for each in value]
    if hasattr(value, '__dataclass_fields__'):
        return [_values(getattr(value, name)) for name in _hints(type(value))]
    return value


def _typed_fields(kind: Any) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {each.name: hints[each.name] for each in fields(kind)}


_hints: Final[Callable[[Any], dict[str, Any]]] = cache(_typed_fields)
"""The types of the fields of a dataclass, in order."""


def _checked(kind: Any, value: Any) -> Any:
    """Return a value of JSON as a value of a type.

    Raises:
        FederationError: if it is none.
    """
    if kind in {int, str, bool, float}:
        return _scalar(kind, value)
    if get_origin(kind) in {Union, types.UnionType}:
        return _scalar(type(value), value)
    if not isinstance(value, list) or len(value) > MAX_ITEMS:
        raise FederationError(f"'{shortened(value)}' is no list of at most {MAX_ITEMS} items")
    if get_origin(kind) is tuple:
        items = get_args(kind)
        if items[-1] is Ellipsis:
            return tuple([_checked(items[0], each) for each in value])
        _check_count(kind, value, len(items))
        return tuple(_checked(item, each) for item, each in zip(items, value, strict=True))
    hints = _hints(kind)
    _check_count(kind, value, len(hints))
    return kind(*(_checked(hint, each) for hint, each in zip(hints.values(), value, strict=True)))


def _check_count(kind: Any, value: list[Any], count: int) -> None:
    if len(value) != count:
        name = getattr(kind, '__name__', 'tuple')
        raise FederationError(f'a {name} has {count} values, not {len(value)}')


def _scalar(kind: Any, value: Any) -> Any:
    if kind not in {int, str, bool, float} or type(value) is not kind:
        raise FederationError(f"'{shortened(value)}' is no {kind.__name__}")
    if kind is int and not -_MAX_INTEGER <= value < _MAX_INTEGER:
        raise FederationError('an integer has more than 64 bits')
    if kind is str and len(value) > MAX_TEXT:
        raise FederationError(f'a text has {len(value)} characters, more than {MAX_TEXT}')
    return value
