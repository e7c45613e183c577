"""The parts of formulas of this host that peers evaluate; see `push_down`."""

from __future__ import annotations

from itertools import count
from typing import Any
from zlib import crc32

from rclpy.task import Future

from dyknow_common import shortened
from dyknow_common.ros import time_to_nanoseconds
from dyknow_coordinator import PEER_VERDICT
from dyknow_federation.events import FormulaAnswered, FormulaWaits
from dyknow_federation.messages import FormulaRequest
from dyknow_federation.offers import VALUE
from dyknow_federation.peer import Peer
from dyknow_federation.push_down import PeerPart, PushDown
from dyknow_federation.ros.remote_streams import RemoteStreams, StreamName
from dyknow_reasoning import parse_formula
from dyknow_stream_processing import Select, Selection, StreamReference


class RemoteFormulas:
    """The parts of formulas that peers evaluate.

    Args:
        peer: this host among its peers.
        streams: the streams of peers; the streams of verdicts are added to them.
        name: the name of this host.
    """

    def __init__(self, peer: Peer, streams: RemoteStreams, name: str) -> None:
        self._peer = peer
        self._streams = streams
        # Unique among all hosts, and their restarts.
        run = crc32(f'{name} {streams.node.started_at}'.encode())
        self._names = (f'{PEER_VERDICT}{run:08x}_{each}' for each in count(1))
        self._waiting: dict[StreamName, Future] = {}
        self._waits: dict[StreamName, str] = {}

    def take(self, event: FormulaAnswered) -> None:
        """Take the answer of a peer."""
        waiting = self._waiting.pop(StreamName(event.peer, event.stream), None)
        if waiting is not None:
            waiting.set_result(event.refusal)

    def note_wait(self, event: FormulaWaits) -> None:
        """Note why a peer has no states of a formula."""
        self._waits[StreamName(event.peer, event.stream)] = event.reason

    def note_states(self, peer: str, stream: str) -> None:
        """Note that the verdict of a peer is known until a later time."""
        self._waits.pop(StreamName(peer, stream), None)

    def waits(self) -> dict[str, str]:
        """Return why verdicts do not come that are read, by their topics."""
        topics = self._streams.by_topic.items()
        found = {name: (topic, self._waits[name]) for topic, name in topics if name in self._waits}
        self._waits = {name: reason for name, (_, reason) in found.items()}
        return dict(found.values())

    async def push_down(self, request: Any, response: Any) -> None:
        """Serve PushDown: what no peer takes on remains to be evaluated here."""
        topics = self._streams.by_topic
        streams: dict[str, StreamName] = {}
        for each in request.groundings:
            topic = _plain_topic(each.stream, each.symbol)
            if topic in topics and not each.stand_ins:
                streams[each.symbol] = topics[topic]
        if not streams:
            return
        domains = {each.sort: tuple(each.objects) for each in request.domains}
        found = PushDown(parse_formula(request.formula), domains, streams)
        period = sum(map(time_to_nanoseconds, request.sample_period))
        asked = [(part, *self._ask(part, period)) for part in found.parts]
        given: dict[PeerPart, str] = {}
        for part, name, answered in asked:
            if refusal := await answered:
                text = (
                    f"peer '{part.peer}' does not evaluate '{shortened(part.formula)}': {refusal}"
                )
                self._streams.node.get_logger().info(text)
            else:
                self._streams.add(name)
                given[part] = self._streams.topic(*name)
        if given:
            response.formula = found.remaining(given)
            response.parts = [f'{each.peer} evaluates {each.formula}' for each in given]

    def _ask(self, part: PeerPart, sample_period: int) -> tuple[StreamName, Future]:
        name, now = StreamName(part.peer, next(self._names)), self._streams.node.now()
        self._waiting[name] = Future()
        asked = FormulaRequest(name.stream, part.text, sample_period)
        self._peer.request_formula(part.peer, asked, now)
        return name, self._waiting[name]


def _plain_topic(stream: str, symbol: str) -> str:
    """Return the topic whose values a stream passes on unchanged; empty if there is none."""
    topic = stream.rpartition(' from ')[2].strip('"')
    plain = Select((Selection(VALUE, symbol),), StreamReference(topic, is_topic=True))
    return topic if stream == str(plain) else ''
