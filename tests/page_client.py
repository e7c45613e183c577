"""A page of `dyknow dashboard` without a browser, which keeps all formulas open."""

from __future__ import annotations

import asyncio
import json
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Event, Thread
from typing import Any

from tornado.websocket import websocket_connect

MAX_OPEN = 5


@contextmanager
def open_page(address: str) -> Iterator[None]:
    """Keep a page open, given the address of the server."""
    stopped = Event()
    thread = Thread(target=lambda: asyncio.run(_keep_open(address, stopped)), daemon=True)
    thread.start()
    try:
        yield
    finally:
        stopped.set()
        thread.join()


def receive(
    address: str, view: str, name: str, wanted: Callable[[Any], bool], limit_s: float = 60.0
) -> Any:
    """Return the first message that is wanted by a page which opens a formula, given its name."""
    return asyncio.run(asyncio.wait_for(_receive(address, view, name, wanted), limit_s))


def post(address: str, action: str, **document: Any) -> int:
    """Send a request of a page, and return the status of the answer."""
    request = urllib.request.Request(  # noqa: S310 - our own server
        f'{address.rstrip("/")}/api/{action}',
        json.dumps(document).encode(),
        {'Content-Type': 'application/json'},
    )
    try:
        with urllib.request.urlopen(request) as answer:  # noqa: S310
            return int(answer.status)
    except urllib.error.HTTPError as error:
        with error:
            return error.code


async def _receive(address: str, view: str, name: str, wanted: Callable[[Any], bool]) -> Any:
    connection = await websocket_connect(_socket(address))
    try:
        await connection.write_message(json.dumps({'view': view, 'opened': []}))
        while not wanted(document := json.loads(await connection.read_message() or '{}')):
            rows = document['rows'] if document['type'] == 'formulas' else ()
            if keys := [each['id'] for each in rows if each['name'] == name]:
                await connection.write_message(json.dumps({'view': view, 'opened': keys}))
        return document
    finally:
        await _close(connection)


def _socket(address: str) -> str:
    return f'{address.rstrip("/").replace("http", "ws", 1)}/live'


async def _keep_open(address: str, stopped: Event) -> None:
    connection = await websocket_connect(_socket(address))
    while not stopped.is_set():
        with suppress(TimeoutError):
            message = await asyncio.wait_for(connection.read_message(), 1.0)
            if message is None:
                return
            document = json.loads(message)
            rows = document['rows'] if document['type'] == 'formulas' else ()
            keys = [each['id'] for each in rows]
            if keys:
                shown = {'view': 'formulas', 'opened': keys[:MAX_OPEN]}
                await connection.write_message(json.dumps(shown))
    await _close(connection)


async def _close(connection: Any) -> None:
    connection.close()
    while await connection.read_message() is not None:
        pass
