"""Measures what the live page costs its server: processor time and traffic.

python benchmarks/dashboard.py [--json] [--streams 50] [--rate 20] [--formulas 20] [--seconds 20]

All nodes run, with a stream for each of 50 vehicles at 20 Hz, and 20 formulas are monitored. The
share of a core of the process of `dyknow dashboard` is measured without a page, with a page that
shows each table, and with one and four formulas opened, whose signals are sent. A plain node that
has discovered the same system and does nothing is the baseline.
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

from dyknow_interfaces.action import MonitorFormula
from processes import Client, processor_time, resident_memory, use_private_domain
from rclpy.action import ActionClient
from running_system import COORDINATOR, RunningSystem
from tornado.websocket import websocket_connect

from dyknow_bringup.resources import executable_path
from dyknow_common.ros import nanoseconds_to_duration

IDLE = """
import rclpy
from dyknow_common.ros import node_executor
rclpy.init()
executor = node_executor()
executor.add_node(rclpy.create_node('idle'))
print('ready', flush=True)
executor.spin()
"""

SETTLE_S = 5.0


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


def monitor(client: Client, formulas: list[str]) -> None:
    """Have formulas monitored, and wait until they are accepted."""
    action = ActionClient(client.node, MonitorFormula, f'{COORDINATOR}/monitor_formula')
    client.spin_until(action.server_is_ready, 'the action')
    timeout = nanoseconds_to_duration(3_600 * 10**9)
    goals = [
        action.send_goal_async(MonitorFormula.Goal(formula=each, timeout=timeout, margin=True))
        for each in formulas
    ]
    client.spin_until(lambda: all(each.done() for each in goals), 'all are accepted', 120.0)


class Measurement:
    """Shares of a core of the dashboard and of an idle node, for one situation after another."""

    def __init__(self, dashboard: int, idle: int, seconds: float) -> None:
        self.rows: list[dict[str, Any]] = []
        self._dashboard = dashboard
        self._idle = idle
        self._seconds = seconds

    def add(self, situation: str, system: RunningSystem, page: Page | None) -> None:
        """Measure a situation."""
        system.wait(SETTLE_S)
        begun = time.monotonic()
        before = processor_time(self._dashboard), processor_time(self._idle)
        sent = (page.messages, page.characters) if page else (0, 0)
        system.wait(self._seconds)
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


def measure(streams: int, rate: float, formulas: int, seconds: float) -> list[dict[str, Any]]:
    """Return the cost of each situation."""
    line = [str(executable_path('dyknow_command', 'dyknow')), 'dashboard', '--port', '0']
    with RunningSystem(streams, rate) as system:
        names = list(system.sources)
        texts = [f'always (Power[{names[n % streams]}] < {1000 + n})' for n in range(formulas)]
        monitor(system.client, texts)
        with (
            started(line) as (dashboard, address),
            started([sys.executable, '-c', IDLE]) as (idle, _),
        ):
            found = Measurement(dashboard.pid, idle.pid, seconds)
            found.add('no page', system, None)
            page = Page(address.split()[1])
            for view in ('formulas', 'streams', 'graph', 'ontology'):
                page.show(view, [])
                found.add(view, system, page)
            keys = [each['id'] for each in page.rows]
            for number in (1, 4):
                page.show('formulas', keys[:number])
                found.add(f'{number} formulas opened', system, page)
            page.close()
            found.add('the page is closed', system, None)
        return found.rows


def main() -> None:
    """Measure, and print a line for each situation."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--json', action='store_true', help='print JSON')
    parser.add_argument('--streams', type=int, default=50)
    parser.add_argument('--rate', type=float, default=20.0)
    parser.add_argument('--formulas', type=int, default=20)
    parser.add_argument('--seconds', type=float, default=20.0)
    options = parser.parse_args()
    use_private_domain()
    rows = measure(options.streams, options.rate, options.formulas, options.seconds)
    if options.json:
        document = {'cores': os.cpu_count(), 'load': os.getloadavg()[0], 'rows': rows}
        print(json.dumps(document, indent=2))
        return
    for row in rows:
        print(', '.join(f'{name} {value}' for name, value in row.items()))


if __name__ == '__main__':
    main()
