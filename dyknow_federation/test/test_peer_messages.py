"""Packets say the same after encoding, and nothing else is taken for one."""

from __future__ import annotations

import contextlib
import math
import zlib
from dataclasses import replace
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_federation.encoding import (
    MAX_LENGTH,
    MAX_MESSAGES,
    MAX_PACKET,
    VERSION,
    decode,
    encode,
    encode_all,
    with_checksum,
)
from dyknow_federation.errors import FederationError
from dyknow_federation.messages import (
    MAX_BATCH,
    Grant,
    Hello,
    Message,
    Packet,
    Probe,
    ProbeReply,
    Release,
    Request,
    RequestRefusal,
    Samples,
    SharedFeature,
    SharedObject,
    Shares,
    SharesRequest,
    StreamFault,
    Watermark,
)

EXAMPLES: list[Message] = [
    Hello(3),
    SharesRequest(),
    Shares(
        2,
        (SharedObject('r1', ('Robot', 'Carrier')),),
        (SharedFeature('Charge', ('r1',), 'c', 'float', 'V'),),
    ),
    Request('c', 2, 5, ((5, 6), (8, 8)), (-0.5, 2.0)),
    Release('c'),
    RequestRefusal('c', 'it is not shared'),
    Grant('d', 7, (1.5,)),
    Grant('c', 2),
    Samples(1, 7, (10, 20), (1.5, 'ü')),
    Samples(1, 7, (10, 2**62), (0.1, -math.inf)),
    Samples(1, 7, (10, 20, 30), (False, -(2**63), 1e300)),
    Samples(1, 7, tuple(range(MAX_BATCH)), tuple([True] * MAX_BATCH)),
    Samples(1, 8, (5, 5, 6), (1, StreamFault(4, 'max_gap', 'no sample'), 2)),
    Watermark(1, 9, 1, -5),
    Probe(2),
    ProbeReply(2, 3, 4),
]


KINDS = {kind: number for number, kind in enumerate(get_args(Message))}


@pytest.mark.parametrize('message', EXAMPLES, ids=lambda each: type(each).__name__)
def test_round_trip(message: Message) -> None:
    packet = Packet(2**60, (message, Hello(1)))
    assert decode(encode(packet)) == packet


def test_a_value_that_is_no_number_crosses() -> None:
    (message,) = decode(encode(Packet(1, (Samples(1, 1, (1,), (math.nan,)),)))).messages
    assert isinstance(message, Samples)
    (value,) = message.contents
    assert isinstance(value, float)
    assert math.isnan(value)


def test_what_crosses_often_is_short() -> None:
    now = 1_700_000_000_123_456_789
    x, y = (Samples(each, 1000, (now,), (0.1 + each,)) for each in (1, 2))
    assert len(encode(Packet(now, (x, y, Watermark(3, 50, 1, now))))) <= 60


def packet(content: bytes) -> bytes:
    return with_checksum(bytes([VERSION, 2]) + content)


def compressed(content: bytes) -> bytes:
    return with_checksum(bytes([VERSION | 0x80]) + content)


LONG = b'\xff' * 9 + b'\x02'
"""An integer of more than 64 bits."""


def of(kind: type, content: bytes) -> bytes:
    return packet(bytes([KINDS[kind]]) + content)


