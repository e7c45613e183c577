"""The server of the page: what it sends, and that every bad request gets a 4xx."""

from __future__ import annotations

import asyncio
import gc
import json
import re
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from importlib import resources
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from served import TIMEOUT_S, PageConnection, Served, serving

from dyknow_coordinator import EvaluationPhase, EvaluationStatus
from dyknow_dashboard.errors import DashboardError
from dyknow_dashboard.model.board import Board
from dyknow_dashboard.model.metrics import CONTENT_TYPE
from dyknow_dashboard.server.requests import RateLimit, is_loopback, is_own_host, is_same_origin
from dyknow_dashboard.server.serving import (
    MAX_BODY,
    MAX_FRAME,
    MAX_HEADERS,
    MAX_PAGES,
    DashboardServer,
    ServerOptions,
)

pytestmark = pytest.mark.long

RUNNING = EvaluationStatus('power', 'always p', EvaluationPhase.RUNNING, started=0)
ASKED = {'formula': 'true', 'name': '', 'every_state': False, 'margin': False, 'timeout_s': 1}


@pytest.fixture
def served() -> Iterator[Served]:
    with serving() as running:
        yield running


def test_the_files_of_the_page(served: Served) -> None:
    status, headers, page = served.request('GET', '/')
    assert status == 200
    assert headers['Content-Type'] == 'text/html; charset=utf-8'
    assert "default-src 'none'" in headers['Content-Security-Policy']
    assert "script-src 'self';" in headers['Content-Security-Policy']
    assert headers['X-Content-Type-Options'] == 'nosniff'
    assert 'Tornado' not in headers['Server']
    for name in re.findall(r'(?:src|href)="([^"]+)"', page.decode()):
        status, headers, content = served.request('GET', f'/{name}')
        assert (status, bool(content)) == (200, True), name


def test_metrics_are_served_and_all_reports_read_from_then_on(served: Served) -> None:
    served.run(lambda: served.board.formulas.update([RUNNING], 1))
    assert not served.server.pages.are_open
    for _ in range(2):
        status, headers, content = served.request('GET', '/metrics')
        assert (status, headers['Content-Type']) == (200, CONTENT_TYPE)
        assert b'dyknow_formula_failing{formula="power"} 0.0\n' in content
    assert served.server.pages.are_open
    assert len(served.changes) == 1


def test_a_check_has_all_reports_read_from_then_on(served: Served) -> None:
    for _ in range(2):
        assert served.post('check', {'text': 'p', 'cursor': 1})[0] == 200
    assert served.server.pages.are_open
    assert len(served.changes) == 1


def test_the_page_draws_with_the_code_of_the_report(served: Served) -> None:
    pictures = resources.files('dyknow_recordings.reporting.pictures')
    _, _, drawing = served.request('GET', '/drawing.js')
    assert drawing == pictures.joinpath('drawing.js').read_bytes()


def test_no_code_in_the_page_itself() -> None:
    page = resources.files('dyknow_dashboard.page')
    text = page.joinpath('index.html').read_text(encoding='utf-8')
    assert not re.search(r'<script(?![^>]* src=)|\son\w+=|style=', text)
    for each in page.iterdir():
        if each.name.endswith('.js'):
            script = each.read_text(encoding='utf-8')
            assert not re.search(r'innerHTML|outerHTML|insertAdjacentHTML|eval\(', script), each


@pytest.mark.parametrize(
    ('method', 'path', 'headers', 'expected'),
    [
        ('GET', '/nothing', {}, 404),
        ('GET', '/../../etc/passwd', {}, 404),
        ('GET', '/page.css', {}, 404),
        ('POST', '/', {}, 405),
        ('GET', '/api/ask', {}, 405),
        ('DELETE', '/api/ask', {}, 405),
        ('BREW', '/', {}, 405),
        ('POST', '/api/ask', {}, 415),
        ('POST', '/api/ask', {'Content_Type': 'text/plain'}, 415),
        ('GET', '/', {'Host': 'evil.example'}, 403),
        ('GET', '/', {'Host': 'localhost.evil.example'}, 403),
        ('GET', '/', {'Host': None}, 400),
        ('GET', '/', {'Host': ''}, 403),
        ('GET', '/', {'Host': '[::1'}, 403),
        ('POST', '/api/ask', {'Origin': 'http://evil.example'}, 403),
        ('POST', '/api/ask', {'Origin': 'null'}, 403),
        ('GET', '/live', {}, 400),
        ('GET', '/live', {'Host': 'evil.example'}, 403),
    ],
)
def test_refused_requests(
    served: Served, method: str, path: str, headers: dict[str, Any], expected: int
) -> None:
    status, _, body = served.request(method, path, **headers)
    assert status == expected
    assert b'Traceback' not in body


