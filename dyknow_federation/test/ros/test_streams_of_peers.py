"""What peers are told of an own stream, and what readers here of one of a peer."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from dyknow_common import SECOND_NS
from dyknow_configuration import RequestedFederation
from dyknow_federation.encoding import encode
from dyknow_federation.messages import Packet, Request, Samples, SharedFeature, StreamFault
from dyknow_federation.peer import Peer
from dyknow_federation.ros.own_streams import OwnStream, OwnStreams
from dyknow_federation.ros.remote_streams import RemoteStream
from dyknow_stream_processing import Sample
from dyknow_stream_processing.ros import SampleWriter

NOW = 100 * SECOND_NS


def test_a_sample_that_contradicts_a_promise_is_told_as_lost() -> None:
    """Else peers would take the value before it for the present one."""
    peer = Peer(RequestedFederation('a'), 1)
    peer.share([], [SharedFeature('Level', (), 'level', 'float')], NOW)
    peer.receive(encode(Packet(7, (Request('level'),))), NOW, 'b')
    streams: Any = SimpleNamespace(
        peer=peer, node=SimpleNamespace(now=lambda: NOW), changed=lambda: None
    )
    streams.violate = lambda *given: OwnStreams.violate(streams, *given)
    listener, writer = OwnStream(streams, 'level'), SampleWriter()
    for valid_time, value in ((5, 1.0), (4, 2.0), (6, 3.0)):
        sample = writer.write(Sample(valid_time, NOW, {'value': value}))
        listener.on_message(sample, NOW, 0, is_initial=False)
    sent = [each for _, packet in peer.advance(NOW + SECOND_NS).packets for each in packet.messages]
    (batch,) = (each for each in sent if isinstance(each, Samples))
    first, lost, last = batch.contents
    assert (first, last) == (1.0, 3.0)
    assert isinstance(lost, StreamFault)
    assert (lost.constraint, lost.valid_time) == ('lost', 4)
    assert 'as was promised' in lost.reason


def test_watermarks_go_on_when_the_own_clock_is_set_back() -> None:
    """A value that does not change has nothing else by which states become certain."""
    clock, sent = [NOW], list[int]()
    node: Any = SimpleNamespace(now=lambda: clock[0], create_publisher=lambda *_: object())
    watermarks = SimpleNamespace(
        publish=lambda message: sent.extend(each.watermark.sec for each in message.streams)
    )
    stream = RemoteStream(node, '/dyknow/federation/a/level', watermarks)
    for second in (98, 99, 99, 97):
        stream.promise(second * SECOND_NS)
    assert sent == [98, 99]
    clock[0] = 50 * SECOND_NS
    for second in (49, 48, 50):
        stream.promise(second * SECOND_NS)
    assert sent == [98, 99, 49, 50]
