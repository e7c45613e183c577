"""A server of the page without ROS, and a client that sends it anything."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from dyknow_common import DyKnowError, ExitCode
from dyknow_dashboard.model.board import Board
from dyknow_dashboard.model.requests import AskedFormula
from dyknow_dashboard.server.serving import DashboardServer, ServerOptions

TIMEOUT_S = 20.0


def drawn(image: str) -> ET.Element:
    """An image of SVG, whose elements have no namespace."""
    return ET.fromstring(image.replace(' xmlns="http://www.w3.org/2000/svg"', ''))  # noqa: S314


@dataclass
class RecordingOperator:
    """Records what was asked for; there is one evaluation, `power`."""

    asked: list[AskedFormula] = field(default_factory=list)

    async def ask(self, asked: AskedFormula) -> None:
        if 'nothing' in asked.formula:
            raise DyKnowError('no stream carries nothing', ExitCode.NOT_FOUND)
        self.asked.append(asked)

    async def cancel(self, name: str) -> int:
        if name != 'power':
            raise DyKnowError(f"there is no evaluation '{name}'", ExitCode.NOT_FOUND)
        return 1

    async def save(self, name: str) -> list[str]:
        if name != 'saved':
            raise DyKnowError(f'no recorder has {name}', ExitCode.UNAVAILABLE)
        return ['/boxes/1']


@dataclass
class Served:
    """A running server.

    Args:
        changes: for each call of `on_change`, the number of open pages.
    """

    board: Board
    operator: RecordingOperator
    port: int
    server: DashboardServer
    run: Callable[[Callable[[], Any]], Any]
    changes: list[int]

    @property
    def host(self) -> str:
        return f'127.0.0.1:{self.port}'

    def exchange(self, content: bytes) -> bytes:
        """Send bytes, and return everything that comes until the connection is closed."""
        with socket.create_connection(('127.0.0.1', self.port), TIMEOUT_S) as connection:
            connection.sendall(content)
            received = b''
            while part := connection.recv(65536):
                received += part
            return received

    def request(
        self, method: str, path: str, body: bytes = b'', **headers: str | None
    ) -> tuple[int, dict[str, str], bytes]:
        """Return the status, the headers and the body of a response."""
        given = {name.replace('_', '-'): value for name, value in headers.items()}
        sent = {
            'Host': self.host,
            'Connection': 'close',
            'Content-Length': str(len(body)),
            **({'Content-Type': 'application/json'} if body else {}),
            **given,
        }
        lines = [f'{method} {path} HTTP/1.1']
        lines += [f'{name}: {value}' for name, value in sent.items() if value is not None]
        received = self.exchange('\r\n'.join([*lines, '', '']).encode() + body)
        head, _, content = received.partition(b'\r\n\r\n')
        first, *rest = head.decode().split('\r\n')
        found = dict(line.split(': ', 1) for line in rest)
        return int(first.split()[1]), found, content

    def post(self, action: str, document: Any, **headers: str | None) -> tuple[int, Any]:
        """Return the status and the document of the response to a request of a page."""
        content = document if isinstance(document, bytes) else json.dumps(document).encode()
        status, _, body = self.request('POST', f'/api/{action}', content, **headers)
        return status, json.loads(body)


class PageConnection:
    """The WebSocket of a page, as RFC 6455 has it.

    Attributes:
        status: of the response to the handshake: 101 if the connection is open.
        closed: the code and the reason with which the server has ended it.
    """

    def __init__(self, served: Served, **headers: str) -> None:
        self._connection = socket.create_connection(('127.0.0.1', served.port), TIMEOUT_S)
        self._file = self._connection.makefile('rb')
        self.closed: tuple[int, str] | None = None
        sent = {
            'Host': served.host,
            'Upgrade': 'websocket',
            'Connection': 'Upgrade',
            'Sec-WebSocket-Key': 'dGhlIHNhbXBsZSBub25jZQ==',
            'Sec-WebSocket-Version': '13',
            **headers,
        }
        lines = ['GET /live HTTP/1.1', *(f'{name}: {value}' for name, value in sent.items())]
        self._connection.sendall('\r\n'.join([*lines, '', '']).encode())
        self.status = int(self._file.readline().split()[1])
        while self._file.readline().strip():
            pass

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        self._connection.close()

    def send(self, message: str | bytes) -> None:
        """Send a text or bytes."""
        content = message if isinstance(message, bytes) else message.encode()
        head = bytes([0x82 if isinstance(message, bytes) else 0x81])
        length = len(content)
        mask = bytes(4)  # It changes nothing.
        size = bytes([0x80 | length]) if length < 126 else b'\xff' + length.to_bytes(8)
        with suppress(ConnectionError):  # The server has ended the connection.
            self._connection.sendall(head + size + mask + content)

    def receive(self) -> Any:
        """Return the document of the next message; None at the end."""
        while True:
            try:
                head = self._file.read(2)
            except ConnectionError:
                return None
            if len(head) < 2:
                return None
            length = head[1] & 0x7F
            if length > 125:
                length = int.from_bytes(self._file.read(2 if length == 126 else 8))
            content = self._file.read(length)
            if head[0] & 0xF == 8:
                self.closed = int.from_bytes(content[:2]), content[2:].decode()
                return None
            if head[0] & 0xF == 1:
                return json.loads(content)

    def receive_all(self) -> None:
        """Receive until the server ends the connection."""
        while self.receive() is not None:
            pass


@contextmanager
def serving(*, read_only: bool = False, history: Path | None = None) -> Iterator[Served]:
    """A server on a free port, in a thread of its own."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()

    def run(work: Callable[[], Any]) -> Any:
        async def call() -> Any:
            return work()

        return asyncio.run_coroutine_threadsafe(call(), loop).result(TIMEOUT_S)

    board, operator = Board(time.time_ns, history), RecordingOperator()
    changes: list[int] = []

    def start() -> tuple[DashboardServer, int]:
        server = DashboardServer(
            board,
            operator,
            ServerOptions('127.0.0.1', 0, read_only),
            lambda: changes.append(len(server.pages.sockets)),
        )
        return server, server.start()

    server, port = run(start)
    try:
        yield Served(board, operator, port, server, run, changes)
    finally:
        asyncio.run_coroutine_threadsafe(server.stop(), loop).result(TIMEOUT_S)
        asyncio.run_coroutine_threadsafe(board.history.close(), loop).result(TIMEOUT_S)
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()
