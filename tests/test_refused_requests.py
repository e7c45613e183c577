"""Requests with names that no topic can have, and changes of parameters."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from dyknow_interfaces import srv
from dyknow_interfaces.msg import ExitStatus, StreamSpec
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters

from services import Nodes, assert_refused

INVALID = ExitStatus.INVALID_ARGUMENT
LONG = 'a' * 300
LIMIT = 'more than 247 characters'
NODES = ('stream_processing_engine', 'stream_manager', 'stream_reasoning_engine')


@pytest.fixture(scope='module')
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    started: dict[str, Any] = {name: {} for name in NODES}
    started['stream_processing_engine'] = {'max_streams': 2}
    started['stream_manager'] = {'max_specification': 1000}
    with Nodes(tmp_path_factory.mktemp('refused'), **started) as nodes:
        yield nodes


@pytest.mark.parametrize('node', ['stream_processing_engine', 'stream_manager'])
@pytest.mark.parametrize(
    ('name', 'specification'),
    [
        (LONG, 'select data from "/a"'),
        # The topic of the stream is short enough, the topic of its violations is not.
        ('b' * 225, 'select data from "/a"'),
        ('c', f'select data from "/{LONG}"'),
        ('c', f'source (data: float) "/{LONG}"; sink select data from "/{LONG}"'),
        ('c', f'sync("/a", "/{LONG}/b")'),
    ],
    ids=['stream', 'violations', 'source', 'declared source', 'input'],
)
def test_names_that_are_too_long(nodes: Nodes, node: str, name: str, specification: str) -> None:
    spec = StreamSpec(name=name, specification=specification)
    answer = nodes.call(node, srv.StreamCreateFromSpec, spec=spec)
    assert_refused(answer.exit_status, INVALID, 'cannot be the name of a topic', LIMIT)
    assert not nodes.obtain('stream_processing_engine', srv.ListStreams).stream_names
    assert name not in nodes.obtain('stream_manager', srv.ListStreams).stream_names


@pytest.mark.parametrize(
    ('topic', 'reason'),
    [
        (f'/{LONG}', LIMIT),
        ('/a//b', 'repeated'),
        ('a b', 'must not contain characters'),
        ('{unknown}', 'unknown substitution'),
    ],
)
def test_names_of_topics(nodes: Nodes, topic: str, reason: str) -> None:
    registered = nodes.call(
        'stream_manager',
        srv.StreamRegister,
        stream_name='named',
        topic_name=topic,
        message_type='std_msgs/msg/Float64',
    )
    assert_refused(registered.exit_status, INVALID, 'topic_name', reason)
    group = nodes.obtain('stream_reasoning_engine', srv.FormulaGroupCreate).formula_group_id
    for field in ('state_stream', 'result_topic'):
        topics = {'state_stream': '/states', 'result_topic': '/results', field: topic}
        answer = nodes.call(
            'stream_reasoning_engine', srv.FormulaGroupEvaluate, formula_group_id=group, **topics
        )
        assert_refused(answer.exit_status, INVALID, field, reason)


@pytest.mark.parametrize('node', NODES)
def test_the_clock_of_a_running_node_stays(nodes: Nodes, node: str) -> None:
    def set_to(value: bool) -> Any:  # noqa: FBT001
        wanted = ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=value)
        answer = nodes.client.call(
            SetParameters,
            f'/{node}/set_parameters',
            parameters=[Parameter(name='use_sim_time', value=wanted)],
        )
        return answer.results[0]

    refused = set_to(True)
    assert not refused.successful
    assert 'restart the node' in refused.reason
    assert set_to(False).successful


def test_limits_change_while_a_node_runs_and_periods_do_not(nodes: Nodes) -> None:
    def set_to(node: str, name: str, **value: Any) -> Any:
        wanted = Parameter(name=name, value=ParameterValue(**value))
        service = f'/{node}/set_parameters'
        return nodes.client.call(SetParameters, service, parameters=[wanted]).results[0]

    def characters(number: int) -> Any:
        kind = ParameterType.PARAMETER_INTEGER
        return set_to('stream_manager', 'max_specification', type=kind, integer_value=number)

    spec = StreamSpec(name='long', specification=f'select a as {"a" * 100} from nowhere')
    assert characters(100).successful
    refused = nodes.call('stream_manager', srv.StreamCreateFromSpec, spec=spec)
    assert_refused(refused.exit_status, INVALID, 'max_specification', 'allows 100')
    assert not characters(99).successful
    assert characters(1000).successful
    refused = nodes.call('stream_manager', srv.StreamCreateFromSpec, spec=spec)
    assert_refused(refused.exit_status, ExitStatus.NOT_FOUND, 'nowhere')
    kind = ParameterType.PARAMETER_DOUBLE
    fixed = set_to('stream_reasoning_engine', 'progress_period', type=kind, double_value=2.0)
    assert (fixed.successful, 'read-only' in fixed.reason) == (False, True)


@pytest.mark.parametrize('node', NODES)
def test_a_parameter_of_an_unknown_type_ends_no_node(nodes: Nodes, node: str) -> None:
    wrong = Parameter(name='use_sim_time', value=ParameterValue(type=200))
    answer = nodes.client.call(SetParameters, f'/{node}/set_parameters', parameters=[wrong])
    assert not any(each.successful for each in answer.results)
    assert nodes.client.call(SetParameters, f'/{node}/set_parameters', parameters=[]).results == []


def test_the_streams_of_an_engine_are_bounded(nodes: Nodes) -> None:
    engine = 'stream_processing_engine'

    def create(name: str, node: str = engine, text: str = '"/a"') -> Any:
        spec = StreamSpec(name=name, specification=text)
        return nodes.call(node, srv.StreamCreateFromSpec, spec=spec).exit_status

    assert [create(name).code for name in ('a', 'b')] == [ExitStatus.SUCCESS] * 2
    # Late, the manager may have the engine destroy what it asked for: another name.
    for name, node in (('c', engine), ('e', 'stream_manager')):
        assert_refused(create(name, node), ExitStatus.UNAVAILABLE, 'max_streams allows 2')
    for name in ('a', 'b'):
        nodes.obtain(engine, srv.StreamDestroy, stream_name=name)
    assert create('c').code == ExitStatus.SUCCESS
    nodes.obtain(engine, srv.StreamDestroy, stream_name='c')
    long = create('d', 'stream_manager', f'select {"a" * 1000} from b')
    assert_refused(long, INVALID, 'max_specification', '1000')


def test_merges_that_double(nodes: Nodes) -> None:
    merges = ''.join(f'stream a{each} = merge(a{each - 1}, a{each - 1});' for each in range(1, 26))
    spec = StreamSpec(name='doubled', specification=f'stream a0 = "/a"; {merges} sink a25')
    answer = nodes.call('stream_processing_engine', srv.StreamCreateFromSpec, spec=spec)
    assert_refused(answer.exit_status, INVALID, 'repeat each sample', '^')
    assert not nodes.obtain('stream_processing_engine', srv.ListStreams).stream_names
