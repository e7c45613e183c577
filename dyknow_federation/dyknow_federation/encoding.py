"""The bytes of packets: the values of the fields of messages in order, as their types say.

    packet     the version, and if the rest is compressed; the number of the run; messages; CRC-32
    message    its kind, its fields
    int        7 bits a byte, the least ones first (LEB128); the sign is the last bit (zigzag)
    Time       the difference to the time before it in the packet, as an int
    float      IEEE 754, 8 bytes
    str        its length, then UTF-8
    tuple      its length, then its items
    Content    its type, then the value

Neither names of fields nor types are told, so a packet of one sample has about 35 bytes. Nothing of
a peer is trusted: `decode` checks the size before it reads, and each length and range.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from typing import Any, Final, get_args, get_origin, get_type_hints

from dyknow_common import Value
from dyknow_federation.errors import FederationError
from dyknow_federation.messages import Content, Message, Packet, Time

VERSION: Final = 7
"""The version of the protocol; peers of different versions refuse each other, and say so."""

MAX_PACKET: Final = 1024 * 1024
"""The number of bytes of a packet, before and after compression."""

MAX_MESSAGES: Final = 20
"""The number of messages of a packet."""

MAX_LENGTH: Final = 10_000
"""The number of bytes of a text in a message, and of the items of a list."""

_CHECKSUM: Final = 4
"""The number of bytes of the checksum, without which an altered value would be believed."""

_COMPRESSED: Final = 0x80
_COMPRESSES: Final = 256
"""The number of bytes from which a packet is compressed."""

_MORE: Final = 0x80
"""This bit in a byte of an integer says that more bytes follow."""

_MAX_INTEGER: Final = 2**63
_LONGEST: Final = 70
"""The bits of 10 bytes, which hold each integer."""

_MESSAGES: Final[tuple[Any, ...]] = get_args(Message)
_CONTENTS: Final = get_args(Content)
_DOUBLE: Final = struct.Struct('<d')

_hints = cache(partial(get_type_hints, include_extras=True))
"""Returns the types of the fields of a dataclass, by their names, in order."""


def encode_all(packet: Packet) -> Iterator[bytes]:
    """Yield the bytes of a packet; split it into several packets if its messages need more room.

    Raises:
        FederationError: if one of its messages is too large.
    """
    try:
        yield encode(packet)
    except FederationError:
        half = len(packet.messages) // 2
        if not half:
            raise
        for each in (packet.messages[:half], packet.messages[half:]):
            yield from encode_all(replace(packet, messages=each))


def encode(packet: Packet) -> bytes:
    """Return the bytes of a packet.

    Raises:
        FederationError: if it is too large.
    """
    writer = _Writer()
    writer.write(int, packet.incarnation)
    for each in packet.messages:
        writer.data.append(_MESSAGES.index(type(each)))
        writer.write(type(each), each)
    plain = bytes(writer.data)
    if len(plain) >= MAX_PACKET - _CHECKSUM:
        raise FederationError(
            f'{type(packet.messages[0]).__name__} has {len(plain)} bytes, more than {MAX_PACKET}; '
            'share less'
        )
    if len(plain) >= _COMPRESSES and len(found := zlib.compress(plain)) < len(plain):
        return with_checksum(bytes([VERSION | _COMPRESSED]) + found)
    return with_checksum(bytes([VERSION]) + plain)


def check_value(value: Value) -> None:
    """Check that peers take a value.

    Raises:
        FederationError: if it is a text or an integer that is too long.
    """
    if isinstance(value, str) and (length := len(value.encode(errors='replace'))) > MAX_LENGTH:
        raise FederationError(f'it has {length:,} bytes; peers get at most {MAX_LENGTH:,}')
    if isinstance(value, int):
        _checked(value)


def with_checksum(data: bytes) -> bytes:
    """Return the bytes of a packet with the checksum at the end, which tells if it is altered."""
    return data + zlib.crc32(data).to_bytes(_CHECKSUM)


def decode(data: bytes) -> Packet:
    """Return the packet that another peer has encoded.

    Raises:
        FederationError: for another version of the protocol, or what is not as it must be.
    """
    if not 0 < len(data) <= MAX_PACKET:
        raise FederationError(f'it has {len(data)} bytes; send 1 to {MAX_PACKET}')
    if (version := data[0] & ~_COMPRESSED) != VERSION:
        raise FederationError(
            f'it is of version {version} of the protocol, not {VERSION}; install the same version '
            'of DyKnow on both'
        )
    content = data[1:-_CHECKSUM]
    if data != with_checksum(data[:-_CHECKSUM]):
        raise FederationError('its checksum is wrong: it was altered or cut off')
    reader = _Reader(_decompressed(content) if data[0] & _COMPRESSED else content)
    incarnation, messages = reader.read(int), list[Message]()
    while not reader.is_at_end and len(messages) <= MAX_MESSAGES:
        messages.append(reader.read(_MESSAGES[reader.below(len(_MESSAGES))]))
    if not 0 < len(messages) <= MAX_MESSAGES:
        raise FederationError(f'it has {len(messages)} messages; send 1 to {MAX_MESSAGES}')
    return Packet(incarnation, tuple(messages))


def _decompressed(data: bytes) -> bytes:
    decompressor = zlib.decompressobj()
    try:
        plain = decompressor.decompress(data, MAX_PACKET)
    except zlib.error as error:
        raise FederationError(f'it cannot be decompressed: {error}') from None
    if not decompressor.eof:
        raise FederationError(f'it is cut off, or has more than {MAX_PACKET} bytes')
    return plain


class _Writer:
    """The bytes of a packet while it is encoded."""

    def __init__(self) -> None:
        self.data = bytearray()
        self._latest = 0

    def write(self, kind: Any, value: Any) -> None:
        """Write a value of a type."""
        if kind is Time:
            self._integer(value - self._latest)
            self._latest = value
        elif kind is int:
            self._integer(value)
        elif kind is bool:
            self.data.append(value)
        elif kind is float:
            self.data += _DOUBLE.pack(value)
        elif kind is str:
            text = value.encode(errors='replace')
            self._integer(len(text))
            self.data += text
        elif kind is Content:
            self.data.append(_CONTENTS.index(type(value)))
            self.write(type(value), value)
        else:
            self._items(kind, value)

    def _items(self, kind: Any, value: Any) -> None:
        if get_origin(kind) is not tuple:
            items = [(each, getattr(value, name)) for name, each in _hints(kind).items()]
        elif (kinds := get_args(kind))[-1] is Ellipsis:
            self._integer(len(value))
            items = [(kinds[0], each) for each in value]
        else:
            items = [*zip(kinds, value, strict=True)]
        for each in items:
            self.write(*each)

    def _integer(self, value: int) -> None:
        left = 2 * value if value >= 0 else -2 * value - 1
        while left >= _MORE:
            self.data.append(left % _MORE + _MORE)
            left //= _MORE
        self.data.append(left)


class _Reader:
    """The bytes of a packet while it is decoded.

    Args:
        data: the bytes.
    """

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = self._latest = 0
        self._scalars: dict[Any, Callable[[], Any]] = {
            Time: self._time,
            int: lambda: _checked(self._integer()),
            bool: lambda: bool(self.below(2)),
            float: lambda: _DOUBLE.unpack(self.take(_DOUBLE.size))[0],
            str: self._text,
            Content: lambda: self.read(_CONTENTS[self.below(len(_CONTENTS))]),
        }

    @property
    def is_at_end(self) -> bool:
        """True if nothing is left."""
        return self._at == len(self._data)

    def take(self, count: int) -> bytes:
        """Return the next bytes."""
        start, self._at = self._at, self._at + count
        if not start <= self._at <= len(self._data):
            raise FederationError('it is cut off')
        return self._data[start : self._at]

    def read(self, kind: Any) -> Any:
        """Return a value of a type.

        Raises:
            FederationError: if there is none.
        """
        if kind in self._scalars:
            return self._scalars[kind]()
        if get_origin(kind) is not tuple:
            return kind(*[self.read(each) for each in _hints(kind).values()])
        kinds = get_args(kind)
        if kinds[-1] is Ellipsis:
            kinds = (kinds[0],) * self._length()
        return tuple([self.read(each) for each in kinds])

    def below(self, end: int) -> int:
        """Return the next byte, which counts something from 0."""
        if (found := self.take(1)[0]) >= end:
            raise FederationError(f'{found} is not less than {end}')
        return found

    def _time(self) -> int:
        self._latest = _checked(self._latest + self._integer())
        return self._latest

    def _integer(self) -> int:
        found = 0
        for shift in range(0, _LONGEST, 7):
            byte = self.take(1)[0]
            found |= byte % _MORE << shift
            if byte < _MORE:
                return -(found // 2) - 1 if found % 2 else found // 2
        raise FederationError('an integer has more than 10 bytes')

    def _text(self) -> str:
        try:
            return self.take(self._length()).decode()
        except UnicodeDecodeError as error:
            raise FederationError(f'a text is no UTF-8: {error}') from None

    def _length(self) -> int:
        if not 0 <= (found := self._integer()) <= MAX_LENGTH:
            raise FederationError(f'it has a length of {found}, not of at most {MAX_LENGTH}')
        return found


def _checked(value: int) -> int:
    if not -_MAX_INTEGER <= value < _MAX_INTEGER:
        raise FederationError('an integer has more than 64 bits')
    return value
