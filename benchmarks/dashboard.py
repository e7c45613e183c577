"""Measures what the live page costs its server: processor time and traffic.

python benchmarks/dashboard.py [--json] [--quick]

Another process publishes what a system with 50 streams and 20 formulas does: the reports, the
heartbeats of seven nodes, and the states of each formula at 20 Hz. The share of a core of the
process of `dyknow dashboard` is measured without a page, with a page that shows each part, and with
one and four formulas opened, whose signals are sent. A plain node in the same system that does
nothing is the baseline.
"""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from dyknow_interfaces.msg import Sample as SampleMessage
from parts import measure
from processes import costs, use_private_domain, wait_until_begun, worker
from tornado.websocket import websocket_connect

from commands import command
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

STREAMS = 50
RATE = 20.0
FORMULAS = 20
SETTLE_S = 4.0

FIELDS = 10
"""The number of features of a formula."""


class LivePage:
    """A page that receives all it is sent, in a thread of its own."""

    def __init__(self, address: str) -> None:
        self.messages = 0
        self.characters = 0
        self.rows: list[dict[str, Any]] = []
        self._loop = asyncio.new_event_loop()
        threading.Thread(target=self._loop.run_forever, daemon=True).start()
        self._socket = self._run(self._connect(address.replace('http', 'ws') + '/live'))

    def show(self, view: str, opened: Sequence[str] = ()) -> None:
        """Show a part of the system."""
        self._run(self._send(json.dumps({'view': view, 'opened': list(opened)})))

    def close(self) -> None:
        """Close the page."""
        self._loop.call_soon_threadsafe(self._socket.close)

    def _run(self, work: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(10)

    async def _connect(self, address: str) -> Any:
        return await websocket_connect(address, on_message_callback=self._receive)

    async def _send(self, text: str) -> None:
        await self._socket.write_message(text)

    def _receive(self, text: str | bytes | None) -> None:
        if isinstance(text, str):
            self.messages += 1
            self.characters += len(text)
            if text.startswith('{"type": "formulas"'):
                self.rows = json.loads(text)['rows']


class PublishedSystem:
    """The nodes of a system, and what they publish."""

    def __init__(self) -> None:
        features = [f's{number}.power' for number in range(STREAMS)]
        self._used = [features[first : first + FIELDS] for first in range(FORMULAS)]
        self._started = time.time_ns()
        self._sent = 0
        self.nodes = [DyKnowNode(each) for each in (*NEEDED, 'stream_processing_engine')]
        manager = self.nodes[NEEDED.index(STREAM_MANAGER)]
        EvaluationsReport(self.nodes[0], self._statuses)
        engine = ['/stream_processing_engine']
        StreamReportPublisher(manager, lambda: engine, self._reports, manager.now)
        self._writers = [SampleWriter() for _ in self._used]
        self._publishers = [
            self.nodes[-1].create_publisher(SampleMessage, f'/dyknow/streams/_states_{n}', STREAM)
            for n in range(FORMULAS)
        ]
        self.nodes[-1].create_timer(1 / RATE, self._send_states)

    def _statuses(self) -> list[EvaluationStatus]:
        return [
            EvaluationStatus(
                f'formula {number}',
                f'always ({" and ".join(f"({each} < 150)" for each in names)})',
                EvaluationPhase.RUNNING,
                self._started,
                state_stream=f'/dyknow/streams/_states_{number}',
                groundings=tuple(
                    SymbolGrounding(each, Grounding.SYNTACTIC, f'select power from {each}', ())
                    for each in names
                ),
                states_progressed=self._sent,
                latest_valid_time=time.time_ns(),
                residual_formula='always ' * 20,
                margin=Margin(-1.0, 20.0, 'W', names[0]),
            )
            for number, names in enumerate(self._used)
        ]

    def _reports(self) -> list[StreamReport]:
        return [
            StreamReport(
                f's{number}',
                StreamState.FLOWING,
                engine='/stream_processing_engine',
                topic=f'/dyknow/streams/s{number}',
                specification=f'stream s{number} = select power from "/battery{number}"; ' * 3,
                samples=self._sent,
                sources=(SourceReport(f'/battery{number}', self._sent, time.time_ns()),),
                flow=Flow(RATE, 3_000_000, 9_000_000),
            )
            for number in range(STREAMS)
        ]

    def _send_states(self) -> None:
        self._sent += 1
        now = time.time_ns()
        for names, writer, publisher in zip(
            self._used, self._writers, self._publishers, strict=True
        ):
            fields = {each: 100.0 + (self._sent * 7 + n) % 40 for n, each in enumerate(names)}
            publisher.publish(writer.write(Sample(now, now, fields)))


def publish() -> None:
    """Publish what a system does, until the process is terminated."""
    rclpy.init()
    executor = node_executor()
    for node in PublishedSystem().nodes:
        executor.add_node(node)
        node.announce()
    print('begun', flush=True)
    executor.spin()


def situation(
    name: str, page: LivePage | None, processes: dict[str, int], seconds: float
) -> dict[str, Any]:
    """Return the costs of the dashboard and of an idle node, and the traffic to a page."""
    time.sleep(SETTLE_S)
    before = (page.messages, page.characters) if page else (0, 0)
    found = costs(processes, time.sleep, seconds)
    after = (page.messages, page.characters) if page else (0, 0)
    return {
        'situation': name,
        **found['dashboard'],
        'idle_share': found['idle']['share'],
        'messages_per_s': round((after[0] - before[0]) / seconds, 1),
        'kb_per_s': round((after[1] - before[1]) / seconds / 1000, 1),
    }


def page(*, quick: bool) -> list[dict[str, Any]]:
    """Return the cost of each situation."""
    line = command('dyknow', 'dashboard', '--port', '0', '--history', 'none')
    with (
        worker('publish', program=Path(__file__)) as publisher,
        worker('idle') as idle,
        subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as dashboard,
    ):
        try:
            wait_until_begun(publisher)
            assert dashboard.stdout is not None
            address = dashboard.stdout.readline().split()[1]
            processes = {'dashboard': dashboard.pid, 'idle': idle.pid}
            seconds = 2.0 if quick else 20.0
            return situations(address, partial(situation, processes=processes, seconds=seconds))
        finally:
            dashboard.terminate()


def situations(address: str, add: Callable[..., Any]) -> list[dict[str, Any]]:
    """Measure without a page, and with a page that shows each part and opens formulas."""
    rows, page = [add('no page', None)], LivePage(address)
    for view in ('formulas', 'streams', 'graph', 'nodes'):
        page.show(view)
        rows.append(add(view, page))
    keys = [each['id'] for each in page.rows]
    assert len(keys) == FORMULAS, f'the page shows {len(keys)} formulas'
    for number in (1, 4):
        page.show('formulas', keys[:number])
        rows.append(add(f'{number} formulas opened', page))
    page.close()
    return rows


if __name__ == '__main__':
    if sys.argv[1:] == ['publish']:
        publish()
    else:
        use_private_domain()
        measure(__doc__, page)
