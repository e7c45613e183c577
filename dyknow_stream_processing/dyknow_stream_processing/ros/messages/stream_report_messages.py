"""The latched topic `~/streams`, on which nodes report the state of their streams."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from math import isfinite
from typing import Any, Final

from dyknow_interfaces.msg import StreamStatus, StreamStatusArray

from dyknow_common.ros import (
    LATCHED,
    TICK_PERIOD_S,
    DyKnowNode,
    from_message,
    nanoseconds_to_time,
    to_message,
)
from dyknow_stream_processing.reporting.stream_report import (
    Flow,
    StreamReport,
)

REPORT_PERIOD_S: Final = 1.0

_REST: Final = 4
"""The least time between two reports, in multiples of the time that a report takes."""


class StreamReportPublisher:
    """Publisher of `~/streams`, each second and soon after a change.

    With very many streams it publishes less often, since each report has all of them.

    Args:
        engines: returns the names of the stream processing engines that are alive.
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
    return to_message(report.flow, to_message(report, StreamStatus()))


def report_from_message(message: Any) -> StreamReport:
    """Return the report in a StreamStatus message.

    Raises:
        ValueError: for a state that does not exist, or a rate that is not a number.
        DyKnowError: for constraints that contradict each other.
    """
    for rate in (message.rate, *(source.rate for source in message.sources)):
        if not isfinite(rate):
            raise ValueError(f'its rate is {rate}')
    return from_message(StreamReport, message, flow=from_message(Flow, message))
