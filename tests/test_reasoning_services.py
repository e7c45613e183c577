"""The services of the reasoning engine."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from dyknow_interfaces import srv
from dyknow_interfaces.msg import Domain, ExitStatus, Field, FormulaResult, Sample, Symbol

from services import LATCHED, Nodes, assert_refused, nanoseconds, time_of

ENGINE = 'stream_reasoning_engine'
INVALID = ExitStatus.INVALID_ARGUMENT
MISSING = ExitStatus.NOT_FOUND
SECOND = 1_000_000_000
NOBODY = 2_000_000_000

CALM = 'forall u in UAV: always[0, 2000] Power[u] < 150'
VEHICLES = [Domain(sort='UAV', objects=['uav1', 'uav2'])]
POWERS = [
    Symbol(kind=Symbol.FEATURE, name='Power', arguments=['uav1']),
    Symbol(kind=Symbol.FEATURE, name='Power', arguments=['uav2']),
]


@pytest.fixture(scope='module')
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    """The reasoning engine alone."""
    with Nodes(tmp_path_factory.mktemp('reasoning'), stream_reasoning_engine={}) as nodes:
        yield nodes


@pytest.fixture
def group(nodes: Nodes) -> Iterator[int]:
    """A formula group with one formula."""
    made = nodes.obtain(ENGINE, srv.FormulaGroupCreate, formula_group_name='calm')
    add(nodes, made.formula_group_id, CALM)
    yield made.formula_group_id
    nodes.obtain(ENGINE, srv.FormulaGroupDestroy, formula_group_id=made.formula_group_id)


def add(nodes: Nodes, group: int, formula: str) -> Any:
    return nodes.obtain(
        ENGINE,
        srv.FormulaGroupAddFormula,
        formula_group_id=group,
        formula_name=f'is it that {formula}',
        formula=formula,
    )


def symbols(nodes: Nodes, group: int) -> list[Any]:
    answer = nodes.obtain(ENGINE, srv.FormulaGroupExtractSymbols, formula_group_id=group)
    return list(answer.symbols)


class States:
    """A state stream, evaluated by a formula group."""

    def __init__(self, nodes: Nodes, group: int) -> None:
        self._nodes = nodes
        states, results = f'/states/of_{group}', f'/results/of_{group}'
        self.results = nodes.collect(FormulaResult, results, LATCHED)
        self._publisher = nodes.client.node.create_publisher(Sample, states, 100)
        nodes.obtain(
            ENGINE,
            srv.FormulaGroupEvaluate,
            formula_group_id=group,
            domains=VEHICLES,
            state_stream=states,
            result_topic=results,
        )
        nodes.client.spin_until(
            lambda: self._publisher.get_subscription_count() > 0, 'the engine listens'
        )

    def publish(self, seconds: int, **powers: float) -> None:
        fields = [
            Field(type='float', name=f'Power[{vehicle}]', value=str(power))
            for vehicle, power in powers.items()
        ]
        self._publisher.publish(Sample(valid_time=time_of(seconds * SECOND), fields=fields))

    def wait_for_results(self, count: int) -> dict[int, Any]:
        """By formula."""
        self._nodes.client.spin_until(lambda: len(self.results) >= count, 'the results')
        return {result.formula_id: result for result in self.results}


def test_groups_have_ids_of_their_own(nodes: Nodes, group: int) -> None:
    made = nodes.obtain(ENGINE, srv.FormulaGroupCreate, formula_group_name='calm')
    assert made.formula_group_id != group
    nodes.obtain(ENGINE, srv.FormulaGroupDestroy, formula_group_id=made.formula_group_id)
    answer = nodes.call(
        ENGINE, srv.FormulaGroupExtractSymbols, formula_group_id=made.formula_group_id
    )
    assert_refused(answer.exit_status, MISSING, str(made.formula_group_id), str(group))


def test_a_formula_is_given_back_in_canonical_form(nodes: Nodes, group: int) -> None:
    added = add(nodes, group, CALM)
    assert added.canonical_formula == 'forall u in UAV: (always[0 s, 2 s] (Power[u] < 150))'
    assert add(nodes, group, CALM).formula_id != added.formula_id


def test_symbols_before_and_after_the_domains_are_fixed(nodes: Nodes, group: int) -> None:
    before = symbols(nodes, group)
    assert Symbol(kind=Symbol.FEATURE, name='Power', arguments=['UAV']) in before
    assert Symbol(kind=Symbol.SORT, name='UAV') in before
    assert len(before) == 2
    States(nodes, group)
    assert symbols(nodes, group) == POWERS


def test_each_formula_of_a_group_gets_a_result(nodes: Nodes, group: int) -> None:
    soon = add(nodes, group, 'eventually Power[uav2] > 150').formula_id
    calm = add(nodes, group, 'always Power[uav1] < 150').formula_id
    states = States(nodes, group)
    states.publish(10, uav1=100.0, uav2=100.0)
    states.publish(11, uav1=100.0, uav2=170.0)
    states.publish(13, uav1=160.0, uav2=100.0)
    results = states.wait_for_results(3)
    assert [result.verdict for result in results.values()] == [
        FormulaResult.FALSE,
        FormulaResult.TRUE,
        FormulaResult.FALSE,
    ]
    assert {result.formula_group_id for result in results.values()} == {group}
    assert nanoseconds(results[soon].decided_at) == 11 * SECOND
    assert nanoseconds(results[calm].decided_at) == 13 * SECOND
    assert 'Power[uav1] = 160' in results[calm].explanation
    assert results[calm].formula_name == 'is it that always Power[uav1] < 150'


def test_a_state_without_a_field_is_no_verdict(nodes: Nodes, group: int) -> None:
    states = States(nodes, group)
    states.publish(10, uav1=100.0)
    (result,) = states.wait_for_results(1).values()
    assert result.verdict == FormulaResult.UNDECIDED
    assert result.exit_status.code != ExitStatus.SUCCESS
    assert 'Power[uav2]' in result.exit_status.message


def test_states_whose_time_stands_still_are_no_verdict(nodes: Nodes, group: int) -> None:
    states = States(nodes, group)
    for _ in range(2):
        states.publish(10, uav1=100.0, uav2=100.0)
    (result,) = states.wait_for_results(1).values()
    assert result.verdict == FormulaResult.UNDECIDED
    assert_refused(result.exit_status, ExitStatus.CONSTRAINT_VIOLATION, 'valid time')


def test_a_group_that_is_destroyed_listens_no_more(nodes: Nodes) -> None:
    made = nodes.obtain(ENGINE, srv.FormulaGroupCreate, formula_group_name='brief')
    group = made.formula_group_id
    add(nodes, group, CALM)
    States(nodes, group)
    nodes.obtain(ENGINE, srv.FormulaGroupDestroy, formula_group_id=group)
    graph = nodes.client.node
    nodes.client.spin_until(
        lambda: (
            graph.count_subscribers(f'/states/of_{group}') == 0
            and graph.count_publishers(f'/results/of_{group}') == 0
        ),
        'the topics are left',
    )


@pytest.mark.parametrize(
    ('formula', 'words'),
    [
        ('always Power[uav1] <', ('unexpected end', '^')),
        ('', ('unexpected end', '^')),
        ('always[5 s, 1 s] Power[uav1] < 1', ('5 s', '1 s', '^')),
        ('Power[uav1] and Power[uav1] > 1', ('Power', '^')),
        ('always[0, 5 m] Power[uav1] < 1', ("'m'", '^')),
    ],
)
def test_a_formula_that_is_refused(
    nodes: Nodes, group: int, formula: str, words: tuple[str, ...]
) -> None:
    before = symbols(nodes, group)
    answer = nodes.call(ENGINE, srv.FormulaGroupAddFormula, formula_group_id=group, formula=formula)
    assert_refused(answer.exit_status, INVALID, *words)
    assert symbols(nodes, group) == before


@pytest.mark.parametrize(
    ('service', 'fields'),
    [
        (srv.FormulaGroupAddFormula, {'formula': 'true'}),
        (srv.FormulaGroupRemoveFormula, {'formula_id': 1}),
        (srv.FormulaGroupExtractSymbols, {}),
        (srv.FormulaGroupEvaluate, {'state_stream': '/a', 'result_topic': '/b'}),
        (srv.FormulaGroupDestroy, {}),
    ],
)
def test_an_unknown_group(nodes: Nodes, group: int, service: Any, fields: dict[str, Any]) -> None:
    answer = nodes.call(ENGINE, service, formula_group_id=NOBODY, **fields)
    assert_refused(answer.exit_status, MISSING, str(NOBODY), str(group))


@pytest.mark.parametrize(
    ('fields', 'word'),
    [
        ({'state_stream': '/a', 'result_topic': '/b'}, 'UAV'),
        ({'domains': VEHICLES, 'result_topic': '/b'}, 'state_stream'),
        ({'domains': VEHICLES, 'state_stream': '/a'}, 'result_topic'),
        ({'domains': VEHICLES, 'state_stream': '/two words', 'result_topic': '/b'}, '/two words'),
        ({'domains': VEHICLES, 'state_stream': '/a', 'result_topic': '/two words'}, '/two words'),
    ],
)
def test_an_evaluation_that_is_refused_can_be_asked_for_again(
    nodes: Nodes, group: int, fields: dict[str, Any], word: str
) -> None:
    answer = nodes.call(ENGINE, srv.FormulaGroupEvaluate, formula_group_id=group, **fields)
    assert_refused(answer.exit_status, INVALID, word)
    States(nodes, group)
