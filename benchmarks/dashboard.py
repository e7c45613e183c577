"""Measures what the live page costs its server: processor time and traffic.

python benchmarks/dashboard.py [--json] [--streams 50] [--rate 20] [--formulas 20] [--seconds 20]

Another process publishes what a system with 50 streams and 20 formulas does: the reports, the
heartbeats of seven nodes, and the states of each formula at 20 Hz. The share of a core of the
process of `dyknow dashboard` is measured without a page, with a page that shows each part, and with
one and four formulas opened, whose signals are sent. A plain node in the same system that does
nothing is the baseline.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import rclpy
from dyknow_interfaces.msg import Sample as SampleMessage
from processes import processor_time, resident_memory, use_private_domain
from tornado.websocket import websocket_connect

from dyknow_bringup.resources import executable_path
from dyknow_common import Margin
from dyknow_common.ros import STREAM, DyKnowNode, node_executor
from dyknow_coordinator import EvaluationPhase, EvaluationStatus, Grounding, SymbolGrounding
from dyknow_coordinator.ros.reporting.evaluations_report import EvaluationsReport
from dyknow_dashboard.ros.nodes_of_system import NEEDED, STREAM_MANAGER
from dyknow_stream_processing.reporting.stream_report import (
    Flow,
    SourceReport,
    StreamReport,
    StreamState,
)
from dyknow_stream_processing.ros import SampleWriter
from dyknow_stream_processing.ros.messages.stream_report_messages import StreamReportPublisher
from dyknow_stream_processing.sample import Sample

IDLE = """
import rclpy
from dyknow_common.ros import node_executor
rclpy.init()
executor = node_executor()
executor.add_node(rclpy.create_node('idle'))
print('ready', flush=True)
executor.spin()
"""

SETTLE_S = 4.0

FIELDS = 10
"""The number of features of a formula."""


class Page:
    """A page that receives all it is sent, in a thread of its own."""

    def __init__(self, address: str) -> None:
        self.messages = 0
        self.characters = 0
        self.rows: list[dict[str, Any]] = []
        self._loop = asyncio.new_event_loop()
        self._socket: Any = None
        self._address = address.replace('http', 'ws') + '/live'
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._run(self._connect())
        self._reader = asyncio.run_coroutine_threadsafe(self._read(), self._loop)

    def show(self, view: str, opened: list[str]) -> None:
        """Show a part of the system."""
        self._run(self._send(json.dumps({'view': view, 'opened': opened})))

    def close(self) -> None:
        """Close the page."""
        self._loop.call_soon_threadsafe(self._socket.close)
        self._reader.result(10)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()

    def _run(self, work: Any) -> None:
        asyncio.run_coroutine_threadsafe(work, self._loop).result(10)

    async def _connect(self) -> None:
        self._socket = await websocket_connect(self._address)

    async def _send(self, text: str) -> None:
        await self._socket.write_message(text)

    async def _read(self) -> None:
        while (text := await self._socket.read_message()) is not None:
            self.messages += 1
            self.characters += len(text)
            if text.startswith('{"type": "formulas"'):
                self.rows = json.loads(text)['rows']


@contextmanager
def started(command: list[str], **options: Any) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A process, and the first line that it has printed."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **options) as process:
        try:
            assert process.stdout is not None
            yield process, process.stdout.readline().strip()
        finally:
            process.terminate()


def publish(streams: int, rate: float, formulas: int) -> None:
    """Publish what a system does, until the process is terminated."""
    features = [f's{number}.power' for number in range(streams)]
    used = [features[n : n + FIELDS] for n in range(formulas)]
    groundings = {
        each: SymbolGrounding(each, Grounding.SYNTACTIC, f'select power from {each}', ())
        for each in features
    }
    started = time.time_ns()
    sent = 0

    def statuses() -> list[EvaluationStatus]:
        now = time.time_ns()
        return [
            EvaluationStatus(
                f'formula {number}',
                f'always ({" and ".join(f"({each} < 150)" for each in names)})',
                EvaluationPhase.RUNNING,
                started,
                state_stream=f'/dyknow/streams/_states_{number}',
                groundings=tuple(groundings[each] for each in names),
                states_progressed=sent,
                latest_valid_time=now,
                residual_formula='always ' * 20,
                margin=Margin(-1.0, 20.0, 'W', names[0]),
            )
            for number, names in enumerate(used)
        ]

    def reports() -> list[StreamReport]:
        return [
            StreamReport(
                f's{number}',
                StreamState.FLOWING,
                engine='/stream_processing_engine',
                topic=f'/dyknow/streams/s{number}',
                specification=f'stream s{number} = select power from "/battery{number}"; ' * 3,
                samples=sent,
                sources=(SourceReport(f'/battery{number}', sent, time.time_ns()),),
                flow=Flow(rate, 3_000_000, 9_000_000),
            )
            for number in range(streams)
        ]

    rclpy.init()
    nodes = [DyKnowNode(each) for each in (*NEEDED, 'stream_processing_engine')]
    coordinator, manager = nodes[0], nodes[NEEDED.index(STREAM_MANAGER)]
    EvaluationsReport(coordinator, statuses)
    engine = '/stream_processing_engine'
    StreamReportPublisher(manager, lambda: [engine], reports, manager.now)
    writers = [SampleWriter() for _ in used]
    publishers = [
        nodes[-1].create_publisher(SampleMessage, f'/dyknow/streams/_states_{n}', STREAM)
        for n in range(formulas)
    ]

    def send_states() -> None:
        nonlocal sent
        sent += 1
        now = time.time_ns()
        for names, writer, publisher in zip(used, writers, publishers, strict=True):
            fields = {each: 100.0 + (sent * 7 + n) % 40 for n, each in enumerate(names)}
            publisher.publish(writer.write(Sample(now, now, fields)))

    nodes[-1].create_timer(1 / rate, send_states)
    executor = node_executor()
    for node in nodes:
        executor.add_node(node)
        node.announce()
    print('ready', flush=True)
    executor.spin()


class Measurement:
    """Shares of a core of the dashboard and of an idle node, for one situation after another."""

    def __init__(self, dashboard: int, idle: int, seconds: float) -> None:
        self.rows: list[dict[str, Any]] = []
        self._dashboard = dashboard
        self._idle = idle
        self._seconds = seconds

    def add(self, situation: str, page: Page | None) -> None:
        """Measure a situation."""
        time.sleep(SETTLE_S)
        begun = time.monotonic()
        before = processor_time(self._dashboard), processor_time(self._idle)
        sent = (page.messages, page.characters) if page else (0, 0)
        time.sleep(self._seconds)
        elapsed = time.monotonic() - begun
        after = processor_time(self._dashboard), processor_time(self._idle)
        received = (page.messages, page.characters) if page else (0, 0)
        row = {
            'situation': situation,
            'share': round((after[0] - before[0]) / elapsed, 4),
            'idle_share': round((after[1] - before[1]) / elapsed, 4),
            'messages_per_s': round((received[0] - sent[0]) / elapsed, 1),
            'kb_per_s': round((received[1] - sent[1]) / elapsed / 1000, 1),
            'memory_mb': round(resident_memory(self._dashboard), 1),
        }
        self.rows.append(row)
        print(row, file=sys.stderr, flush=True)


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return the cost of each situation."""
    line = [
        str(executable_path('dyknow_command', 'dyknow')),
        'dashboard',
        '--port',
        '0',
        '--history',
        'none',
    ]
    sizes = [f'--{name}={getattr(options, name)}' for name in ('streams', 'rate', 'formulas')]
    publisher = [sys.executable, __file__, '--publish', *sizes]
    with (
        started(publisher),
        started(line) as (dashboard, address),
        started([sys.executable, '-c', IDLE]) as (idle, _),
    ):
        found = Measurement(dashboard.pid, idle.pid, options.seconds)
        found.add('no page', None)
        page = Page(address.split()[1])
        for view in ('formulas', 'streams', 'graph', 'nodes'):
            page.show(view, [])
            found.add(view, page)
        keys = [each['id'] for each in page.rows]
        assert len(keys) == options.formulas, f'the page shows {len(keys)} formulas'
        for number in (1, 4):
            page.show('formulas', keys[:number])
            found.add(f'{number} formulas opened', page)
        page.close()
        found.add('the page is closed', None)
    return found.rows


def main() -> None:
    """Measure, and print a line for each situation."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--json', action='store_true', help='print JSON')
    parser.add_argument('--publish', action='store_true', help=argparse.SUPPRESS)
    parser.add_argument('--streams', type=int, default=50)
    parser.add_argument('--rate', type=float, default=20.0)
    parser.add_argument('--formulas', type=int, default=20)
    parser.add_argument('--seconds', type=float, default=20.0)
    options = parser.parse_args()
    if options.publish:
        publish(options.streams, options.rate, options.formulas)
        return
    use_private_domain()
    rows = measure(options)
    if options.json:
        document = {'cores': os.cpu_count(), 'load': os.getloadavg()[0], 'rows': rows}
        print(json.dumps(document, indent=2))
        return
    for row in rows:
        print(', '.join(f'{name} {value}' for name, value in row.items()))


if __name__ == '__main__':
    main()
