"""Packets say the same after encoding, and nothing else is taken for one."""

from __future__ import annotations

import json
import zlib
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_federation import FederationError, Packet, decode, encode
from dyknow_federation.messages import (
    COMMON,
    MAX_BATCH,
    MAX_ITEMS,
    MAX_PACKET,
    MAX_TEXT,
    VERSION,
    Hello,
    Message,
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
    ViolationNotice,
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
    Request('c', 2, 5, ((5, 6), (8, 8))),
    Release('c'),
    RequestRefusal('c', 'it is not shared'),
    Samples('c', 1, 7, (10, 20), (1.5, 'ü')),
    Samples('c', 1, 7, tuple(range(MAX_BATCH)), tuple([True] * MAX_BATCH)),
    ViolationNotice('c', 1, 8, StreamFault(5, 'max_gap', 'no sample')),
    Watermark('c', 1, 9, 1, -5),
    Probe(1, 2),
    ProbeReply(1, 2, 3, 4),
]


@pytest.mark.parametrize('message', EXAMPLES, ids=lambda each: type(each).__name__)
def test_round_trip(message: Message) -> None:
    packet = Packet('carrier1', 2**60, '', (message, Hello(1)))
    assert decode(encode(packet)) == packet


def changed(content: list[Any], sender: str) -> bytes:
    version, _, *others = content
    return json.dumps([version, sender, *others]).encode()


def with_message(kind: str, values: Any) -> bytes:
    return json.dumps([VERSION, 'a', 1, '', [kind, values]]).encode()


BAD = {
    'no JSON': (b'[', 'no JSON'),
    'not a list': (b'{}', 'no packet'),
    'deep': (b'[' * 100_000, 'no JSON'),
    'long integer': (b'[' + b'9' * 10_000 + b', 1]', 'no JSON'),
    'no text': (b'\xff\xfe\xfd', 'no JSON'),
    'bad compression': (b'zabc', 'decompressed'),
    'cut off': (b'z' + zlib.compress(b'[' + b' ' * 5000)[:10], 'cut off'),
    'a bomb': (b'z' + zlib.compress(b' ' * (MAX_PACKET + 1)), 'more than'),
    'large': (b' ' * (MAX_PACKET + 1), 'more than'),
    'no name': (changed(json.loads(encode(Packet('a', 1, '', (Hello(1),)))), ''), 'has no name'),
    'missing parts': (json.dumps([VERSION, 'a', 1]).encode(), '1 to 20'),
    'unknown message': (with_message('Peer', []), "message 'Peer'"),
    'too few values': (with_message('Hello', []), '1 values, not 0'),
    'a bool as int': (with_message('Hello', [True]), 'is no int'),
    'a long text': (
        with_message('Release', ['x' * (MAX_TEXT + 1)]),
        'characters',
    ),
    '65 bits': (with_message('Hello', [2**63]), '64 bits'),
    'a list as value': (
        with_message('Samples', ['c', 1, 1, [1], [[]]]),
        'is no list',
    ),
    'times that do not increase': (
        with_message('Samples', ['c', 1, 1, [2, 2], [0, 0]]),
        'do not increase',
    ),
    'a long reason': (
        with_message('ViolationNotice', ['c', 1, 1, [5, 'lost', 'x' * 1001]]),
        'cut it',
    ),
    'a long constraint': (
        with_message('ViolationNotice', ['c', 1, 1, [5, 'x' * 1001, '']]),
        'shorten it',
    ),
    'many items': (
        with_message('Shares', [1, [0] * (MAX_ITEMS + 1), []]),
        'no list of at most',
    ),
}


@pytest.mark.parametrize('name', BAD)
def test_bad_packets_are_refused(name: str) -> None:
    data, message = BAD[name]
    with pytest.raises(FederationError, match=message):
        decode(data)


def test_another_version_is_named() -> None:
    content = json.loads(encode(Packet('old', 1, '', (Hello(1),))))
    content[0] = VERSION + 1
    with pytest.raises(FederationError, match=f"'old' speaks version {VERSION + 1} .* this one 1"):
        decode(json.dumps([*content, 'more parts']).encode())


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=8,
)


@given(st.sampled_from(EXAMPLES), st.data())
def test_changed_packets_are_decoded_or_refused(message: Message, data: st.DataObject) -> None:
    encoded = encode(Packet('a', 1, '', (message,)))
    if encoded.startswith(b'z'):
        encoded = zlib.decompressobj(zdict=COMMON).decompress(encoded[1:])
    content = json.loads(encoded)
    target = content
    while isinstance(target, list) and target:
        index = data.draw(st.integers(0, len(target) - 1))
        if not isinstance(target[index], list) or data.draw(st.booleans()):
            target[index] = data.draw(JSON)
            break
        target = target[index]
    try:
        found = decode(json.dumps(content).encode())
    except FederationError:
        return
    assert decode(encode(found)) == found or 'nan' in str(found)


@given(st.binary(max_size=100))
def test_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(FederationError):
        decode(data)


def test_a_packet_that_is_too_large_is_not_sent() -> None:
    objects = tuple(SharedObject('x' * 1000, ('y' * 1000,)) for _ in range(1000))
    with pytest.raises(FederationError, match='share less'):
        encode(Packet('a', 1, '', (Shares(1, objects),)))
