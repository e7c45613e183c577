"""The server: its routes, its socket and its limits."""

from __future__ import annotations

import socket
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Final

from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.web import Application

from dyknow_common import ExitCode
from dyknow_dashboard.errors import DashboardError
from dyknow_dashboard.model.board import Board
from dyknow_dashboard.model.metrics import CONTENT_TYPE
from dyknow_dashboard.server.guards import RateLimit
from dyknow_dashboard.server.pages import MAX_FRAME, OpenPages, PageSocket
from dyknow_dashboard.server.requests import (
    ActionHandler,
    FileHandler,
    HistoryHandler,
    MissingHandler,
    ServedSystem,
    SystemOperator,
)
from dyknow_recordings.reporting.pictures.libraries import plotly_script

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
        system = ServedSystem(board, operator, names, RateLimit(20.0, 60), options.read_only)
        greeting = {'type': 'hello', 'read_only': options.read_only}
        self.pages = OpenPages(board, names, greeting, on_change)
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
    yield '/live', PageSocket, {'pages': pages}


@cache
def _plotly() -> bytes:
    return plotly_script().encode()
