"""The server: its routes, its socket, its limits and its open pages.

Each page has a WebSocket on which it receives changes. It gets the next changes only after it has
taken the former ones. So a slow page misses reports, and the server keeps nothing for it.
"""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Final

from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from dyknow_common import ExitCode
from dyknow_dashboard.errors import DashboardError
from dyknow_dashboard.model.board import Board, PageState
from dyknow_dashboard.model.metrics import CONTENT_TYPE, metrics_of
from dyknow_dashboard.model.requests import interest, read_document
from dyknow_dashboard.server.requests import (
    ActionHandler,
    FileHandler,
    GuardedHandler,
    HistoryHandler,
    MissingHandler,
    RateLimit,
    ServedSystem,
    SystemOperator,
)
from dyknow_recordings.reporting.pictures.page import plotly_script

MAX_BODY: Final = 131_072
MAX_HEADERS: Final = 16_384
TIMEOUT_S: Final = 30.0
"""The time for which a connection may be idle, or send a request."""

PING_S: Final = 10.0
"""The time between two pings, by which a page that is gone is noticed."""

_PICTURES: Final = 'dyknow_recordings.reporting.pictures'
_PAGE: Final = 'dyknow_dashboard.page'

_CODE: Final = ('alarms', 'ask', 'dashboard', 'elements', 'formulas', 'graph', 'history', 'tables')

_FILES: Final = (
    ('/', _PAGE, 'index.html', 'text/html; charset=utf-8'),
    ('/report.css', _PICTURES, 'page.css', 'text/css; charset=utf-8'),
    ('/drawing.js', _PICTURES, 'drawing.js', 'text/javascript; charset=utf-8'),
    ('/dashboard.css', _PAGE, 'dashboard.css', 'text/css; charset=utf-8'),
    *((f'/{name}.js', _PAGE, f'{name}.js', 'text/javascript; charset=utf-8') for name in _CODE),
    ('/openapi.json', _PAGE, 'openapi.json', 'application/json'),
    ('/icon.svg', _PAGE, 'icon.svg', 'image/svg+xml'),
)
"""The paths of the files of the page, with their packages, names and types."""

MAX_PAGES: Final = 16
"""The number of pages that are served at a time."""

MAX_FRAME: Final = 32_768
"""The number of bytes in a message of a page."""

PERIOD_S: Final = 0.2
"""The least time between two messages of a kind to a page."""

_RATE, _BURST = 10.0, 40

_POLICY_VIOLATION: Final = 1008


class OpenPages:
    """All open pages.

    Args:
        board: what they show.
        greeting: the first message to each page.
        on_change: called when pages come, go or show something else.
    """

    def __init__(
        self,
        board: Board,
        greeting: dict[str, Any],
        on_change: Callable[[], None],
    ) -> None:
        self.board = board
        self.greeting = greeting
        self.on_change = on_change
        self.sockets: set[PageSocket] = set()
        self._reads_all = False

    @property
    def states(self) -> list[PageState]:
        """The state and view of each page."""
        return [each.page for each in self.sockets]

    @property
    def are_open(self) -> bool:
        """True if all reports are needed."""
        return bool(self.sockets) or self._reads_all

    def read_all(self) -> None:
        """Read all reports from now on, as for an open page: other programs ask for them."""
        if not self._reads_all:
            self._reads_all = True
            self.on_change()

    def serve_metrics(self) -> bytes:
        """Return the metrics of all reports that were read; reports of formulas always are."""
        self.read_all()
        return metrics_of(self.board)

    def close(self) -> None:
        """Close all connections, and report no change any more."""
        self.on_change = lambda: None
        for each in list(self.sockets):
            each.close(1001, 'the server stops')


