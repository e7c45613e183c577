"""Arguments of wrong types are refused with a sentence that names them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest
from rclpy.node import Node

from dyknow_common import DyKnowError, StreamConstraints
from dyknow_coordinator.ros import FormulaClient
from dyknow_stream_processing.ros import StreamProxy
from system import Client


@pytest.fixture
def node(client: Client) -> Iterator[Node]:
    made = Node('asker', context=client.context)
    yield made
    made.destroy_node()


def test_a_negative_wait(node: Node) -> None:
    with (
        FormulaClient(node) as client,
        pytest.raises(ValueError, match='wait must not be negative, but it is -1'),
    ):
        client.monitor('always p', wait=-1)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({'formula': 3}, 'formula must be a text in the formula language, not 3'),
        ({'timeout': '5 s'}, "timeout must be a number of seconds, not '5 s'"),
        ({'timeout': True}, 'timeout must be a number of seconds, not True'),
        ({'wait': None}, 'wait must be a number of seconds, not None'),
        ({'grounding': 'auto'}, 'grounding must be a member of Grounding, such as Grounding.AUTO'),
        ({'constraints': {}}, 'constraints must be a StreamConstraints, not {}'),
        ({'margin': 'yes'}, "margin must be True or False, not 'yes'"),
        ({'margin': 1}, 'margin must be True or False, not 1'),
    ],
)
def test_arguments_of_formula_client(node: Node, arguments: Any, message: str) -> None:
    given = {'formula': 'always p', **arguments}
    with FormulaClient(node) as client:
        for ask in (client.monitor, client.evaluate_blocking):
            with pytest.raises(TypeError, match=message):
                ask(**given)
        with pytest.raises(TypeError, match=message):
            client.evaluate(**given).send(None)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({'on_verdict': None}, 'on_verdict must be a function, not None'),
        ({'on_feedback': 3}, 'on_feedback must be a function, not 3'),
        ({'on_interruption': 3}, 'on_interruption must be a function or None, not 3'),
        ({'name': None}, 'name must be a text, not None'),
        ({'restart_on_change': 'no'}, "restart_on_change must be True or False, not 'no'"),
        ({'every_state': 0}, 'every_state must be True or False, not 0'),
        ({'record': True}, 'record must be a BlackBoxOptions or None, not True'),
    ],
)
def test_arguments_of_monitor(node: Node, arguments: Any, message: str) -> None:
    with FormulaClient(node) as client, pytest.raises(TypeError, match=message):
        client.monitor('always p', **arguments)


@pytest.mark.parametrize('seconds', [float('nan'), float('inf')])
@pytest.mark.parametrize('name', ['timeout', 'wait'])
def test_times_that_are_not_finite(node: Node, name: str, seconds: float) -> None:
    with (
        FormulaClient(node) as client,
        pytest.raises(ValueError, match=f'{name} must be a finite number of seconds, not '),
    ):
        client.monitor('always p', **{name: seconds})


@pytest.mark.parametrize('seconds', [1e300, 10**400, 2**31])
@pytest.mark.parametrize('name', ['timeout', 'wait'])
def test_times_that_are_too_long(node: Node, name: str, seconds: float) -> None:
    message = re.escape(f'{name} must be at most 2147483647 s (68 years), not {seconds!r}')
    with FormulaClient(node) as client:
        for ask in (client.monitor, client.evaluate_blocking):
            with pytest.raises(ValueError, match=message):
                ask('always p', **{name: seconds})


@pytest.mark.parametrize(
    ('constraints', 'message'),
    [
        ({'start_time': -1}, 'start_time is -1 ns; it must not be negative'),
        ({'end_time': 2**31 * 10**9}, 'end_time is 2147483648 s; it must be at most'),
        ({'max_delay': 0.5}, 'max_delay is 0.5; give a whole number of nanoseconds'),
    ],
)
def test_times_of_constraints(node: Node, constraints: Any, message: str) -> None:
    with FormulaClient(node) as client:
        answer = client.evaluate_blocking('always p', constraints=StreamConstraints(**constraints))
    assert message in str(answer.error)
    with pytest.raises(DyKnowError, match=message):
        StreamProxy(node, '/odom', on_sample=print, constraints=StreamConstraints(**constraints))


def test_arguments_of_the_client_itself(node: Node) -> None:
    with pytest.raises(TypeError, match='node must be a node of rclpy, not None'):
        FormulaClient(None)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match='coordinator must be the name of a node, not 3'):
        FormulaClient(node, 3)  # type: ignore[arg-type]


def test_a_plan_that_is_none(node: Node) -> None:
    with FormulaClient(node) as client, pytest.raises(TypeError, match='plan must be a Plan, not'):
        client.monitor_plan('delivery')  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({'stream': 3}, 'stream must be a topic or a specification as a text, not 3'),
        ({'constraints': 3}, 'constraints must be a StreamConstraints, not 3'),
        ({'on_sample': 3}, 'on_sample must be a function, not 3'),
        ({'on_violation': None}, 'on_violation must be a function, not None'),
        ({'valid_time': 3}, 'valid_time must be a field, or one for each topic, not 3'),
        ({'valid_time': {'/odom': 3}}, 'valid_time must be a field, or one for each topic, not '),
        ({'message_type': 'Odometry'}, 'message_type must be the class of a message, or one for '),
        ({'quality_of_service': 10}, 'quality_of_service must be a QoSProfile, not 10'),
    ],
)
def test_arguments_of_stream_proxy(node: Node, arguments: Any, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        StreamProxy(node, **{'stream': '/odom', 'on_sample': print, **arguments})


def test_a_stream_proxy_needs_a_node() -> None:
    with pytest.raises(TypeError, match='node must be a node of rclpy, not None'):
        StreamProxy(None, '/odom', on_sample=print)  # type: ignore[arg-type]