def test_names_of_this_machine(served: Served) -> None:
    for host in (f'localhost:{served.port}', f'LOCALHOST:{served.port}', '[::1]:80', '10.0.0.3'):
        assert served.request('GET', '/', Host=host)[0] == 200, host


@pytest.mark.parametrize(
    ('content', 'expected'),
    [
        (b'nonsense\r\n\r\n', b'400'),
        (b'GET / HTTP/1.1\r\nHost 127.0.0.1\r\n\r\n', b'400'),
        (b'GET / HTTP/1.1\r\nX: ' + b'x' * MAX_HEADERS + b'\r\n\r\n', b''),
        (
            f'POST /api/ask HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: {MAX_BODY + 1}\r\n'
            '\r\n'.encode(),
            b'400',
        ),
        (b'POST /api/ask HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: -3\r\n\r\n', b'400'),
    ],
)
def test_requests_that_are_no_http(served: Served, content: bytes, expected: bytes) -> None:
    received = served.exchange(content)
    assert expected in received.partition(b'\r\n')[0]
    assert b'Traceback' not in received
    assert served.request('GET', '/')[0] == 200


@pytest.mark.parametrize(
    ('action', 'document', 'expected', 'message'),
    [
        ('ask', b'{', 400, 'the request is not JSON'),
        ('ask', {}, 400, "lacks 'formula'"),
        ('ask', {**ASKED, 'formula': ' '}, 400, 'the formula is empty'),
        ('ask', {**ASKED, 'formula': 'always ('}, 400, 'formula:1:9: unexpected end'),
        ('ask', {**ASKED, 'formula': 'nothing.x < 1'}, 404, 'no stream carries nothing'),
        ('ask', {**ASKED, 'formula': 'x' * 20_000}, 400, 'takes at most 10000'),
        ('cancel', {'name': 'other'}, 404, "there is no evaluation 'other'"),
        ('cancel', {'name': ''}, 400, "'name' is empty"),
        ('save', {'name': 'power'}, 503, 'no recorder has power'),
        ('check', {'text': 'a', 'cursor': 9}, 400, "'cursor' is 9, outside the text"),
        ('restart', {}, 404, 'there is no such request'),
    ],
)
def test_refused_actions(
    served: Served, action: str, document: Any, expected: int, message: str
) -> None:
    status, answer = served.post(action, document)
    assert status == expected
    assert message in answer['error']


def test_actions(served: Served) -> None:
    assert served.post('ask', ASKED, Origin=f'http://{served.host}') == (200, {})
    assert [each.formula for each in served.operator.asked] == ['true']
    assert served.post('cancel', {'name': 'power'}) == (200, {'cancelled': 1})
    status, found = served.post('check', {'text': 'alw', 'cursor': 3})
    assert status == 200
    assert [each['text'] for each in found['proposals']] == ['always']


def test_a_read_only_page() -> None:
    with serving(read_only=True) as served:
        for action, document in (('ask', ASKED), ('cancel', {'name': 'power'})):
            assert served.post(action, document)[0] == 403
        assert served.post('check', {'text': 'true', 'cursor': 4})[0] == 200
        assert not served.operator.asked


