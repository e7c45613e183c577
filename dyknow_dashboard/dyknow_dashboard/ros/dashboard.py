"""The command `dyknow dashboard`: a live page of a running system.

The main thread runs the server and owns the board; another thread runs the node. They exchange
functions to call: reports of the node go to the board, requests of pages to the node.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import signal
import sys
import time
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from threading import Thread
from typing import Any, Final

import rclpy
from dyknow_interfaces.srv import CancelEvaluation, SaveBlackBox
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from dyknow_common import ExitCode
from dyknow_common.executables import SUCCESS, describe
from dyknow_common.ros import NodeAdapter, RemoteNode, command_main, node_executor, start_ros
from dyknow_configuration import NO_MAP, RobotMap, read_robot
from dyknow_coordinator.ros import FormulaClient, Monitor
from dyknow_dashboard.errors import DashboardError
from dyknow_dashboard.model.board import Board
from dyknow_dashboard.model.collector import Collector, collector_url
from dyknow_dashboard.model.requests import AskedFormula
from dyknow_dashboard.ros.nodes_of_system import COORDINATOR, RECORDER
from dyknow_dashboard.ros.system_reader import SystemReader
from dyknow_dashboard.server.requests import is_loopback
from dyknow_dashboard.server.serving import DashboardServer, ServerOptions
from dyknow_recordings.reporting.outputs import optional_library

PORT: Final = 8520

REQUEST_TIMEOUT_S: Final = 40.0
"""The time after which a page is told that a request to the nodes was not answered."""

MAX_ASKED: Final = 50
"""The number of formulas that were asked on pages and run."""

SAVE_TIMEOUT_S: Final = 30.0
"""The time to write black boxes, which records on for some time after the request."""

NO_HISTORY: Final = 'none'

_MAX_PORT: Final = 65_535


class NodeThread:
    """The thread that runs the node, and calls of its coroutines from the thread of the server.

    Args:
        loop: the loop of the thread of the server.
        namespace: the namespace of the node; empty: as its arguments say.
        on_end: called in the thread of the server when the thread has ended.

    Attributes:
        fault: the error that has ended the thread.
    """

    def __init__(
        self, loop: asyncio.AbstractEventLoop, namespace: str, on_end: Callable[[], None]
    ) -> None:
        self.fault: Exception | None = None
        self._loop = loop
        self._on_end = on_end
        name = f'dyknow_dashboard_{os.getpid()}'
        self.node = Node(name, namespace=namespace or None, start_parameter_services=False)
        self.adapter = NodeAdapter(self.node)
        self._executor = node_executor()
        self._executor.add_node(self.node)
        self._thread = Thread(target=self._spin, name='node', daemon=True)

    def start(self) -> None:
        """Run the callbacks of the node from now on."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread; the context must be shut down."""
        if self._thread.ident is not None:  # It was started.
            self._thread.join(timeout=REQUEST_TIMEOUT_S)
        self._executor.shutdown()
        self.node.destroy_node()

    def deliver(self, work: Callable[[], None]) -> None:
        """Have the thread of the server call a function."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(work)

    def run(self, work: Callable[[], Any]) -> None:
        """Have the thread of the node call a function."""
        self._executor.create_task(work)

    async def call(self, work: Callable[[], Awaitable[Any]]) -> Any:
        """Return the result of a coroutine of the node, or raise its error."""
        done: Future[Any] = Future()

        async def run() -> None:
            if not done.set_running_or_notify_cancel():
                return  # Nobody waits any more.
            try:
                done.set_result(await work())
            except Exception as error:  # noqa: BLE001 - the request that waits raises it
                done.set_exception(error)

        self._executor.create_task(run)
        try:
            return await asyncio.wait_for(asyncio.wrap_future(done), REQUEST_TIMEOUT_S)
        except TimeoutError:
            raise DashboardError('the nodes have not answered', ExitCode.TIMEOUT) from None

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            pass
        except Exception as error:  # noqa: BLE001 - the main thread raises it
            self.fault = error
        self.deliver(self._on_end)


class Operations:
    """Requests of pages to the coordinator and the black box recorder, in the thread of the node.

    The formulas that were asked on pages end with this process, as its client does.

    Args:
        thread: runs the node that requests.
    """

    def __init__(self, thread: NodeThread) -> None:
        self._thread = thread
        self._client = FormulaClient(thread.node)
        self._coordinator = RemoteNode(thread.adapter, COORDINATOR)
        self._monitors: set[Monitor] = set()

    async def close(self) -> None:
        """Cancel all formulas that were asked here; to be awaited in the thread of the node."""
        self._client.close()

    async def ask(self, asked: AskedFormula) -> None:
        """Have a formula monitored.

        Raises:
            DyKnowError: if there are too many, or if it could not be started.
        """
        await self._thread.call(partial(self._ask, asked))

    async def cancel(self, name: str) -> int:
        """End the evaluations of a name, and return their number.

        Raises:
            DyKnowError: NOT_FOUND if there is none; UNAVAILABLE without a coordinator.
        """
        request = partial(self._coordinator.call, CancelEvaluation, name=name)
        return int((await self._thread.call(request)).cancelled)

    async def save(self, name: str) -> list[str]:
        """Save the black boxes of a formula, or of all if the name is empty; return their paths.

        Raises:
            DyKnowError: NOT_FOUND if there is none; UNAVAILABLE without a recorder.
        """
        return list((await self._thread.call(partial(self._save, name))).paths)

    async def _ask(self, asked: AskedFormula) -> None:
        if len(self._monitors) >= MAX_ASKED:
            raise DashboardError(
                f'{MAX_ASKED} formulas of this page run already; cancel one', ExitCode.UNAVAILABLE
            )
        monitor = self._client.monitor(
            asked.formula,
            name=asked.name,
            every_state=asked.every_state,
            margin=asked.margin,
            timeout=asked.timeout_s,
        )
        self._monitors.add(monitor)
        monitor.outcome.add_done_callback(lambda _: self._monitors.discard(monitor))
        await monitor.accepted
        if monitor.outcome.done():
            answer: Any = monitor.outcome.result()
            if answer.error is not None:
                raise answer.error

    async def _save(self, name: str) -> Any:
        recorder = RemoteNode(self._thread.adapter, RECORDER, timeout_s=SAVE_TIMEOUT_S)
        try:
            return await recorder.call(SaveBlackBox, name=name)
        finally:
            recorder.release()


def dashboard(options: argparse.Namespace) -> int:
    """Serve the page until a signal, and return the exit code."""
    optional_library('plotly', 'dyknow dashboard')
    served = ServerOptions(options.host, options.port, options.read_only)
    known = NO_MAP if options.robot is None else read_robot(options.robot).map
    start_ros()
    try:
        asyncio.run(_serve(served, options, known))
    finally:
        rclpy.try_shutdown()
    return SUCCESS


async def _serve(served: ServerOptions, options: argparse.Namespace, known: RobotMap) -> None:
    loop, stopped = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stopped.set)
    with _running_node(loop, options.namespace, stopped.set) as thread:
        namespace = thread.node.get_namespace()
        board = Board(time.time_ns, _history_file(options.history, namespace), known)
        collector = None
        if options.collector:
            collector = Collector(options.collector, namespace, board.counts)
            board.sinks.append(collector.put)
        operations = Operations(thread)

        def attend() -> None:
            topics = frozenset(board.state_topics(server.pages.states))
            work = partial(reader.attend, is_open=server.pages.are_open, topics=topics)
            thread.run(partial(work, maps=board.map.streams))

        reader = SystemReader(thread.adapter, board, thread.deliver, attend)
        server = DashboardServer(board, operations, served, attend)
        port = server.start()
        await board.history.open()
        thread.start()
        _announce(served, port)
        if options.history != NO_HISTORY and board.history.state.fault:
            _warn(f'failures are not kept: {board.history.state.fault}')
        await stopped.wait()
        await server.stop()
        await board.history.close()
        if collector is not None:
            await asyncio.to_thread(collector.close)
        if thread.fault is not None:
            raise thread.fault
        await thread.call(operations.close)


@contextmanager
def _running_node(
    loop: asyncio.AbstractEventLoop, namespace: str, on_end: Callable[[], None]
) -> Iterator[NodeThread]:
    thread = NodeThread(loop, namespace, on_end)
    try:
        yield thread
    finally:
        rclpy.try_shutdown()
        thread.stop()


def _announce(options: ServerOptions, port: int) -> None:
    host = f'[{options.host}]' if ':' in options.host else options.host
    print(f'open http://{host}:{port}', flush=True)  # noqa: T201 - this is a command
    if not is_loopback(options.host):
        may = (
            'see the system'
            if options.read_only
            else 'see the system, ask formulas, cancel those of others and clear failures '
            '(--read-only prevents it)'
        )
        _warn(f'everyone who reaches {host}:{port} can {may}; there is no password')


def _warn(text: str) -> None:
    print(f'warning: {text}', file=sys.stderr, flush=True)  # noqa: T201


def _history_file(option: str, namespace: str) -> Path | None:
    name = f'history{namespace.replace("/", "_").rstrip("_")}.db'
    path = Path(os.path.expanduser(option or f'~/.ros/dyknow/{name}'))  # noqa: PTH111 - never fails
    return None if option == NO_HISTORY else path


def _port(text: str) -> int:
    is_number = text.isascii() and text.isdecimal() and len(text) <= len(str(_MAX_PORT))
    if not (is_number and int(text) <= _MAX_PORT):
        raise argparse.ArgumentTypeError(f"'{text}' is no port; give a number up to {_MAX_PORT}")
    return int(text)


def add_dashboard_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.set_defaults(command=dashboard)
    describe(
        parser,
        'Serve a live page of a running system: formulas, streams, nodes. It ends by Ctrl-C.',
        (
            'dyknow dashboard robot.yaml',
            'dyknow dashboard --port 9000 --namespace /robot1',
            'dyknow dashboard --host 0.0.0.0 --read-only',
            'dyknow dashboard --collector http://localhost:4318',
        ),
        '0 after Ctrl-C, 2 for an error',
    )
    parser.add_argument('robot', nargs='?', type=Path, help='robot.yaml, whose regions are drawn')
    parser.add_argument('--host', default='127.0.0.1', help='to listen on (default: 127.0.0.1)')
    parser.add_argument(
        '--port', type=_port, default=PORT, help=f'0 for any free one (default: {PORT})'
    )
    parser.add_argument(
        '--read-only', action='store_true', help='pages can change nothing, such as ask a formula'
    )
    parser.add_argument(
        '--history',
        default='',
        metavar='FILE',
        help='keeps failures over restarts; none: keep none (default: ~/.ros/dyknow/history.db, '
        'with the namespace in its name)',
    )
    parser.add_argument(
        '--collector',
        type=collector_url,
        metavar='URL',
        help='collector that gets changes of verdicts as logs of OpenTelemetry, '
        'http://localhost:4318',
    )
    parser.add_argument(
        '--namespace', default='', metavar='NS', help='of the system (default: that of --ros-args)'
    )


def main() -> int:
    """Run the executable dashboard."""
    return command_main('dashboard', add_dashboard_options)
