"""The streams of peers, as topics of this host.

The samples of the stream `Charge_carrier1` of the peer `carrier1` are published on
`dyknow/federation/carrier1/Charge_carrier1`, as an engine publishes the samples of its streams.
Watermarks tell readers which samples may still come, and violations tell which never will. Where
the clocks leave the order of samples open, a value has alternatives. While nobody subscribes, the
peer is not asked.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

from dyknow_interfaces.msg import ConstraintViolation, StreamWatermark, StreamWatermarks
from dyknow_interfaces.msg import Sample as SampleMessage

from dyknow_common import SECOND_NS, Value
from dyknow_common.ros import STREAM, VIOLATIONS, DyKnowNode, nanoseconds_to_time
from dyknow_federation.offers import VALUE
from dyknow_stream_processing import PEER_STREAMS, Sample
from dyknow_stream_processing.ros import (
    WATERMARKS,
    SampleWriter,
    violations_topic,
    watermarks_topic,
)

VERDICT_TIMEOUT_NS: Final = 30 * SECOND_NS
"""How long the verdict of a formula is published before somebody reads it."""


class RemoteStream:
    """A stream of a peer, which the node publishes.

    Args:
        node: the node.
        topic: the absolute topic.
        watermarks: the publisher of the watermarks of all streams of the peer.
    """

    def __init__(self, node: DyKnowNode, topic: str, watermarks: Any) -> None:
        self.told = 0
        """The time until which its values are published."""
        self._node = node
        self.topic = topic
        self._writer = SampleWriter()
        self._latest = 0
        self._publisher = node.create_publisher(SampleMessage, topic, STREAM)
        self._violations = node.create_publisher(
            ConstraintViolation, violations_topic(topic), VIOLATIONS
        )
        self._watermarks = watermarks

    @property
    def is_wanted(self) -> bool:
        """True while somebody subscribes."""
        return bool(self._publisher.get_subscription_count())

    def publish(self, time: int, value: Value) -> None:
        """Publish the value since a time."""
        sample = Sample(time, self._node.now(), {VALUE: value}, time)
        self._publisher.publish(self._writer.write(sample))
        self._latest, self.told = time, max(time, self.told)

    def promise(self, time: int) -> None:
        """Publish that later values hold after a time, unless that is known."""
        if time <= self.told <= self._node.now():  # Else the own clock was set back.
            return
        self.told = time
        message = StreamWatermark(
            stream_name=self.topic.rpartition('/')[2],
            stream_id=self._writer.stream_id,
            number=self._writer.number,
            watermark=nanoseconds_to_time(time),
        )
        self._watermarks.publish(StreamWatermarks(streams=[message]))

    def violate(self, kind: str, reason: str, valid_time: int | None = None) -> None:
        """Report that samples are in doubt from a valid time on; None: from the latest one on."""
        now = self._node.now()
        self._writer.note_violation(now)
        valid_time = self._latest if valid_time is None else valid_time
        self._violations.publish(
            ConstraintViolation(
                stream_name=self.topic,
                constraint=str(kind),
                valid_time=nanoseconds_to_time(max(valid_time, 0)),
                available_time=nanoseconds_to_time(now),
                message=f"stream '{self.topic}': {reason}",
            )
        )

    def destroy(self) -> None:
        """Destroy the publishers."""
        self._node.destroy_publisher(self._publisher)
        self._node.destroy_publisher(self._violations)


class StreamName(NamedTuple):
    """A stream of a peer."""

    peer: str
    stream: str


class RemoteStreams:
    """The streams of all peers, which a node publishes."""

    def __init__(self, node: DyKnowNode) -> None:
        self.node = node
        self._streams: dict[StreamName, RemoteStream] = {}
        self._verdicts: dict[StreamName, int] = {}
        """When the streams of verdicts were added; they are kept until nobody reads them."""
        self._watermarks: dict[str, Any] = {}
        self._wanted: set[StreamName] = set()

    def topic(self, peer: str, stream: str) -> str:
        """Return the absolute topic of a stream."""
        return str(self.node.resolve_topic_name(f'{PEER_STREAMS}/{peer}/{stream}'))

    def keep(self, names: set[StreamName]) -> None:
        """Publish these streams, and the streams that are still read, and no others."""
        names = names | self._verdicts.keys()
        for name in self._streams.keys() - names - self._wanted:
            self._streams.pop(name).destroy()
        for peer in self._watermarks.keys() - {each.peer for each in (*self._streams, *names)}:
            self.node.destroy_publisher(self._watermarks.pop(peer))
        for name in names - self._streams.keys():
            topic = self.topic(*name)
            if name.peer not in self._watermarks:
                self._watermarks[name.peer] = self.node.create_publisher(
                    StreamWatermarks, watermarks_topic(topic.rpartition('/')[0]), WATERMARKS
                )
            watermarks = self._watermarks[name.peer]
            self._streams[name] = RemoteStream(self.node, topic, watermarks)

    def add(self, name: StreamName) -> None:
        """Publish the verdict of a formula, until it is read no more, or is not read in time."""
        self._verdicts[name] = self.node.now()
        self.keep(self._streams.keys() | {name})

    @property
    def by_topic(self) -> dict[str, StreamName]:
        """The streams by their topics."""
        return {each.topic: name for name, each in self._streams.items()}

    def demand(self) -> tuple[dict[StreamName, int], set[StreamName]]:
        """Return the streams that became wanted since the last call, and the ones no longer wanted.

        Each of the former comes with the time until which its values are published.
        """
        wanted = {name for name, each in self._streams.items() if each.is_wanted}
        former, self._wanted = self._wanted, wanted
        late = self.node.now() - VERDICT_TIMEOUT_NS
        for name in [name for name in self._verdicts if name not in wanted]:
            if name in former or self._verdicts[name] < late:
                del self._verdicts[name]
                self._streams.pop(name).destroy()
        return {name: self._streams[name].told for name in wanted - former}, former - wanted

    def of(self, peer: str, stream: str = '') -> list[RemoteStream]:
        """Return a stream of a peer, if it is published; or all that are read."""
        names = [StreamName(peer, stream)] if stream else [*self._wanted]
        known = (each for each in names if each.peer == peer and each in self._streams)
        return [self._streams[each] for each in known]
