"""Arguments of wrong types are refused with a sentence that names them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from rclpy.node import Node

from dyknow_coordinator.ros import FormulaClient
from dyknow_stream_processing.ros import StreamProxy
from system import Client


@pytest.fixture
def node(client: Client) -> Iterator[Node]:
    made = Node('asker', context=client.context)
    yield made
    made.destroy_node()


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({'formula': 3}, 'formula must be a text in the formula language, not 3'),
        ({'timeout': '5 s'}, "timeout must be a number of seconds, not '5 s'"),
        ({'timeout': True}, 'timeout must be a number of seconds, not True'),
        ({'wait': None}, 'wait must be a number of seconds, not None'),
        ({'grounding': 'auto'}, 'grounding must be a member of Grounding, such as Grounding.AUTO'),
        ({'constraints': {}}, 'constraints must be a StreamConstraints, not {}'),
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
    ],
)
def test_arguments_of_stream_proxy(node: Node, arguments: Any, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        StreamProxy(node, **{'stream': '/odom', 'on_sample': print, **arguments})
