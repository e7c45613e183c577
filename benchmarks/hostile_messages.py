"""Hostile rows for all nodes: random requests, floods, cancelled goals, malformed messages."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from dyknow_interfaces.action import MonitorFormula, MonitorPlan
from dyknow_interfaces.msg import (
    ConstraintViolation,
    EvaluationStatusArray,
    Field,
    FormulaResult,
    Heartbeat,
    Sample,
    StreamStatus,
    StreamStatusArray,
)
from dyknow_interfaces.srv import (
    ConceptGetInstances,
    EvaluateFormula,
    FindAllMatchingStreams,
    FormulaGroupDestroy,
    ListStreams,
    StreamCreateFromSpec,
)
from hostile_client import ANSWER_TIMEOUT_S, NODES, REQUESTS, HostileClient
from random_messages import interface, random_bytes, random_message
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import ListParameters, SetParameters
from rclpy.action import ActionClient
from sensor_msgs.msg import BatteryState

from dyknow_common import SECOND_NS
from dyknow_common.ros import LATCHED, nanoseconds_to_duration, nanoseconds_to_time

COORDINATOR = 'stream_reasoning_coordinator'
EVALUATE = f'{COORDINATOR}/evaluate_formula'
HIGH = 500.0
"""A forged level that makes formulas of others false."""

FLOOD = 3000
AT_ONCE = 200


def random_requests(client: HostileClient) -> None:
    """Send random requests to every service of a node."""
    _send_random(client, 'dyknow_interfaces/')


def random_parameters(client: HostileClient) -> None:
    """Send random requests to the services of the parameters of a node."""
    _send_random(client, 'rcl_interfaces/')


def _send_random(client: HostileClient, package: str) -> None:
    node = client.chance.choice(NODES)
    for name, (kind, *_) in client.node.get_service_names_and_types():
        if name.startswith(f'/{node}/') and '/_action/' not in name and kind.startswith(package):
            service = interface(kind)
            for _ in range(5):
                client.ask(service, name, random_message(service.Request, client.chance))


def random_goals(client: HostileClient) -> None:
    """Send random goals, and cancel some of them."""
    for kind, name in ((MonitorFormula, 'monitor_formula'), (MonitorPlan, 'monitor_plan')):
        goals = [random_message(kind.Goal, client.chance) for _ in range(10)]
        _send_goals(client, kind, name, goals)


def cancelled_goals(client: HostileClient) -> None:
    """Send goals, and cancel them at random times."""
    goals = [
        MonitorFormula.Goal(formula=f'always Power[uav1] < {1000 + each}') for each in range(30)
    ]
    _send_goals(client, MonitorFormula, 'monitor_formula', goals)


def _send_goals(client: HostileClient, kind: Any, name: str, goals: list[Any]) -> None:
    actions = ActionClient(
        client.node,
        kind,
        f'{COORDINATOR}/{name}',
        goal_service_qos_profile=REQUESTS,
        result_service_qos_profile=REQUESTS,
        cancel_service_qos_profile=REQUESTS,
    )
    client.spin_until(actions.server_is_ready, 2.0)
    sent = [actions.send_goal_async(each) for each in goals]
    client.spin_until(lambda: all(each.done() for each in sent), ANSWER_TIMEOUT_S)
    if missing := sum(not each.done() for each in sent):
        client.count('unanswered', missing)
    accepted = [each.result() for each in sent if each.done() and each.result().accepted]
    for goal in accepted:
        client.watch(goal.get_result_async())
    for goal in accepted:
        client.wait(client.chance.uniform(0.0, 0.1))
        client.watch(goal.cancel_goal_async())
    client.wait_for_answers()
    actions.destroy()


def flood(client: HostileClient) -> None:
    """Send thousands of requests at once to one service."""
    kind, service, fields = client.chance.choice(
        (
            (ListStreams, 'stream_manager/list_streams', {}),
            (ConceptGetInstances, 'ontology_manager/concept_get_instances',
             {'concept_name': 'UAV'}),
            (FindAllMatchingStreams, 'semantic_matching_engine/find_all_matching_streams',
             {'concept': 'Power'}),
            (FormulaGroupDestroy, 'stream_reasoning_engine/formula_group_destroy',
             {'formula_group_id': -1}),
            (EvaluateFormula, EVALUATE, {'formula': 'always Power[uav1] <'}),
        )
    )  # fmt: skip
    for _ in range(FLOOD):
        client.ask(kind, service, **fields)


def evaluations_at_once(client: HostileClient) -> None:
    """Send many formulas at once that are not decided soon."""
    timeout = nanoseconds_to_duration(3 * SECOND_NS)
    for each in range(AT_ONCE):
        formula = f'forall u in UAV: always Power[u] < {1000 + each}'
        client.ask(EvaluateFormula, EVALUATE, formula=formula, timeout=timeout)


def killed_client(client: HostileClient) -> None:
    """Send formulas and a goal, and be killed before their answers."""
    timeout = nanoseconds_to_duration(60 * SECOND_NS)
    for each in range(3):
        formula = f'always Power[uav1] < {2000 + each}'
        client.ask(EvaluateFormula, EVALUATE, formula=formula, timeout=timeout)
    actions = ActionClient(client.node, MonitorFormula, f'{COORDINATOR}/monitor_formula')
    client.spin_until(actions.server_is_ready, 2.0)
    actions.send_goal_async(MonitorFormula.Goal(formula='always Power[uav2] < 2000'))
    client.wait(client.chance.uniform(0.0, 1.0))
    os.kill(os.getpid(), signal.SIGKILL)


def parameters(client: HostileClient) -> None:
    """Set parameters of running nodes, `use_sim_time` among them."""
    for node in NODES:
        listed = client.call(ListParameters, f'{node}/list_parameters')
        names = {*(listed.result.names if listed else ()), 'use_sim_time', 'hostile', ''}
        for name in sorted(names):
            value = random_message(ParameterValue, client.chance, 2)
            value.type = client.chance.randrange(ParameterType.PARAMETER_STRING_ARRAY + 1)
            if name == 'use_sim_time':
                value = ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True)
            parameter = Parameter(name=name, value=value)
            client.ask(SetParameters, f'{node}/set_parameters', parameters=[parameter])


def _internal_topics(client: HostileClient) -> Iterator[tuple[str, Any]]:
    """Yield the topics by which the nodes talk to each other, with their types."""
    for name, (kind, *_) in client.node.get_topic_names_and_types():
        package = kind.partition('/')[0]
        if '/_action/' not in name and package in {'dyknow_interfaces', 'diagnostic_msgs'}:
            yield name, interface(kind)


def random_messages(client: HostileClient) -> None:
    """Publish random messages, with unknown values of enumerations, on all internal topics."""
    for topic, kind in _internal_topics(client):
        messages = [random_message(kind, client.chance, 1) for _ in range(5)]
        client.publish(kind, topic, messages)


def malformed_messages(client: HostileClient) -> None:
    """Publish bytes that are no messages, or have texts that are not UTF-8, on internal topics."""
    for topic, kind in _internal_topics(client):
        client.publish(kind, topic, [random_bytes(kind, client.chance) for _ in range(10)])


def malformed_source(client: HostileClient) -> None:
    """Publish bytes that are no messages on the topic of a stream."""
    request = StreamCreateFromSpec.Request()
    request.spec.name = 'hostile_source'
    request.spec.specification = 'select current, serial_number from "/hostile/battery"'
    client.ask(StreamCreateFromSpec, 'stream_manager/stream_create_from_spec', request)
    messages = [random_bytes(BatteryState, client.chance) for _ in range(50)]
    client.publish(BatteryState, '/hostile/battery', [BatteryState(), *messages], 0.01)


def forged_results(client: HostileClient) -> None:
    """Publish results of the formulas of others, of this and other values of enumerations."""
    topics = [name for name, kind in _internal_topics(client) if kind is FormulaResult]
    for each in _evaluations(client):
        for topic in topics:
            forged = [
                FormulaResult(
                    formula_group_id=each.formula_group_id, formula_id=formula, verdict=verdict
                )
                for formula in range(20)
                for verdict in (FormulaResult.FALSE, FormulaResult.TRUE, 77)
            ]
            failed = FormulaResult(formula_group_id=each.formula_group_id)
            failed.exit_status.code = 200
            client.publish(FormulaResult, topic, [*forged, failed])


def forged_violations(client: HostileClient) -> None:
    """Publish violations of the streams of others."""
    for topic, kind in _internal_topics(client):
        if kind is ConstraintViolation:
            forged = ConstraintViolation(
                stream_name=topic.split('/')[-2], constraint='max_delay', message='forged'
            )
            forged.header.stamp = forged.valid_time = _now()
            client.publish(kind, topic, [forged, forged])


def forged_samples(client: HostileClient) -> None:
    """Publish states and samples of streams of others, with another level."""
    for topic, kind in _internal_topics(client):
        if kind is Sample:
            names = ('power', *(f'Power[uav{number}]' for number in (1, 2, 3)))
            fields = [Field(type='float', name=name, value=str(HIGH)) for name in names]
            for each in (fields, [], fields * 1000):
                sample = Sample(valid_time=_now(), available_time=_now(), fields=each)
                client.publish(kind, topic, [sample])


def forged_reports(client: HostileClient) -> None:
    """Publish reports of engines: without streams, with failed ones, with unknown states."""
    for topic, kind in _internal_topics(client):
        if kind is StreamStatusArray:
            failed = StreamStatus(name='uav1_power', state=StreamStatus.FAILED, message='forged')
            unknown = StreamStatus(name='uav1_power', state=99)
            reports = [StreamStatusArray(streams=each) for each in ([], [failed], [unknown])]
            client.publish(kind, topic, reports)


def forged_nodes(client: HostileClient) -> None:
    """Publish statuses and heartbeats that make nodes look restarted, or as other nodes."""
    later = time.time_ns()
    for node in NODES:
        heartbeat = Heartbeat(started_at=nanoseconds_to_time(later), node_id=1, sequence_number=0)
        client.publish(Heartbeat, f'{node}/_heartbeat', [heartbeat])
        values = [KeyValue(key='type', value='stream_processing_engine'),
                  KeyValue(key='born', value=str(later))]  # fmt: skip
        wrong = [KeyValue(key='born', value='never')]
        statuses = [DiagnosticStatus(name=f'/{node}', message='running', values=each)
                    for each in (values, wrong, [])]  # fmt: skip
        client.publish(DiagnosticStatus, f'{node}/_status', statuses)


def _evaluations(client: HostileClient) -> list[Any]:
    """Return the evaluations that run, as the coordinator reports them to everyone."""
    heard: list[Any] = []
    subscription = client.node.create_subscription(
        EvaluationStatusArray, f'{COORDINATOR}/evaluations', heard.append, LATCHED
    )
    client.spin_until(lambda: bool(heard), 2.0)
    client.node.destroy_subscription(subscription)
    return [each for each in heard[-1].evaluations if each.formula_group_id] if heard else []


def _now() -> Any:
    return nanoseconds_to_time(time.time_ns())


ROWS = (
    random_requests, random_parameters, random_goals, cancelled_goals, flood, evaluations_at_once,
    killed_client, parameters, random_messages, malformed_messages, malformed_source,
    forged_results, forged_violations, forged_samples, forged_reports, forged_nodes,
)  # fmt: skip
