"""Verdicts as logs of OpenTelemetry, which a collector receives over HTTP.

A thread of its own sends them, so nobody waits for the collector. Events that it does not take are
dropped and counted.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import suppress
from queue import Full, Queue
from threading import Thread
from typing import Any, Final
from urllib.parse import urlsplit

from dyknow_common import UNIX_TIMES
from dyknow_dashboard.model.verdict_events import FAILURES, EventCounts, VerdictEvent
from dyknow_recordings.reporting.outputs import optional_library

MAX_WAITING: Final = 1000
"""The number of events that wait to be sent."""

TIMEOUT_S: Final = 5.0
"""The time in which the collector must take a request, with all attempts."""

CLOSE_S: Final = 2.0
"""The time that the end of the page gives to events on their way."""


def collector_url(text: str) -> str:
    """Return the address to which logs are sent, given a collector's address as an option."""
    with suppress(ValueError):
        parts = urlsplit(text)
        if parts.scheme in {'http', 'https'} and parts.hostname:
            return text if parts.path.strip('/') else parts._replace(path='/v1/logs').geturl()
    mend = 'give one such as http://localhost:4318'
    raise argparse.ArgumentTypeError(f"'{text}' is no address of HTTP; {mend}")


class Collector:
    """Sends events to a collector.

    Args:
        url: the address to which logs are sent.
        namespace: the namespace of the system.
        counts: the counts of the events that were sent and dropped.

    Raises:
        DyKnowError: naming the mend, if the library is not installed.
    """

    def __init__(self, url: str, namespace: str, counts: EventCounts) -> None:
        exporter = _library('opentelemetry.exporter.otlp.proto.http._log_exporter')
        self._exporter = exporter.OTLPLogExporter(url, timeout=TIMEOUT_S)
        self._api, self._sdk = _library('opentelemetry._logs'), _library('opentelemetry.sdk._logs')
        names = {'service.name': 'dyknow', 'service.namespace': namespace}
        self._resource = _library('opentelemetry.sdk.resources').Resource.create(names)
        self._counts = counts
        self._queue: Queue[VerdictEvent | None] = Queue(MAX_WAITING)
        self._thread = Thread(target=self._run, name='collector', daemon=True)
        self._thread.start()

    def put(self, events: Sequence[VerdictEvent]) -> None:
        """Queue events for sending, failures or not."""
        for each in events:
            try:
                self._queue.put_nowait(each)
            except Full:
                self._counts['collector', 'too many wait'] += 1

    def close(self) -> None:
        """Wait for the events on their way, but not long."""
        with suppress(Full):
            self._queue.put_nowait(None)
        self._thread.join(CLOSE_S)
        self._exporter.shutdown()

    def _run(self) -> None:
        for event in iter(self._queue.get, None):
            try:
                result = self._exporter.export([self._record(event)]).name
            except Exception:  # noqa: BLE001 - the thread goes on with later events
                result = 'ERROR'
            fate = 'written' if result == 'SUCCESS' else 'the collector has not taken it'
            self._counts['collector', fate] += 1

    def _record(self, event: VerdictEvent) -> Any:
        is_simulated = event.valid_time is None or event.valid_time < UNIX_TIMES
        levels = self._api.SeverityNumber
        level = levels.ERROR if event.event in FAILURES else levels.INFO
        attributes = {
            f'dyknow.{name}': value
            for name in ('name', 'formula', 'event', 'verdict', 'started', 'valid_time')
            if (value := getattr(event, name)) is not None
        }
        record = self._api.LogRecord(
            timestamp=event.known_at if is_simulated else event.valid_time,
            observed_timestamp=event.known_at,
            severity_number=level,
            severity_text=level.name,
            body=event.explanation,
            attributes=attributes,
            event_name='dyknow.verdict',
        )
        return self._sdk.ReadableLogRecord(record, self._resource)


def _library(module: str) -> Any:
    return optional_library(module, '--collector', 'opentelemetry-exporter-otlp-proto-http')
