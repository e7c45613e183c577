"""The latched topic `~/streams`, on which nodes tell what has become of streams."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from dyknow_interfaces.msg import StreamDrop, StreamSource, StreamStatus, StreamStatusArray

from dyknow_common.ros import (
    LATCHED,
    NO_PUBLISHER_EVENTS,
    PULSE,
    DyKnowNode,
    constraints_from_message,
    constraints_to_message,
    nanoseconds_to_duration,
    nanoseconds_to_time,
    time_to_nanoseconds,
)
from dyknow_stream_processing.reporting.stream_report import (
    Flow,
    SourceReport,
    StreamReport,
    StreamState,
)

PERIOD = 1.0
"""Seconds between two reports."""


class StreamReportPublisher:
    """Publishes `~/streams` each second, and at once where something changes.

    Args:
        engines: the stream processing engines that live.
        accounts: what has become of each stream.
        before: is called before each report that ends a period.
    """

    def __init__(
        self,
        node: DyKnowNode,
        engines: Callable[[], Iterable[str]],
        accounts: Callable[[], Iterable[StreamReport]],
        before: Callable[[], None] = lambda: None,
    ) -> None:
        self._node = node
        self._engines = engines
        self._accounts = accounts
        self._before = before
        self._due = False
        self._publisher = node.create_publisher(
            StreamStatusArray, '~/streams', LATCHED, event_callbacks=NO_PUBLISHER_EVENTS
        )
        node.create_timer(PERIOD, self._end_period, clock=node.wall_clock)

    def changed(self) -> None:
        """Has a report published soon; one for many changes that come together."""
        if not self._due:
            self._due = True
            self._node.deadlines.after(PULSE).add_done_callback(lambda _: self._publish())

    def _end_period(self) -> None:
        self._before()
        self._publish()

    def _publish(self) -> None:
        self._due = False
        accounts = sorted(self._accounts(), key=lambda account: account.name)
        self._publisher.publish(
            StreamStatusArray(
                stamp=self._node.get_clock().now().to_msg(),
                engines=sorted(self._engines()),
                streams=[report_to_message(account) for account in accounts],
            )
        )


def report_to_message(account: StreamReport) -> StreamStatus:
    """A StreamStatus message."""
    return StreamStatus(
        name=account.name,
        state=int(account.state),
        message=account.message,
        engine=account.engine,
        topic=account.topic,
        message_type=account.message_type,
        specification=account.specification,
        constraints=constraints_to_message(account.constraints),
        samples=account.samples,
        violations=account.violations,
        drops=[StreamDrop(reason=why, count=count) for why, count in account.drops.items()],
        sources=[_source_to_message(source) for source in account.sources],
        rate=account.flow.rate,
        mean_delay=nanoseconds_to_duration(account.flow.mean_delay),
        max_delay=nanoseconds_to_duration(account.flow.max_delay),
    )


def report_from_message(message: StreamStatus) -> StreamReport:
    """What a StreamStatus message tells."""
    return StreamReport(
        name=message.name,
        state=StreamState(message.state),
        message=message.message,
        engine=message.engine,
        topic=message.topic,
        message_type=message.message_type,
        specification=message.specification,
        constraints=constraints_from_message(message.constraints),
        samples=message.samples,
        violations=message.violations,
        drops={drop.reason: drop.count for drop in message.drops},
        sources=tuple(map(_source_from_message, message.sources)),
        flow=Flow(
            message.rate,
            time_to_nanoseconds(message.mean_delay),
            time_to_nanoseconds(message.max_delay),
        ),
    )


def _source_to_message(source: SourceReport) -> StreamSource:
    latest = nanoseconds_to_time(source.latest or 0)
    return StreamSource(topic=source.topic, samples=source.samples, latest=latest)


def _source_from_message(message: StreamSource) -> SourceReport:
    latest = time_to_nanoseconds(message.latest) or None
    return SourceReport(message.topic, message.samples, latest)
