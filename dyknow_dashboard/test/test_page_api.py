"""The requests for the history over HTTP, and the description of all requests by OpenAPI."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
from served import PageConnection, Served, serving
from test_history import FAILED, LOST_STREAM

from dyknow_common import SECOND_NS
from dyknow_dashboard.model.requests import MAX_IDS
from dyknow_dashboard.server.requests import ACTIONS, RateLimit

API: Any = json.loads(
    resources.files('dyknow_dashboard.page').joinpath('openapi.json').read_text('utf-8')
)
KINDS: dict[str, tuple[type, ...]] = {
    'integer': (int,),
    'number': (int, float),
    'string': (str,),
    'boolean': (bool,),
    'array': (list,),
    'object': (dict,),
    'null': (type(None),),
}
ASKED = {'formula': 'true', 'name': '', 'every_state': False, 'margin': False, 'timeout_s': 1}
BODIES: dict[str, Any] = {
    'ask': ASKED,
    'cancel': {'name': 'power'},
    'save': {'name': 'saved'},
    'check': {'text': 'alw', 'cursor': 3},
    'acknowledge': {'ids': [1], 'by': 'Ada'},
    'clear': {'ids': [1]},
}


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    with serving(history=tmp_path / 'history.db') as running:
        running.run(lambda: running.board.report([FAILED, LOST_STREAM], 1))
        yield running


def get(served: Served, path: str) -> tuple[int, Any]:
    status, _, body = served.request('GET', path)
    return status, json.loads(body)


def resolved(schema: Any) -> Any:
    """Return what a reference refers to."""
    while '$ref' in schema:
        found = API
        for name in schema['$ref'].removeprefix('#/').split('/'):
            found = found[name]
        schema = found
    return schema


def faults(value: Any, schema: Any, place: str = '$') -> Iterator[str]:
    """Yield the differences between a value and what is documented of it, in both directions."""
    schema = resolved(schema)
    if 'oneOf' in schema:
        if all(list(faults(value, each, place)) for each in schema['oneOf']):
            yield f'{place} is none of them'
        return
    kinds = schema['type'] if isinstance(schema['type'], list) else [schema['type']]
    if type(value) not in {kind for each in kinds for kind in KINDS[each]}:
        yield f'{place} is {value!r}, no {kinds}'
    elif 'enum' in schema and value not in schema['enum']:
        yield f'{place} is {value!r}'
    elif isinstance(value, dict):
        documented = schema.get('properties', {})
        if value.keys() != documented.keys() or {*schema.get('required', ())} != value.keys():
            yield f'{place} has {sorted(value)}, documented are {sorted(documented)}'
        else:
            for name, each in value.items():
                yield from faults(each, documented[name], f'{place}.{name}')
    elif isinstance(value, list):
        for each in value:
            yield from faults(each, schema['items'], f'{place}[]')


def answer_of(path: str, method: str) -> Any:
    return API['paths'][path][method]['responses']['200']['content']['application/json']['schema']


def test_failures_are_read_page_by_page(served: Served) -> None:
    status, first = get(served, '/api/history?limit=1')
    assert status == 200
    assert [each['name'] for each in first['failures']] == ['speed']
    _, second = get(served, f'/api/history?limit=1&before={first["next"]}')
    assert [each['name'] for each in second['failures']] == ['power']
    _, last = get(served, f'/api/history?limit=1&before={second["next"]}')
    assert last == {'failures': [], 'next': None}
    _, both = get(served, '/api/history')
    assert both == {'failures': first['failures'] + second['failures'], 'next': None}


def test_failures_are_filtered(served: Served) -> None:
    now = time.time_ns()
    for query, expected in (
        ('name=POW', ['power']),
        ('name=%25', []),
        (f'from={now - 3600 * SECOND_NS}', ['speed', 'power']),
        (f'to={now - 3600 * SECOND_NS}', []),
    ):
        _, found = get(served, f'/api/history?{query}')
        assert [each['name'] for each in found['failures']] == expected, query
        status, headers, body = served.request('GET', f'/api/junit?{query}')
        assert (status, headers['Content-Type']) == (200, 'application/xml; charset=utf-8')
        assert body.count(b'<testcase') == len(expected)


@pytest.mark.parametrize(
    ('query', 'message'),
    [
        ('limit=1001', f"'limit' is no whole number up to {MAX_IDS}"),
        ('from=today', "'from' is no whole number up to 9223372036854775807"),
        ('before=-1', "'before' is no whole number"),
        ('to=' + '9' * 5000, "'to' is no whole number"),
        ('day=1', "unknown part 'day' (there are: before, from, limit, name, to)"),
    ],
)
def test_refused_queries(served: Served, query: str, message: str) -> None:
    status, answer = get(served, f'/api/history?{query}')
    assert status == 400
    assert message in answer['error']


@pytest.mark.parametrize(
    ('action', 'document', 'expected', 'message'),
    [
        ('acknowledge', {'ids': [1]}, 400, "lacks 'by'"),
        ('acknowledge', {'ids': [1], 'by': ' '}, 400, "'by' says who has seen them, in 1 to 100"),
        ('acknowledge', {'ids': [1], 'by': 'x' * 101}, 400, "'by' says who"),
        ('acknowledge', {'ids': [True], 'by': 'x'}, 400, "'ids' is not a list of the ids"),
        ('acknowledge', {'ids': [2**63], 'by': 'x'}, 400, "'ids' is not a list of the ids"),
        ('clear', {'ids': [1] * (MAX_IDS + 1)}, 400, f'of at most {MAX_IDS} failures'),
        ('clear', {'ids': [1]}, 409, "the failure 1 of 'power' is not acknowledged; acknowledge"),
    ],
)
def test_refused_changes(
    served: Served, action: str, document: Any, expected: int, message: str
) -> None:
    status, answer = served.post(action, document)
    assert status == expected
    assert message in answer['error']


def test_the_history_is_guarded_as_all_requests_are(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    evil = 'http://evil.example'
    assert served.post('clear', {'ids': [1]}, Origin=evil)[0] == 403
    for path in ('/api/history', '/api/junit', '/openapi.json'):
        assert served.request('GET', path, Host='evil.example')[0] == 403
        assert served.request('GET', path, Origin=evil)[0] == 403
        assert served.request('POST', path, b'{}')[0] == 405
    # While the clock stands, any machine asks for more than the limit allows at once.
    allows = RateLimit.allows
    monkeypatch.setattr(RateLimit, 'allows', lambda limit, _: allows(limit, 0.0))
    found = {served.request('GET', '/api/history')[0] for _ in range(100)}
    assert found == {200, 429}


def test_a_read_only_page_changes_no_history(tmp_path: Path) -> None:
    with serving(read_only=True, history=tmp_path / 'history.db') as served:
        assert served.post('acknowledge', {'ids': [1], 'by': 'Ada'})[0] == 403
        assert served.post('clear', {'ids': [1]})[0] == 403
        assert get(served, '/api/history')[0] == 200


def test_pages_are_told_of_changes(served: Served) -> None:
    with PageConnection(served) as page:
        states = iter(page.receive, None)
        states = (each for each in states if each['type'] == 'history')
        assert next(each for each in states if each['count'])['unacknowledged'] == 2
        assert served.post('acknowledge', {'ids': [1], 'by': ' Ada '}) == (200, {'acknowledged': 1})
        assert next(states)['unacknowledged'] == 1
    lines = served.request('GET', '/metrics')[2].decode().splitlines()
    assert 'dyknow_events_total{fate="written",place="history"} 2.0' in lines
    assert 'dyknow_history_failures{acknowledged="no"} 1.0' in lines


def test_the_page_works_without_a_history(tmp_path: Path) -> None:
    path = tmp_path / 'history.db'
    path.write_text('no database' * 100)
    with serving(history=path) as served:
        status, answer = get(served, '/api/history')
        assert status == 503
        assert 'it is damaged or of another kind: restore it from a backup' in answer['error']
        with PageConnection(served) as page:
            found = [page.receive() for _ in range(4)]
        assert [each['type'] for each in found] == ['hello', 'formulas', 'nodes', 'history']
        assert found[-1]['fault'] == answer['error']


def test_the_document_of_openapi_is_valid() -> None:
    validator = pytest.importorskip('openapi_spec_validator')
    validator.validate(API)


def test_all_paths_are_documented(served: Served) -> None:
    posted = {path.removeprefix('/api/') for path, each in API['paths'].items() if 'post' in each}
    assert posted == {*ACTIONS} == {*BODIES}
    read = [path for path, each in API['paths'].items() if 'get' in each]
    for path in read:
        status, headers, _ = served.request('GET', path)
        (kind,) = API['paths'][path]['get']['responses']['200']['content']
        assert (status, headers['Content-Type'].partition(';')[0]) == (200, kind.partition(';')[0])
    assert get(served, '/openapi.json') == (200, API)


@pytest.mark.parametrize('action', BODIES)
def test_all_fields_of_requests_are_documented(served: Served, action: str) -> None:
    operation = API['paths'][f'/api/{action}']['post']
    schema = resolved(operation['requestBody']['content']['application/json']['schema'])
    body = BODIES[action]
    assert list(faults(body, schema)) == []
    for name in schema['required']:
        lacking = {key: value for key, value in body.items() if key != name}
        status, answer = served.post(action, lacking)
        assert (status, f"lacks '{name}'" in answer['error']) == (400, True)
        assert list(faults(answer, resolved(operation['responses']['default'])['content'][
            'application/json']['schema'])) == []  # fmt: skip
    _, answer = served.post(action, {**body, 'extra': 1})
    assert f'(there are: {", ".join(sorted(schema["properties"]))})' in answer['error']
    if action == 'clear':
        served.post('acknowledge', BODIES['acknowledge'])
    status, answer = served.post(action, body)
    assert status == 200, answer
    assert list(faults(answer, answer_of(f'/api/{action}', 'post'))) == []


@pytest.mark.parametrize('path', ['/api/history', '/api/junit'])
def test_all_arguments_are_documented(served: Served, path: str) -> None:
    known = [resolved(each)['name'] for each in API['paths'][path]['get']['parameters']]
    _, answer = get(served, f'{path}?extra=1')
    assert f'(there are: {", ".join(sorted(known))})' in answer['error']
    for each in map(resolved, API['paths'][path]['get']['parameters']):
        greatest = each['schema'].get('maximum', 10)
        name = each['name']
        assert served.request('GET', f'{path}?{name}={greatest}')[0] == 200
        if 'maximum' in each['schema']:
            assert served.request('GET', f'{path}?{name}={greatest + 1}')[0] == 400


def test_all_fields_of_failures_are_documented(served: Served) -> None:
    served.post('acknowledge', {'ids': [1], 'by': 'Ada'})
    _, answer = get(served, '/api/history?limit=1')
    _, both = get(served, '/api/history')
    for each in (answer, both):
        assert list(faults(each, answer_of('/api/history', 'get'))) == []


@pytest.mark.parametrize(
    'document', [{'text': 'always (', 'cursor': 0}, {'text': 'always a.x < 3', 'cursor': 2}]
)
def test_answers_about_formulas_are_documented(served: Served, document: Any) -> None:
    status, answer = served.post('check', document)
    assert status == 200
    assert list(faults(answer, answer_of('/api/check', 'post'))) == []


@pytest.mark.parametrize('value', [{'failures': []}, {'failures': 3, 'next': None}, {'error': ''}])
def test_differences_are_found(value: Any) -> None:
    assert list(faults(value, answer_of('/api/history', 'get')))