def test_too_many_requests(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    # While the clock stands, any machine asks for more than the limit allows at once.
    allows = RateLimit.allows
    monkeypatch.setattr(RateLimit, 'allows', lambda limit, _: allows(limit, 0.0))
    found = {served.post('check', {'text': 'a', 'cursor': 1})[0] for _ in range(100)}
    assert found == {200, 429}
    assert served.request('GET', '/')[0] == 200


@given(st.binary(max_size=300))
def test_any_bytes_get_a_4xx_or_a_closed_connection(served: Served, content: bytes) -> None:
    received = served.exchange(content + b'\r\n\r\n')
    assert not received or received.startswith(b'HTTP/1.1 4')


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_page_receives_what_changes(served: Served) -> None:
    with PageConnection(served, Origin=f'http://{served.host}') as page:
        assert page.status == 101
        expected = ['hello', 'formulas', 'nodes', 'history']
        assert [page.receive()['type'] for _ in expected] == expected
        served.run(lambda: served.board.formulas.update([], 1))
        assert page.receive()['type'] == 'formulas'
        page.send(json.dumps({'view': 'graph', 'opened': []}))
        assert page.receive()['type'] == 'graph'
    until(lambda: served.changes[-1] == 0)
    assert served.changes[0] == 1


@pytest.mark.parametrize(
    'message',
    ['{', '[]', '{"view": "map", "opened": []}', '{"view": "graph"}', b'\xff\xfe', 'x' * 1000],
)
def test_a_wrong_message_ends_the_connection(served: Served, message: str | bytes) -> None:
    with PageConnection(served) as page:
        page.send(message)
        page.receive_all()
        assert page.closed is not None
        code, reason = page.closed
        assert code == 1008
        assert reason


def test_an_oversized_frame_ends_the_connection(served: Served) -> None:
    with PageConnection(served) as page:
        page.send('x' * (MAX_FRAME + 1))
        page.receive_all()
    until(lambda: not served.server.pages.sockets)


def test_too_many_messages_end_the_connection(served: Served) -> None:
    with PageConnection(served) as page:
        for _ in range(200):
            page.send(json.dumps({'view': 'graph', 'opened': []}))
        page.receive_all()
    until(lambda: not served.server.pages.sockets)


def test_a_page_of_another_site_gets_no_socket(served: Served) -> None:
    for origin in ('http://evil.example', 'null', f'http://{served.host}.evil.example'):
        with PageConnection(served, Origin=origin) as page:
            assert page.status == 403


def test_one_page_too_many(served: Served) -> None:
    with ExitStack() as stack:
        for _ in range(MAX_PAGES):
            assert stack.enter_context(PageConnection(served)).status == 101
        with PageConnection(served) as page:
            assert page.status == 503
    until(lambda: not served.server.pages.sockets)
    with PageConnection(served) as page:
        assert page.status == 101


def test_no_change_is_reported_after_the_stop(served: Served) -> None:
    with PageConnection(served) as page:
        assert page.receive()['type'] == 'hello'
        served.run(served.server.pages.close)
        page.receive_all()
    until(lambda: not served.server.pages.sockets)
    assert served.changes == [1]


def test_a_page_that_takes_nothing_costs_no_memory(served: Served) -> None:
    """The server waits until a page has taken what it was sent, and keeps nothing for it."""
    status = EvaluationStatus('x' * 500, 'true', EvaluationPhase.RUNNING, 1)
    many = [replace(status, started=number) for number in range(300)]
    with PageConnection(served) as page:
        assert page.receive()['type'] == 'hello'
        (socket_of_page,) = served.server.pages.sockets

        def change() -> int:
            served.board.formulas.update(many, 1)
            return len(socket_of_page.ws_connection.stream._write_buffer)

        end = time.monotonic() + 12
        sizes = []
        while time.monotonic() < end and len(sizes) < 40:
            sizes.append(served.run(change))
            time.sleep(0.25)
        assert max(sizes) < 2_000_000, 'about two reports'


def test_a_port_that_is_taken(served: Served) -> None:
    options = ServerOptions('127.0.0.1', served.port)

    async def start() -> None:
        DashboardServer(Board(lambda: 0), served.operator, options, lambda: None).start()

    with pytest.raises(DashboardError, match=r'cannot listen on 127.0.0.1:\d+: .*--port'):
        asyncio.run(start())
    # tornado leaves the socket to the garbage collector.
    with warnings.catch_warnings(action='ignore'):
        gc.collect()


def test_hosts_and_origins() -> None:
    assert is_own_host('127.0.0.1:80', frozenset())
    assert is_own_host('robot:80', frozenset({'robot'}))
    assert not is_own_host('robot.evil.example', frozenset({'robot'}))
    assert is_same_origin(None, 'robot')
    assert is_same_origin('https://robot:80', 'Robot:80')
    assert not is_same_origin('http://robot:81', 'robot:80')
    assert not is_same_origin('file://robot:80', 'robot:80')
    assert [
        each for each in ('127.0.0.1', 'localhost', '::1', '10.0.0.3') if is_loopback(each)
    ] == [
        '127.0.0.1',
        'localhost',
        '::1',
    ]


def test_the_rate_of_requests() -> None:
    limit = RateLimit(2.0, 3)
    assert [limit.allows(10.0) for _ in range(4)] == [True, True, True, False]
    assert [limit.allows(10.5) for _ in range(2)] == [True, False]
    assert not limit.allows(9.0), 'a clock that goes back gives nothing'