BAD = {
    'nothing': (b'', '0 bytes'),
    'no run': (with_checksum(bytes([VERSION])), 'cut off'),
    'no message': (packet(b''), '0 messages'),
    'many messages': (
        encode(Packet(1, (Hello(1),) * (MAX_MESSAGES + 1))),
        f'{MAX_MESSAGES + 1} messages',
    ),
    'bad compression': (compressed(b'abc'), 'decompressed'),
    'compression that is cut off': (compressed(zlib.compress(b' ' * 5000)[:10]), 'cut off'),
    'a bomb': (compressed(zlib.compress(b' ' * (MAX_PACKET + 1))), 'more than'),
    'large': (bytes([VERSION]) * (MAX_PACKET + 1), f'send 1 to {MAX_PACKET}'),
    'unknown message': (packet(b'\xff'), '255 is not less than'),
    'a packet that is cut off': (encode(Packet(1, (Hello(300),)))[:-1], 'checksum is wrong'),
    'a message that is cut off': (of(Hello, b'\xff'), 'cut off'),
    'a long text': (encode(Packet(1, (Release('x' * (MAX_LENGTH + 1)),))), 'a length of 10001'),
    'a text of negative length': (of(Release, b'\x01'), 'a length of -1'),
    'a text that is none': (of(Release, b'\x02\xff'), 'no UTF-8'),
    '65 bits': (of(Hello, LONG), '64 bits'),
    'an endless integer': (of(Hello, b'\xff' * 20), 'more than 10 bytes'),
    'a time of 65 bits': (
        of(ProbeReply, b'\xfe' + b'\xff' * 8 + b'\x01' + b'\x02'),
        '64 bits',
    ),
    'times that do not increase': (
        of(Samples, b'\x02\x02' + b'\x04\x02\x00' + b'\x04\x00\x01\x00\x01'),
        'do not increase',
    ),
    'many items': (of(Samples, b'\x02\x02' + b'\xff\xff\x03'), f'at most {MAX_LENGTH}'),
    'an unknown type of value': (of(Samples, b'\x02\x02\x02\x02\x02\x09'), '9 is not less'),
    'an epoch of 0': (of(Samples, b'\x00\x02\x02\x02\x02\x00\x01'), 'count from 1'),
}


@pytest.mark.parametrize('name', BAD)
def test_bad_packets_are_refused(name: str) -> None:
    data, message = BAD[name]
    with pytest.raises(FederationError, match=message):
        decode(data)


def test_bad_messages_are_not_made() -> None:
    with pytest.raises(FederationError, match='do not increase'):
        Samples(1, 1, (2, 2), (0, 0))
    with pytest.raises(FederationError, match='2 samples, but 1 values'):
        Samples(1, 1, (2, 3), (0,))
    with pytest.raises(FederationError, match='a deadband of nan'):
        SharedFeature('X', (), 'X', 'float', '', math.nan)
    for constants in ((1, 1), (math.nan,), (2**53,), tuple(range(21))):
        with pytest.raises(FederationError, match='at most 20 ascending numbers'):
            Request('level', constants=constants)
    with pytest.raises(FederationError, match='cut it'):
        StreamFault(5, 'lost', 'x' * 1001)
    with pytest.raises(FederationError, match='shorten it'):
        StreamFault(5, 'x' * 1001, '')


def test_another_version_is_named() -> None:
    data = bytes([VERSION + 1]) + b'whatever it may be'
    with pytest.raises(FederationError, match=f'version {VERSION + 1} .*, not {VERSION}; install'):
        decode(data)


@given(st.sampled_from(EXAMPLES), st.data())
def test_changed_packets_are_decoded_or_refused(message: Message, data: st.DataObject) -> None:
    encoded = bytearray(encode(Packet(1, (message,)))[:-4])
    for _ in range(data.draw(st.integers(1, 3))):
        index = data.draw(st.integers(0, len(encoded) - 1))
        length = data.draw(st.integers(0, 2))
        encoded[index : index + length] = data.draw(st.binary(max_size=3))
    try:
        found = decode(with_checksum(bytes(encoded)))
    except FederationError:
        return
    assert decode(encode(found)) == found or 'nan' in str(found)


@given(st.binary(max_size=100))
def test_bytes_are_decoded_or_refused(data: bytes) -> None:
    with contextlib.suppress(FederationError):
        decode(with_checksum(bytes([VERSION]) + data))


def test_what_is_too_large_for_one_packet_is_sent_in_several() -> None:
    """Else a peer would ask for it again for ever."""
    texts = tuple('ü' * (MAX_LENGTH // 2) for _ in range(MAX_BATCH))
    batch = Samples(1, 7, tuple(range(MAX_BATCH)), texts)
    messages = (Hello(1), batch, Watermark(1, 900, 1, 5), replace(batch, epoch=2))
    with pytest.raises(FederationError, match='share less'):
        encode(Packet(3, (batch, batch)))
    packets = [decode(each) for each in encode_all(Packet(3, messages))]
    assert sum((each.messages for each in packets), ()) == messages
    assert {each.incarnation for each in packets} == {3}
    assert [*encode_all(Packet(1, (Hello(1),)))] == [encode(Packet(1, (Hello(1),)))]
    objects = tuple(SharedObject('x' * 1000, ('y' * 1000,)) for _ in range(1000))
    with pytest.raises(FederationError, match='share less'):
        [*encode_all(Packet(1, (Shares(1, objects),)))]
