"""Requests of pages over HTTP: the files of the page, and what an operator asks for.

Every fault of a request is answered with a status of 400 to 499 (or 503, 504 when a node is at
fault) and a message, never with a traceback.

Requests are served from pages of this server alone, and not too many. A page of another site, open
in the operator's browser, can send requests to this server, too. It cannot hide where it is from:

- A request across sites has its site in `Origin`, which differs from `Host`.
- A name that an attacker lets point to 127.0.0.1 (DNS rebinding) is in `Host`. Only names of this
  machine, and addresses, are accepted there.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial
from ipaddress import ip_address
from typing import Any, Final, Protocol
from urllib.parse import urlsplit

from tornado.ioloop import IOLoop
from tornado.web import HTTPError, RequestHandler

from dyknow_common import DyKnowError, ExitCode
from dyknow_dashboard.model.board import Board
from dyknow_dashboard.model.history import MAX_FAILURES, acknowledge, clear, failures, junit
from dyknow_dashboard.model.requests import (
    MAX_IDS,
    AskedFormula,
    acknowledgement,
    asked_formula,
    evaluation_name,
    failure_ids,
    history_query,
    read_document,
    typed_text,
)
from dyknow_dashboard.model.typed_formulas import check, proposals

_POLICY: Final = (
    "default-src 'none'",
    "script-src 'self'",
    # plotly sets styles of its elements.
    "style-src 'self' 'unsafe-inline'",
    "img-src 'self' data:",
    "connect-src 'self'",
    "base-uri 'none'",
    "form-action 'none'",
    "frame-ancestors 'none'",
)

HEADERS: Final[Mapping[str, str]] = {
    'Content-Security-Policy': '; '.join(_POLICY),
    'X-Content-Type-Options': 'nosniff',
    'X-Frame-Options': 'DENY',
    'Referrer-Policy': 'no-referrer',
    'Cross-Origin-Opener-Policy': 'same-origin',
    'Cross-Origin-Resource-Policy': 'same-origin',
    'Cache-Control': 'no-cache',
    'Server': 'dyknow',
}
"""The headers of all responses."""

_STATUSES: Final = {
    ExitCode.INVALID_ARGUMENT: 400,
    ExitCode.NOT_FOUND: 404,
    ExitCode.ALREADY_EXISTS: 409,
    ExitCode.UNAVAILABLE: 503,
    ExitCode.TIMEOUT: 504,
}
"""The HTTP statuses of errors; all others have 422."""

_CHANGING: Final = frozenset({'ask', 'cancel', 'save', 'acknowledge', 'clear'})


def is_own_host(host: str, names: Collection[str]) -> bool:
    """Return True if a header `Host` names this machine, by an address or one of its names."""
    try:
        name = urlsplit(f'//{host}').hostname or ''
    except ValueError:
        return False
    return name in names or _is_address(name)


def is_same_origin(origin: str | None, host: str) -> bool:
    """Return True if a request was sent by a page of this server, or by no page at all."""
    if origin is None:
        return True
    try:
        parts = urlsplit(origin)
    except ValueError:
        return False
    return parts.scheme in {'http', 'https'} and parts.netloc.lower() == host.lower()


def is_loopback(host: str) -> bool:
    """Return True if only this machine can reach an address or name that a server listens on."""
    return host == 'localhost' or (_is_address(host) and ip_address(host).is_loopback)


def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


class RateLimit:
    """A limit of the number of requests: a bucket of tokens that fills at a constant rate.

    Args:
        rate: requests per second in the long run.
        burst: requests at once.
    """

    def __init__(self, rate: float, burst: int) -> None:
        self._rate = rate
        self._burst = float(burst)
        self._tokens = self._burst
        self._latest = 0.0

    def allows(self, now: float) -> bool:
        """Return whether a request at a time in seconds is within the limit, and count it."""
        elapsed = max(now - self._latest, 0.0)
        self._latest = now
        self._tokens = min(self._tokens + elapsed * self._rate, self._burst)
        if self._tokens < 1:
            return False
        self._tokens -= 1
        return True


class SystemOperator(Protocol):
    """Carries out what an operator asks for. All methods raise DyKnowError if that fails."""

    async def ask(self, asked: AskedFormula) -> None:
        """Have a formula monitored."""

    async def cancel(self, name: str) -> int:
        """End the evaluations of a name, and return their number."""

    async def save(self, name: str) -> list[str]:
        """Save black boxes of a formula, or of all, and return the paths of the bags."""


@dataclass(frozen=True, slots=True)
class ServedSystem:
    """The subjects of requests.

    Args:
        board: the state of the system.
        operator: changes it.
        names: the names of this machine, in the header `Host`.
        limit: the limit of requests.
        read_only: True if pages may change nothing.
        read_all: has all reports read from then on.
    """

    board: Board
    operator: SystemOperator
    names: frozenset[str]
    limit: RateLimit
    read_only: bool
    read_all: Callable[[], None]


class GuardedHandler(RequestHandler):
    """The base of all handlers: the headers of responses, and errors as JSON."""

    system: ServedSystem

    def initialize(self, system: ServedSystem) -> None:
        """Take the arguments of the route."""
        self.system = system

    def set_default_headers(self) -> None:
        """Set the headers of all responses."""
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        """Refuse what a page of another site may have sent."""
        host = self.request.host
        if not is_own_host(host, self.system.names):
            raise HTTPError(403, reason='the header Host does not name this machine')
        if not is_same_origin(self.request.headers.get('Origin'), host):
            raise HTTPError(403, reason='the request comes from another site')

    def check_rate(self) -> None:
        """Refuse one request too many."""
        if not self.system.limit.allows(IOLoop.current().time()):
            raise HTTPError(429, reason='too many requests; wait a second')

    def finish_error(self, error: DyKnowError) -> None:
        """Send the status and the reason of an error."""
        self.set_status(_STATUSES.get(error.code, 422))
        self.finish({'error': error.message})

    def write_error(self, *_: Any, **__: Any) -> None:
        """Send the reason of an error."""
        self.finish({'error': self._reason})

    def log_exception(self, typ: Any, value: Any, tb: Any) -> None:
        """Print the traceback of a fault of ours, and nothing about requests that are refused."""
        if not isinstance(value, HTTPError):
            super().log_exception(typ, value, tb)


class MissingHandler(GuardedHandler):
    """Refuses unknown paths."""

    def prepare(self) -> None:
        """Refuse the request."""
        super().prepare()
        raise HTTPError(404, reason='there is no such page')


class FileHandler(GuardedHandler):
    """Serves a file of the page."""

    def initialize(  # type: ignore[override]
        self, system: ServedSystem, kind: str, content: Callable[[], bytes]
    ) -> None:
        """Take the arguments of the route: its type, and the function that reads it."""
        super().initialize(system)
        self._kind, self._content = kind, content

    def get(self) -> None:
        """Send the file."""
        self.set_header('Content-Type', self._kind)
        self.finish(self._content())

    head = get


class ActionHandler(GuardedHandler):
    """Carries out a request with a document of JSON."""

    def prepare(self) -> None:
        """Refuse what a page of ours does not send."""
        super().prepare()
        if self.request.method != 'POST':
            raise HTTPError(405)
        kind = self.request.headers.get('Content-Type', '').partition(';')[0].strip().lower()
        if kind != 'application/json':
            raise HTTPError(415, reason='the request is not application/json')
        self.check_rate()

    async def post(self, action: str) -> None:
        """Carry out the request."""
        work = ACTIONS.get(action)
        if work is None:
            raise HTTPError(404, reason='there is no such request')
        if self.system.read_only and action in _CHANGING:
            raise HTTPError(403, reason='the page is read-only (--read-only)')
        try:
            self.finish(await work(self.system, read_document(self.request.body)))
        except DyKnowError as error:
            self.finish_error(error)


class HistoryHandler(GuardedHandler):
    """Sends failures of the history, as JSON or as a report of JUnit."""

    async def get(self, form: str) -> None:
        """Send them."""
        self.check_rate()
        history = self.system.board.history
        arguments = {name: self.get_query_argument(name) for name in self.request.query_arguments}
        try:
            if form == 'junit':
                query = history_query(arguments, MAX_FAILURES)
                self.set_header('Content-Type', 'application/xml; charset=utf-8')
                self.finish(await history.do(partial(junit, query=query)))
                return
            query = history_query(arguments, MAX_IDS)
            found = await history.do(partial(failures, query=query))
            more = found[-1]['id'] if found and len(found) == query.limit else None
            self.finish({'failures': found, 'next': more})
        except DyKnowError as error:
            self.finish_error(error)


async def _check(system: ServedSystem, document: Mapping[str, Any]) -> dict[str, Any]:
    system.read_all()  # The ontology is known soon, also without an open page.
    typed, knowledge = typed_text(document), system.board.concepts.knowledge
    found = check(typed.text, knowledge)
    return {**found, 'proposals': proposals(typed.text, typed.cursor, knowledge)}


async def _ask(system: ServedSystem, document: Mapping[str, Any]) -> dict[str, Any]:
    asked = asked_formula(document)
    fault = check(asked.formula, None).get('fault')
    if fault or not asked.formula.strip():
        raise DyKnowError(fault or 'the formula is empty')
    await system.operator.ask(asked)
    return {}


async def _cancel(system: ServedSystem, document: Mapping[str, Any]) -> dict[str, Any]:
    return {'cancelled': await system.operator.cancel(evaluation_name(document))}


async def _save(system: ServedSystem, document: Mapping[str, Any]) -> dict[str, Any]:
    name = evaluation_name(document, allow_empty=True)
    return {'paths': await system.operator.save(name)}


async def _acknowledge(system: ServedSystem, document: Mapping[str, Any]) -> dict[str, Any]:
    ids, by = acknowledgement(document)
    work = partial(acknowledge, ids=ids, by=by, now=system.board.clock())
    return {'acknowledged': await system.board.history.do(work)}


async def _clear(system: ServedSystem, document: Mapping[str, Any]) -> dict[str, Any]:
    work = partial(clear, ids=failure_ids(document))
    return {'cleared': await system.board.history.do(work)}


_Work = Callable[[ServedSystem, Mapping[str, Any]], Awaitable[dict[str, Any]]]

ACTIONS: Final[Mapping[str, _Work]] = {
    'check': _check,
    'ask': _ask,
    'cancel': _cancel,
    'save': _save,
    'acknowledge': _acknowledge,
    'clear': _clear,
}
"""The requests by POST, with what carries them out."""
