"""Changes of verdicts, as a collector of OpenTelemetry receives them."""

from __future__ import annotations

import argparse
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field, replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from queue import Queue
from typing import Any

import pytest
from opentelemetry.proto.collector.logs.v1 import logs_service_pb2 as telemetry
from test_history import FAILED, LOST_STREAM, NOW, RUNNING

from dyknow_common import Verdict
from dyknow_dashboard.model import collector as collector_module
from dyknow_dashboard.model.collector import MAX_WAITING, Collector, collector_url
from dyknow_dashboard.model.verdict_events import EventCounts, VerdictEvent, VerdictWatch
from dyknow_recordings import RecordingError

LIMIT_S = 60.0


@dataclass
class ReceivingCollector:
    """A collector: what it has received, and how it answers."""

    received: Queue[tuple[str, Any]] = field(default_factory=Queue)
    status: int = 200
    may_answer: threading.Event = field(default_factory=threading.Event)
    url: str = ''


@pytest.fixture
def receiving(monkeypatch: pytest.MonkeyPatch) -> Iterator[ReceivingCollector]:
    monkeypatch.setattr(collector_module, 'TIMEOUT_S', LIMIT_S)
    monkeypatch.setattr(collector_module, 'CLOSE_S', LIMIT_S)
    found = ReceivingCollector()
    found.may_answer.set()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers['Content-Length']))
            request = telemetry.ExportLogsServiceRequest.FromString(body)
            found.received.put((self.path, request))
            found.may_answer.wait(LIMIT_S)
            self.send_response(found.status)
            self.send_header('Content-Length', '0')
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            pass

    server = ThreadingHTTPServer(('127.0.0.1', 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    found.url = f'http://127.0.0.1:{server.server_port}'
    yield found
    found.may_answer.set()
    server.shutdown()
    thread.join()
    server.server_close()


def events() -> list[VerdictEvent]:
    counts: EventCounts = Counter()
    watch = VerdictWatch(counts)
    watch.update([RUNNING], NOW)
    return watch.update(
        [FAILED, LOST_STREAM, replace(FAILED, started=5, verdict=Verdict.TRUE)], NOW
    )


def values(attributes: Any) -> dict[str, Any]:
    return {
        each.key: getattr(each.value, str(each.value.WhichOneof('value'))) for each in attributes
    }


def test_events_are_logs(receiving: ReceivingCollector) -> None:
    counts: EventCounts = Counter()
    with closing(Collector(collector_url(receiving.url), '/robot1', counts)) as collector:
        collector.put(events())
        found = [receiving.received.get(timeout=LIMIT_S) for _ in range(3)]
    assert counts == {('collector', 'written'): 3}, 'the end has waited for them'
    assert {path for path, _ in found} == {'/v1/logs'}
    (resource,) = found[0][1].resource_logs
    names = values(resource.resource.attributes)
    assert (names['service.name'], names['service.namespace']) == ('dyknow', '/robot1')
    records = [each.resource_logs[0].scope_logs[0].log_records[0] for _, each in found]
    power, speed, passed = records
    assert (power.event_name, power.severity_text) == ('dyknow.verdict', 'ERROR')
    assert (power.time_unix_nano, power.observed_time_unix_nano) == (NOW, NOW)
    assert power.body.string_value == FAILED.explanation
    assert values(power.attributes) == {
        'dyknow.name': 'power',
        'dyknow.formula': 'always p',
        'dyknow.event': 'false',
        'dyknow.verdict': 'false',
        'dyknow.started': FAILED.started,
        'dyknow.valid_time': NOW,
    }
    assert values(speed.attributes)['dyknow.verdict'] == 'constraint violation'
    assert (passed.severity_text, values(passed.attributes)['dyknow.event']) == ('INFO', 'true')


def test_a_path_of_the_collector_is_kept() -> None:
    assert collector_url('https://a.example/x/y') == 'https://a.example/x/y'
    assert collector_url('http://[::1]:4318/') == 'http://[::1]:4318/v1/logs'
    for text in ('localhost:4318', 'ftp://a', 'http://', 'http://[::1'):
        with pytest.raises(argparse.ArgumentTypeError, match='is no address of HTTP; give one'):
            collector_url(text)


def test_nobody_waits_for_the_collector(
    receiving: ReceivingCollector, monkeypatch: pytest.MonkeyPatch
) -> None:
    counts: EventCounts = Counter()
    receiving.may_answer.clear()
    many = [
        replace(each, name=str(number)) for number in range(MAX_WAITING) for each in events()[:1]
    ]
    with closing(Collector(receiving.url, '/', counts)) as collector:
        collector.put(many[:1])
        receiving.received.get(timeout=LIMIT_S)
        collector.put(many)
        assert counts == {}, 'all of them wait'
        collector.put(many[:3])
        assert counts == {('collector', 'too many wait'): 3}
        monkeypatch.setattr(collector_module, 'CLOSE_S', 0.0)
        receiving.may_answer.set()


def test_a_collector_that_refuses(
    receiving: ReceivingCollector, caplog: pytest.LogCaptureFixture
) -> None:
    counts: EventCounts = Counter()
    receiving.status = 400
    with closing(Collector(receiving.url, '/', counts)) as collector:
        collector.put(events())
    assert counts == {('collector', 'the collector has not taken it'): 3}
    assert 'Failed to export logs batch code: 400' in caplog.text, 'as stderr shows'


def test_a_collector_that_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collector_module, 'TIMEOUT_S', 0.1)
    monkeypatch.setattr(collector_module, 'CLOSE_S', LIMIT_S)
    counts: EventCounts = Counter()
    with closing(Collector('http://127.0.0.1:9/v1/logs', '/', counts)) as collector:
        collector.put(events())
    assert counts == {('collector', 'the collector has not taken it'): 3}


def test_the_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> Any:
        raise ImportError(f'No module named {name}')

    monkeypatch.setattr('dyknow_recordings.reporting.outputs.import_module', missing)
    with pytest.raises(
        RecordingError, match=r'--collector needs .*: pip install opentelemetry-exporter-otlp-proto'
    ):
        Collector('http://127.0.0.1:9', '/', Counter())
