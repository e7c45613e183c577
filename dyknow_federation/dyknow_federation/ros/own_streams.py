"""The own streams that peers have asked for: made by the stream manager, as for any client."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from dyknow_interfaces.msg import Sample as SampleMessage
from dyknow_interfaces.msg import StreamSpec, StreamStatus, StreamStatusArray
from dyknow_interfaces.srv import StreamCreateFromSpec, StreamDestroy

from dyknow_common import SECOND_NS, Alternatives, DyKnowError, ExitCode
from dyknow_common.ros import STREAM, DyKnowNode, RemoteNode, time_to_nanoseconds
from dyknow_federation.errors import FederationError
from dyknow_federation.messages import MAX_REASON, StreamFault
from dyknow_federation.offers import VALUE, Offer
from dyknow_federation.peer import Peer
from dyknow_stream_processing import Violation, ViolationKind
from dyknow_stream_processing.ros import NodeTopics, sample_fields, sample_valid_time

NAME: Final = '_federation_'
"""The beginning of the names of the streams; DyKnow's own streams begin with an underscore."""

GONE_NS: Final = 2 * SECOND_NS
"""Time after which a stream is made anew that the stream manager does not report."""

RETRY_NS: Final = SECOND_NS
"""Time after which streams are tried again that cannot be made."""


@dataclass(eq=False, slots=True)
class OwnStream:
    """Listener that passes the samples of a stream on to the peers.

    Args:
        streams: all streams of this host; this is one of them.
        name: the name of the stream for peers.
    """

    streams: OwnStreams
    name: str
    known_until: int | None = None
    """No later sample is valid until this time; None if nothing has come yet."""
    fault: str = ''
    """Why no sample is passed on any more."""

    def on_type(self, class_: Any) -> None:
        """Do nothing: the samples name their fields."""

    def on_publishers(self, count: int, *, is_latched: bool) -> None:
        """Do nothing."""

    def valid_time(self, message: Any) -> int | None:
        """Return the valid time of a sample."""
        return sample_valid_time(message)

    def on_message(self, message: Any, now: int, sent_at: int, *, is_initial: bool) -> None:  # noqa: ARG002
        """Pass a sample on."""
        own, valid_time = self.streams, sample_valid_time(message)
        value = sample_fields(message)[VALUE]
        if not self.fault and isinstance(value, Alternatives):
            # Its times are known up to the bounds of a clock that the asking host does not know.
            self.fault = (
                f"the stream '{self.name}' is made from one of another host, so peers get no more "
                'samples of it; let them ask that host'
            )
            own.node.get_logger().warning(self.fault)
            own.violate(self.name, ViolationKind.SOURCE, self.fault, valid_time)
        if self.fault:
            return
        try:
            own.peer.publish(self.name, valid_time, value, now)
        except FederationError as error:  # The engine, or the clock, has gone back in time.
            own.violate(self.name, ViolationKind.LOST, error.message, valid_time)
            return
        self.known_until = max(valid_time, self.known_until or 0)
        if message.watermark:
            self._promise(time_to_nanoseconds(message.watermark[0]) - 1, now)
        own.changed()

    def on_watermark(self, watermark: int, now: int) -> None:
        """Promise that no sample valid before a time follows."""
        if not self.fault:
            self._promise(watermark - 1, now)
            self.streams.changed()

    def _promise(self, time: int, now: int) -> None:
        self.known_until = max(time, self.known_until or 0)
        self.streams.peer.promise(self.name, time, now)

    def on_dropped(self, reason: str, count: int) -> None:
        """Report samples that were lost between the engine and this node."""
        self.streams.node.reject(self.name, f'{count} samples: {reason}')

    def on_doubt(self, doubt: Any, pause: Any) -> None:
        """Ignore that samples may be lost: the lost ones are told."""

    def on_violation(self, violation: Violation) -> None:
        """Tell the peers, as their readers cannot know why samples are missing or wrong."""
        time, kind = violation.valid_time, violation.constraint
        self.streams.violate(self.name, kind, violation.message, time)


class _Made(NamedTuple):
    """A stream that is made."""

    offer: Offer
    listener: OwnStream
    remove: Callable[[], None]


