"""The open pages, each with a WebSocket on which it receives what has changed.

A page gets the next changes only when it has taken the former ones, so a slow page misses reports,
and the server keeps nothing for it.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from typing import Any, Final

from tornado.httputil import HTTPServerRequest
from tornado.ioloop import IOLoop
from tornado.web import Application
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from dyknow_dashboard.errors import DashboardError
from dyknow_dashboard.model.board import Board, PageState
from dyknow_dashboard.model.metrics import metrics_of
from dyknow_dashboard.model.requests import interest, read_document
from dyknow_dashboard.server.guards import HEADERS, RateLimit, is_own_host, is_same_origin

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
        names: of this machine, in the header `Host`.
        greeting: the first message to each page.
        on_change: called when pages come, go or show something else.
    """

    def __init__(
        self,
        board: Board,
        names: frozenset[str],
        greeting: dict[str, Any],
        on_change: Callable[[], None],
    ) -> None:
        self.board = board
        self.names = names
        self.greeting = greeting
        self.on_change = on_change
        self.sockets: set[PageSocket] = set()
        self.has_scraper = False
        """True once metrics were asked for: then all reports are read, as for an open page."""

    @property
    def states(self) -> list[PageState]:
        """The state and view of each page."""
        return [each.page for each in self.sockets]

    @property
    def are_open(self) -> bool:
        """True if all reports are needed."""
        return bool(self.sockets) or self.has_scraper

    def serve_metrics(self) -> bytes:
        """Return the metrics of all reports that were read; reports of formulas always are."""
        if not self.has_scraper:
            self.has_scraper = True
            self.on_change()
        return metrics_of(self.board)

    def close(self) -> None:
        """Close all connections."""
        for each in list(self.sockets):
            each.close(1001, 'the server stops')


class PageSocket(WebSocketHandler):
    """The connection of one page."""

    def __init__(
        self, application: Application, request: HTTPServerRequest, pages: OpenPages
    ) -> None:
        super().__init__(application, request)
        self.page = PageState()
        self._pages = pages
        self._limit = RateLimit(_RATE, _BURST)

    def set_default_headers(self) -> None:
        """Set the headers of a refusal."""
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        """Refuse a page of another site, and one too many."""
        if not is_own_host(self.request.host, self._pages.names):
            self.set_status(403)
            self.finish({'error': 'the header Host does not name this machine'})
        elif len(self._pages.sockets) >= MAX_PAGES:
            self.set_status(503)
            self.finish({'error': f'{MAX_PAGES} pages are open already; close one'})

    def check_origin(self, origin: str) -> bool:
        """Return True for a page of this server."""
        return is_same_origin(origin, self.request.host)

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