class PageSocket(GuardedHandler, WebSocketHandler):
    """The connection of one page."""

    def initialize(self, system: ServedSystem, pages: OpenPages) -> None:  # type: ignore[override]
        """Take the arguments of the route."""
        super().initialize(system)
        self.page, self._pages = PageState(), pages
        self._limit = RateLimit(_RATE, _BURST)

    def prepare(self) -> None:
        """Refuse a page of another site, and one too many."""
        super().prepare()
        if len(self._pages.sockets) >= MAX_PAGES:
            raise HTTPError(503, reason=f'{MAX_PAGES} pages are open already; close one')

    def open(self, *_: str, **__: str) -> None:
        """Begin to send changes."""
        self._pages.sockets.add(self)
        self._pages.on_change()
        IOLoop.current().spawn_callback(self._send_changes)

    def on_message(self, message: str | bytes) -> None:
        """Use what the page shows now; a message that is wrong ends the connection."""
        if not self._limit.allows(IOLoop.current().time()):
            self.close(_POLICY_VIOLATION, 'too many messages')
            return
        try:
            self.page.show(interest(read_document(message)))
        except DashboardError as error:
            # The reason in the frame that closes a connection has at most 123 bytes.
            self.close(_POLICY_VIOLATION, error.message.encode()[:120].decode(errors='ignore'))
            return
        self._pages.on_change()

    def on_close(self) -> None:
        """Forget the page."""
        self._pages.sockets.discard(self)
        self._pages.on_change()

    async def _send_changes(self) -> None:
        try:
            await self.write_message(json.dumps(self._pages.greeting))
            while self in self._pages.sockets:
                for each in list(self._pages.board.changes(self.page)):
                    await self.write_message(json.dumps(each, allow_nan=False))
                await asyncio.sleep(PERIOD_S)
        except WebSocketClosedError:
            pass


@dataclass(frozen=True, slots=True)
class ServerOptions:
    """The address and options of the server.

    Args:
        host: the address or name to listen on.
        port: 0 for any free one.
        read_only: True if pages may change nothing.
    """

    host: str
    port: int
    read_only: bool = False


class DashboardServer:
    """Serves the page.

    Args:
        board: what it shows.
        operator: carries out what pages ask for.
        options: where and how.
        on_change: called when pages come, go or show something else.
    """

    def __init__(
        self,
        board: Board,
        operator: SystemOperator,
        options: ServerOptions,
        on_change: Callable[[], None],
    ) -> None:
        names = frozenset({'localhost', options.host.lower(), socket.gethostname().lower()})
        greeting = {'type': 'hello', 'read_only': options.read_only}
        self.pages = OpenPages(board, greeting, on_change)
        limit, read_all = RateLimit(20.0, 60), self.pages.read_all
        system = ServedSystem(board, operator, names, limit, options.read_only, read_all)
        self._options = options
        self._server = HTTPServer(
            Application(
                list(_routes(system, self.pages)),
                default_handler_class=MissingHandler,
                default_handler_args={'system': system},
                websocket_max_message_size=MAX_FRAME,
                websocket_ping_interval=PING_S,
                log_function=lambda _: None,
            ),
            max_body_size=MAX_BODY,
            max_header_size=MAX_HEADERS,
            idle_connection_timeout=TIMEOUT_S,
            body_timeout=TIMEOUT_S,
        )

    def start(self) -> int:
        """Listen, and return the port.

        Raises:
            DashboardError: naming the mend, if the address cannot be used.
        """
        host, port = self._options.host, self._options.port
        try:
            sockets = bind_sockets(port, host)
        except OSError as error:
            raise DashboardError(
                f'cannot listen on {host}:{port}: {error.strerror or error}; choose another one by '
                '--host and --port',
                ExitCode.UNAVAILABLE,
            ) from None
        self._server.add_sockets(sockets)
        return int(sockets[0].getsockname()[1])

    async def stop(self) -> None:
        """Close all connections."""
        self._server.stop()
        self.pages.close()
        await self._server.close_all_connections()


def _routes(system: ServedSystem, pages: OpenPages) -> Any:
    for path, package, name, kind in _FILES:
        content = resources.files(package).joinpath(name).read_bytes
        yield path, FileHandler, {'system': system, 'kind': kind, 'content': content}
    kind = 'text/javascript; charset=utf-8'
    yield '/plotly.js', FileHandler, {'system': system, 'kind': kind, 'content': _plotly}
    served = {'system': system, 'kind': CONTENT_TYPE, 'content': pages.serve_metrics}
    yield '/metrics', FileHandler, served
    yield '/api/(history|junit)', HistoryHandler, {'system': system}
    yield '/api/([a-z]+)', ActionHandler, {'system': system}
    yield '/live', PageSocket, {'system': system, 'pages': pages}


@cache
def _plotly() -> bytes:
    return plotly_script().encode()