class OwnStreams:
    """The streams that peers have asked for.

    Args:
        node: the node.
        peer: this host among its peers.
        changed: is called after each sample, promise and violation.
    """

    def __init__(self, node: DyKnowNode, peer: Peer, changed: Callable[[], None]) -> None:
        self.offers: Mapping[str, Offer] = {}
        """All that peers may ask for, by the names of the streams."""
        self.faults: tuple[str, ...] = ()
        """What cannot be shared, and why."""
        self.node = node
        self.peer = peer
        self.changed = changed
        services = (StreamCreateFromSpec, StreamDestroy)
        name = node.parameter('stream_manager', 'stream_manager', 'Name of the stream manager.')
        self._manager = RemoteNode(node, name, services=services)
        self._manager.on_lost.append(self._lose_reports)
        self._report = StreamStatusArray()
        node.create_report_subscription(
            StreamStatusArray, f'{name}/streams', self._note_report, callback_group=node.reentrant
        )
        self.needed: frozenset[str] = frozenset()
        """Those that formulas of peers are about."""
        self._topics = NodeTopics.of(node)
        self._failed: set[str] = set()
        """The streams that cannot be made; peers have been told."""
        self._made: dict[str, _Made] = {}
        self._missing_since: dict[str, int] = {}
        """When the stream manager was first found not to report streams that are made."""
        self._next_try = 0
        self._is_working = False

    @property
    def made(self) -> frozenset[str]:
        """The names of the streams that are made, as the stream manager reports, too."""
        reported = {each.name for each in self._report.streams}
        return frozenset(each for each in self._made if NAME + each in reported)

    def known_until(self, names: Collection[str]) -> int | None:
        """Return until when all samples of streams that are made are known; None if unknown."""
        times = [self._made[each].listener.known_until for each in names]
        known = [each for each in times if each is not None]
        return min(known, default=None) if len(known) == len(times) else None

    def fault_of(self, names: Collection[str]) -> str:
        """Return why samples of some streams that are made cannot be used; empty if they can."""
        return next((fault for each in names if (fault := self._made[each].listener.fault)), '')

    def reconcile(self) -> None:
        """Make the streams that peers ask for; destroy all others, and outdated ones."""
        asked = self.peer.sent.keys() | self.needed
        self._failed &= asked
        due = {name: self.offers[name] for name in asked & self.offers.keys()}
        self._forget_gone()
        if self._is_working or self._wall_time() < self._next_try:
            return
        if due != {name: each.offer for name, each in self._made.items()}:
            self._is_working = True
            self.node.spawn(self._reconcile, due)

    def _wall_time(self) -> int:
        return int(self.node.wall_clock.now().nanoseconds)

    def _note_report(self, report: StreamStatusArray) -> None:
        self._report = report

    def _lose_reports(self) -> None:
        self._report = StreamStatusArray()

    def _forget_gone(self) -> None:
        """Forget the streams that a restart has ended, or somebody else, for them to be made anew.

        A restarted stream manager learns from its engines what these make.
        """
        is_known = self._manager.alive and bool(self._report.engines)
        missing = self._made.keys() - self.made if is_known and not self._is_working else ()
        now = self._wall_time()
        self._missing_since = {name: self._missing_since.get(name, now) for name in missing}
        for name, since in list(self._missing_since.items()):
            if now - since >= GONE_NS:
                del self._missing_since[name]
                known_until = self._made[name].listener.known_until
                self._made.pop(name).remove()
                reason = 'its host makes it anew, as it was gone there'
                time = None if known_until is None else known_until + 1
                self.violate(name, ViolationKind.LOST, reason, time)

    async def _reconcile(self, due: Mapping[str, Offer]) -> None:
        faults: list[str] = []
        try:
            for name in [name for name, each in self._made.items() if due.get(name) != each.offer]:
                await self._remove(name)
                if name in due:
                    reason = 'its host makes it from another source now'
                    self.violate(name, ViolationKind.SOURCE, reason)
            for name in due.keys() - self._made.keys():
                try:
                    await self._make(name, due[name])
                except DyKnowError as error:
                    faults.append(f"stream '{name}' cannot be shared: {error}")
                    if name not in self._failed:
                        self._failed.add(name)
                        self.violate(name, ViolationKind.SOURCE, faults[-1])
        finally:
            self._is_working = False
        self.faults = tuple(faults)
        self._next_try = self._wall_time() + RETRY_NS if faults else 0

    def violate(self, name: str, kind: str, reason: str, time: int | None = None) -> None:
        """Tell who asks for a stream why samples are missing or wrong, from a time or now on."""
        now = self.node.now()
        fault = StreamFault(now if time is None else time, str(kind), reason[:MAX_REASON])
        self.peer.violate(name, fault, now)
        self.changed()

    async def _make(self, name: str, offer: Offer) -> None:
        spec = StreamSpec(name=NAME + name, specification=offer.specification)
        try:
            created = await self._manager.call(StreamCreateFromSpec, spec=spec)
            topic = created.stream_topic
        except DyKnowError as error:
            if error.code is not ExitCode.ALREADY_EXISTS:
                raise
            # An earlier run of this node has left it. Its formulas may still be evaluated.
            known = (each for each in self._report.streams if each.name == spec.name)
            left = next(known, StreamStatus())
            topic = left.topic if left.specification == spec.specification else ''
        if not topic:
            await self._manager.call(StreamDestroy, stream_name=spec.name)
            created = await self._manager.call(StreamCreateFromSpec, spec=spec)
            topic = created.stream_topic
        listener = OwnStream(self, name)
        remove = self._topics.listen(topic, listener, STREAM, SampleMessage)
        self._topics.refresh()
        self._made[name] = _Made(offer, listener, remove)

    async def _remove(self, name: str) -> None:
        self._made.pop(name).remove()
        self._topics.refresh()
        try:
            await self._manager.call(StreamDestroy, stream_name=NAME + name)
        except DyKnowError as error:
            self.node.get_logger().info(f"stream '{NAME}{name}' is not destroyed: {error}")
