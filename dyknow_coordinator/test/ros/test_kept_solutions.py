"""Solutions of queries are kept as long as the ontology manager reports no change."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from types import SimpleNamespace
from typing import Any

import pytest

from dyknow_coordinator.ros import service_clients
from dyknow_coordinator.ros.service_clients import ServiceClients

SPARQL = 'SELECT ?a WHERE { ?a ?b ?c }'
Run = Coroutine[Any, Any, Any]


class OntologyManager:
    """An ontology manager whose answer to each query is the number of the query."""

    def __init__(self, *_: Any, **__: Any) -> None:
        self.name = 'ontology_manager'
        self.status = {'started at': '1', 'version': '1'}
        self.alive = True
        self.queries = 0
        self.before_answer: Callable[[], None] = lambda: None

    async def call(self, _: Any, sparql: str) -> Any:
        assert sparql == SPARQL
        self.queries += 1
        self.before_answer()
        return SimpleNamespace(variables=['a'], values=[str(self.queries)])


@pytest.fixture
def clients(monkeypatch: pytest.MonkeyPatch) -> ServiceClients:
    monkeypatch.setattr(service_clients, 'RemoteNode', OntologyManager)
    node: Any = SimpleNamespace(
        parameter=lambda _, default, __: default,
        get_namespace=lambda: '/',
        resolve_service_name=lambda name: f'/{name}',
        spawn=lambda function: finished(function()),
    )
    return ServiceClients(node, node)


def finished(run: Run) -> Any:
    """Run a coroutine that waits for nothing that does not happen while it runs."""
    while True:
        try:
            run.send(None)
        except StopIteration as end:
            return end.value


def test_a_solution_is_kept_until_a_change(clients: ServiceClients) -> None:
    manager: Any = clients.ontology_manager
    assert [finished(clients.query(SPARQL)) for _ in range(3)] == [[('1',)]] * 3
    manager.status = {**manager.status, 'version': '2'}
    assert [finished(clients.query(SPARQL)) for _ in range(2)] == [[('2',)]] * 2
    # Another run may have another content with the same number.
    manager.status = {**manager.status, 'started at': '2'}
    assert finished(clients.query(SPARQL)) == [('3',)]


def test_a_change_during_a_query(clients: ServiceClients) -> None:
    manager: Any = clients.ontology_manager
    manager.before_answer = lambda: manager.status.update(version='2')
    assert finished(clients.query(SPARQL)) == [('1',)]
    manager.before_answer = lambda: None
    assert [finished(clients.query(SPARQL)) for _ in range(2)] == [[('2',)]] * 2


def test_a_manager_that_is_gone_has_no_kept_solutions(clients: ServiceClients) -> None:
    manager: Any = clients.ontology_manager
    assert finished(clients.query(SPARQL)) == [('1',)]
    manager.alive = False
    assert [finished(clients.query(SPARQL)) for _ in range(2)] == [[('2',)], [('3',)]]


def test_the_number_of_kept_solutions_has_a_limit(
    clients: ServiceClients, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service_clients, '_MOST_SOLUTIONS', 1)
    assert [finished(clients.query(SPARQL)) for _ in range(2)] == [[('1',)], [('2',)]]


def test_an_answer_that_is_none_is_a_fault_of_its_query_alone(clients: ServiceClients) -> None:
    def fail() -> None:
        raise ValueError

    manager: Any = clients.ontology_manager
    manager.before_answer = fail
    for _ in range(10):
        with pytest.raises(ValueError):  # noqa: PT011 - any fault
            finished(clients.query(SPARQL))
    manager.before_answer = lambda: None
    assert finished(clients.query(SPARQL)) == [('11',)]
