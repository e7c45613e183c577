"""A client with plain rclpy, written from the list of interfaces alone: no Python of DyKnow."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from builtin_interfaces.msg import Duration
from dyknow_interfaces.action import MonitorFormula
from dyknow_interfaces.msg import (
    ExitStatus,
    FormulaResult,
    Sample,
    StreamConstraints,
    StreamSpec,
    Symbol,
)
from dyknow_interfaces.srv import (
    AddSemanticSpecification,
    ConceptCreate,
    ConceptDestroy,
    ConceptGetInstances,
    EvaluateFormula,
    FindAllMatchingStreams,
    FormulaGroupAddFormula,
    FormulaGroupCreate,
    FormulaGroupDestroy,
    FormulaGroupExtractSymbols,
    InstanceCreate,
    InstanceDestroy,
    RemoveSemanticSpecification,
    StreamCreateFromSpec,
    StreamDestroy,
    StreamGetTopic,
)
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Float64

from system import System

LIMIT = 100.0


class Plain:
    """A client with nothing but the messages and the names of the nodes."""

    def __init__(self, domain: int) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node('somebody', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def wait(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + LIMIT
        while not condition():
            assert time.monotonic() < end, 'nothing came'
            self.executor.spin_once(timeout_sec=0.05)

    def ask(self, service_type: Any, name: str, **fields: Any) -> Any:
        client = self.node.create_client(service_type, name)
        self.wait(client.service_is_ready)
        future = client.call_async(service_type.Request(**fields))
        self.wait(future.done)
        self.node.destroy_client(client)
        return future.result()

    def call(self, service_type: Any, name: str, **fields: Any) -> Any:
        answer = self.ask(service_type, name, **fields)
        assert answer.exit_status.code == ExitStatus.SUCCESS, answer.exit_status.message
        return answer


@pytest.fixture(scope='module')
def plain(system: System) -> Iterator[Plain]:
    client = Plain(int(system.environment['ROS_DOMAIN_ID']))
    yield client
    client.close()


def destroyed(plain: Plain) -> bool:
    """Destroy the stream, unless another one is made of it."""
    answer = plain.ask(StreamDestroy, '/stream_manager/stream_destroy', stream_name='tank')
    return bool(answer.exit_status.code == ExitStatus.SUCCESS)


@pytest.fixture(scope='module')
def tank(plain: Plain) -> Iterator[dict[str, float]]:
    """A topic of the client's own, made a stream, told what it means."""
    said = {'level': 0.5}
    publisher = plain.node.create_publisher(Float64, '/tank/level', 10)
    plain.node.create_timer(0.1, lambda: publisher.publish(Float64(data=said['level'])))
    plain.call(
        ConceptCreate, '/ontology_manager/concept_create',
        concept_name='Tank', parent_concepts=['Vehicle'],
    )  # fmt: skip
    plain.call(
        InstanceCreate, '/ontology_manager/instance_create',
        instance_name='tank', concept_names=['Tank'],
    )  # fmt: skip
    plain.call(
        StreamCreateFromSpec, '/stream_manager/stream_create_from_spec',
        spec=StreamSpec(name='tank', specification='select data as level from "/tank/level"'),
    )  # fmt: skip
    plain.call(
        AddSemanticSpecification, '/stream_semantics_manager/add_semantic_specification',
        ssl_statement='stream tank contains Altitude[tank] = level;',
    )  # fmt: skip
    yield said
    plain.call(
        RemoveSemanticSpecification, '/stream_semantics_manager/remove_semantic_specification',
        stream_name='tank',
    )  # fmt: skip
    plain.wait(lambda: destroyed(plain))
    plain.call(InstanceDestroy, '/ontology_manager/instance_destroy', instance_name='tank')
    plain.call(ConceptDestroy, '/ontology_manager/concept_destroy', concept_name='Tank')


def test_what_was_made_is_found(plain: Plain, tank: dict[str, float]) -> None:
    found = plain.call(
        ConceptGetInstances, '/ontology_manager/concept_get_instances', concept_name='Tank'
    )
    assert list(found.instances) == ['tank']
    matching = plain.call(
        FindAllMatchingStreams, '/semantic_matching_engine/find_all_matching_streams',
        concept='Altitude[t] for every t in Tank',
    )  # fmt: skip
    (specification,) = matching.stream_specifications
    assert 'from tank' in specification
    where = plain.call(StreamGetTopic, '/stream_manager/stream_get_topic', stream_name='tank')
    assert where.message_type == 'dyknow_interfaces/msg/Sample'
    samples: list[Sample] = []
    plain.node.create_subscription(Sample, where.topic_name, samples.append, 10)
    plain.wait(lambda: bool(samples))
    (field,) = samples[0].fields
    assert (field.name, field.type, float(field.value)) == ('level', 'float', tank['level'])


def test_a_formula_is_evaluated(plain: Plain, tank: dict[str, float]) -> None:
    tank['level'] = 0.5
    answer = plain.call(
        EvaluateFormula, '/stream_reasoning_coordinator/evaluate_formula',
        formula='forall t in Tank: always[0 s, 1 s] Altitude[t] < 1',
        grounding=EvaluateFormula.Request.AUTO,
        constraints=StreamConstraints(sample_period=[Duration(nanosec=200_000_000)]),
        timeout=Duration(sec=10),
    )  # fmt: skip
    assert answer.verdict == FormulaResult.TRUE
    assert answer.decided_at.sec > 0
    assert answer.canonical_formula == 'forall t in Tank: (always[0 s, 1 s] (Altitude[t] < 1))'
    assert [each.symbol for each in answer.groundings] == ['Altitude[tank]']


def test_a_formula_is_monitored(plain: Plain, tank: dict[str, float]) -> None:
    tank['level'] = 0.5
    action = ActionClient(
        plain.node, MonitorFormula, '/stream_reasoning_coordinator/monitor_formula'
    )
    plain.wait(action.server_is_ready)
    heard: list[Any] = []
    goal = MonitorFormula.Goal(
        formula='always Altitude[tank] < 1', timeout=Duration(sec=15), name='overflow'
    )
    accepted = action.send_goal_async(goal, lambda message: heard.append(message.feedback))
    plain.wait(accepted.done)
    result = accepted.result().get_result_async()
    plain.wait(lambda: bool(heard) and heard[-1].states_progressed > 0)
    assert heard[-1].residual_formula
    assert 'from tank' in heard[-1].streams[0]
    assert not heard[-1].presumably_false
    tank['level'] = 2.0
    plain.wait(result.done)
    assert result.result().result.verdict == FormulaResult.FALSE
    assert 'Altitude[tank] = 2' in result.result().result.explanation
    action.destroy()


def test_a_group_is_looked_into(plain: Plain) -> None:
    engine = '/stream_reasoning_engine/formula_group'
    group = plain.call(FormulaGroupCreate, f'{engine}_create', formula_group_name='mine')
    group_id = group.formula_group_id
    added = plain.call(
        FormulaGroupAddFormula, f'{engine}_add_formula',
        formula_group_id=group_id, formula_name='low',
        formula='forall t in Tank: Altitude[t] < 1',
    )  # fmt: skip
    assert added.formula_id >= 0
    found = plain.call(
        FormulaGroupExtractSymbols, f'{engine}_extract_symbols', formula_group_id=group_id
    )
    kinds = {symbol.name: symbol.kind for symbol in found.symbols}
    assert kinds == {'Altitude': Symbol.FEATURE, 'Tank': Symbol.SORT}
    plain.call(FormulaGroupDestroy, f'{engine}_destroy', formula_group_id=group_id)
