"""The latched topic `~/streams`, on which nodes report the state of their streams."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from math import isfinite
from typing import Any, Final

from dyknow_interfaces.msg import StreamDrop, StreamSource, StreamStatus, StreamStatusArray

from dyknow_common.ros import (
    LATCHED,
    TICK_PERIOD_S,
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

REPORT_PERIOD_S: Final = 1.0

_REST: Final = 4
"""The least time between two reports, in multiples of the time that a report takes."""

_COMMON_FIELDS: Final = (
    'name',
    'message',
    'engine',
    'topic',
    'stream_id',
    'message_type',
    'specification',
    'samples',
    'violations',
)
"""The fields that a report and its message have in common."""


class StreamReportPublisher:
    """Publisher of `~/streams`, each second and soon after a change.

    With very many streams it publishes less often, since each report has all of them.

    Args:
        engines: returns the names of the stream processing engines that are alive.
        reports: returns the report of each stream.
        known_until: returns the time until which all messages of the topics are in the reports, in
            nanoseconds. A node that has not run, or has not yet processed them, knows less.
        on_period_end: is called before each periodic report.
    """

    def __init__(
        self,
        node: DyKnowNode,
        engines: Callable[[], Iterable[str]],
        reports: Callable[[], Iterable[StreamReport]],
        known_until: Callable[[], int],
        on_period_end: Callable[[], None] = lambda: None,
    ) -> None:
        self._node = node
        self._engines = engines
        self._reports = reports
        self._known_until = known_until
        self._on_period_end = on_period_end
        self._due = False
        self._cost_s = 0.0
        self._publisher = node.create_publisher(StreamStatusArray, '~/streams', LATCHED)
        node.create_timer(REPORT_PERIOD_S, self._end_period, clock=node.wall_clock)

    def publish_soon(self) -> None:
        """Publish a report soon; simultaneous changes share one."""
        if not self._due:
            self._due = True
            wait_s = max(TICK_PERIOD_S, _REST * self._cost_s)
            self._node.deadlines.after(wait_s).add_done_callback(lambda _: self._publish())

    def _end_period(self) -> None:
        self._on_period_end()
        self.publish_soon()

    def _publish(self) -> None:
        self._due = False
        began = time.monotonic()
        stamp = nanoseconds_to_time(self._known_until())
        reports = sorted(self._reports(), key=lambda report: report.name)
        self._publisher.publish(
            StreamStatusArray(
                stamp=stamp,
                engines=sorted(self._engines()),
                streams=[report_to_message(report) for report in reports],
            )
        )
        self._cost_s = time.monotonic() - began


def report_to_message(report: StreamReport) -> Any:
    """Return a StreamStatus message."""
    return StreamStatus(
        **{name: getattr(report, name) for name in _COMMON_FIELDS},
        state=int(report.state),
        constraints=constraints_to_message(report.constraints),
        drops=_drops_to_messages(report.drops),
        sources=[
            StreamSource(
                topic=source.topic,
                stream_id=source.stream_id,
                samples=source.samples,
                latest=nanoseconds_to_time(source.latest or 0),
                delay=nanoseconds_to_duration(source.delay),
                before_sending=nanoseconds_to_duration(source.before_sending),
                transport=nanoseconds_to_duration(source.transport),
                rate=source.rate,
                drops=_drops_to_messages(source.drops),
            )
            for source in report.sources
        ],
        rate=report.flow.rate,
        mean_delay=nanoseconds_to_duration(report.flow.mean_delay),
        max_delay=nanoseconds_to_duration(report.flow.max_delay),
    )


def report_from_message(message: Any) -> StreamReport:
    """Return the report in a StreamStatus message.

    Raises:
        ValueError: for a state that does not exist, or a rate that is no number.
        DyKnowError: for constraints that contradict each other.
    """
    for rate in (message.rate, *(source.rate for source in message.sources)):
        if not isfinite(rate):
            raise ValueError(f'its rate is {rate}')
    return StreamReport(
        **{name: getattr(message, name) for name in _COMMON_FIELDS},
        state=StreamState(message.state),
        constraints=constraints_from_message(message.constraints),
        drops=_drops_from_messages(message.drops),
        sources=tuple(
            SourceReport(
                source.topic,
                source.samples,
                time_to_nanoseconds(source.latest) or None,
                time_to_nanoseconds(source.delay),
                time_to_nanoseconds(source.before_sending),
                time_to_nanoseconds(source.transport),
                source.stream_id,
                source.rate,
                _drops_from_messages(source.drops),
            )
            for source in message.sources
        ),
        flow=Flow(
            message.rate,
            time_to_nanoseconds(message.mean_delay),
            time_to_nanoseconds(message.max_delay),
        ),
    )


def _drops_to_messages(drops: Mapping[str, int]) -> list[Any]:
    return [StreamDrop(reason=reason, count=count) for reason, count in drops.items()]


def _drops_from_messages(drops: Iterable[Any]) -> dict[str, int]:
    return {drop.reason: drop.count for drop in drops}
