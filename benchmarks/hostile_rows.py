"""The rows of hostile clients: each is one kind of harmful requests or messages.

Single hostile requests are in the tests: `test_forged_messages.py`, `test_language_limits.py`,
`test_reasoning_limits.py`, `test_refused_requests.py` and `test_semantic_limits.py`. The rows here
are random, or a load: beside some of them, the latencies of others are measured.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from functools import partial

from dyknow_interfaces.action import MonitorFormula, MonitorPlan
from dyknow_interfaces.msg import Domain, Field, Sample
from dyknow_interfaces.srv import (
    ConceptCreate,
    ConceptGetInstances,
    EvaluateFormula,
    FindAllMatchingStreams,
    FormulaGroupAddFormula,
    FormulaGroupCreate,
    FormulaGroupDestroy,
    FormulaGroupEvaluate,
    FormulaGroupExtractSymbols,
    InstanceCreate,
    ListStreams,
    StreamCreateFromSpec,
)
from hostile_client import ANSWER_TIMEOUT_S, NODES, REQUESTS, HostileClient
from random_messages import interface, random_bytes, random_message
from rclpy.action import ActionClient
from sensor_msgs.msg import BatteryState

from dyknow_common import SECOND_NS
from dyknow_common.ros import STREAM, nanoseconds_to_duration

COORDINATOR = 'stream_reasoning_coordinator'
EVALUATE = f'{COORDINATOR}/evaluate_formula'
REASONER = 'stream_reasoning_engine'
CROWD = 202
FLOOD = 3000
PACKAGES = {'dyknow_interfaces', 'rcl_interfaces'}


def random_requests(client: HostileClient) -> None:
    """Send random requests to every service of a node, those of its parameters among them."""
    node = client.chance.choice(NODES)
    for name, (kind, *_) in client.node.get_service_names_and_types():
        package = kind.partition('/')[0]
        if name.startswith(f'/{node}/') and '/_action/' not in name and package in PACKAGES:
            service = interface(kind)
            for _ in range(5):
                client.ask(service, name, random_message(service.Request, client.chance))


def random_goals(client: HostileClient) -> None:
    """Send random and valid goals, and cancel them at random times."""
    profiles = dict.fromkeys(
        (f'{each}_service_qos_profile' for each in ('goal', 'result', 'cancel')), REQUESTS
    )
    valid = [MonitorFormula.Goal(formula=f'always Power[uav1] < {1000 + n}') for n in range(30)]
    for kind, name, given in (
        (MonitorFormula, 'monitor_formula', valid),
        (MonitorPlan, 'monitor_plan', []),
    ):
        actions = ActionClient(client.node, kind, f'{COORDINATOR}/{name}', **profiles)
        client.spin_until(actions.server_is_ready, 2.0)
        goals = [*given, *(random_message(kind.Goal, client.chance) for _ in range(10))]
        sent = [actions.send_goal_async(each) for each in goals]
        client.spin_until(lambda: all(each.done() for each in sent), ANSWER_TIMEOUT_S)  # noqa: B023
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


def killed_client(client: HostileClient) -> None:
    """Send formulas and a goal, and be killed before or after their answers."""
    timeout = nanoseconds_to_duration(10 * SECOND_NS)
    for each in range(3):
        formula = f'always Power[uav1] < {2000 + each}'
        client.ask(EvaluateFormula, EVALUATE, formula=formula, timeout=timeout)
    actions = ActionClient(client.node, MonitorFormula, f'{COORDINATOR}/monitor_formula')
    client.spin_until(actions.server_is_ready, 2.0)
    actions.send_goal_async(MonitorFormula.Goal(formula='always Power[uav2] < 2000'))
    client.wait(client.chance.uniform(0.0, 12.0))
    os.kill(os.getpid(), signal.SIGKILL)


def forged_messages(client: HostileClient) -> None:
    """Publish random messages and bytes that are no messages on all internal topics."""
    for topic, (name, *_) in client.node.get_topic_names_and_types():
        if '/_action/' not in topic and name.startswith(('dyknow_interfaces/', 'diagnostic_msgs/')):
            kind = interface(name)
            messages = [random_message(kind, client.chance, 1) for _ in range(5)]
            client.publish(kind, topic, messages)
            client.publish(kind, topic, [random_bytes(kind, client.chance) for _ in range(10)])


def malformed_source(client: HostileClient) -> None:
    """Publish bytes that are no messages on the topic of a stream."""
    request = StreamCreateFromSpec.Request()
    request.spec.name = 'hostile_source'
    request.spec.specification = 'select current, serial_number from "/hostile/battery"'
    client.ask(StreamCreateFromSpec, 'stream_manager/stream_create_from_spec', request)
    messages = [random_bytes(BatteryState, client.chance) for _ in range(50)]
    client.publish(BatteryState, '/hostile/battery', [BatteryState(), *messages], 0.01)


def objects_of_a_crowd_cubed(client: HostileClient) -> None:
    """Have the coordinator evaluate a formula over 202 * 202 * 202 objects, which is refused."""
    create = 'ontology_manager/concept_create'
    client.call(ConceptCreate, create, concept_name='Crowd', parent_concepts=['Object'])
    for number in range(CROWD):
        fields = {'instance_name': f'c{number}', 'concept_names': ['Crowd']}
        client.ask(InstanceCreate, 'ontology_manager/instance_create', **fields)
    client.wait_for_answers()
    names = ('a', 'b', 'c')
    quantifiers = ' '.join(f'forall {each} in Crowd:' for each in names)
    formula = f'{quantifiers} always XYDist[a, b] > Power[c]'
    for _ in range(20):
        client.call(EvaluateFormula, EVALUATE, formula=formula)


def _group(client: HostileClient, formula: str) -> int | None:
    """Return the id of a new group with a formula."""
    create, add = (f'{REASONER}/formula_group_{each}' for each in ('create', 'add_formula'))
    answer = client.call(FormulaGroupCreate, create, formula_group_name='hostile')
    if answer is None or answer.exit_status.code:
        return None
    group = int(answer.formula_group_id)
    fields = {'formula_group_id': group, 'formula_name': 'hostile', 'formula': formula}
    client.call(FormulaGroupAddFormula, add, **fields)
    return group


def _evaluate(client: HostileClient, formula: str, count: int, states: int) -> None:
    """Evaluate a formula for some objects in a group of its own, over some states."""
    group = _group(client, formula)
    if group is None:
        return
    topic, fields = f'/hostile_{group}', {'formula_group_id': group}
    objects = [f'o{number}' for number in range(count)]
    answer = client.call(
        FormulaGroupEvaluate,
        f'{REASONER}/formula_group_evaluate',
        domains=[Domain(sort='Many', objects=objects)],
        state_stream=topic,
        result_topic=f'{topic}_results',
        **fields,
    )
    if states and answer and not answer.exit_status.code:
        extract = f'{REASONER}/formula_group_extract_symbols'
        symbols = client.call(FormulaGroupExtractSymbols, extract, **fields).symbols
        names = [f'{each.name}[{", ".join(each.arguments)}]' for each in symbols]
        values = [Field(type='float', name=name, value='1.0') for name in names]
        samples = [Sample(fields=values) for _ in range(states)]
        for second, sample in enumerate(samples, 1):
            sample.valid_time.sec = second
        client.publish(Sample, topic, samples, quality=STREAM)
    client.ask(FormulaGroupDestroy, f'{REASONER}/formula_group_destroy', **fields)


def _balanced(parts: list[str]) -> str:
    """Return a conjunction of parts, balanced as deep chains are refused."""
    while len(parts) > 1:
        parts = [f'({" and ".join(parts[at : at + 2])})' for at in range(0, len(parts), 2)]
    return parts[0]


LIMITS: dict[str, tuple[str, int, int]] = {
    # Refused:
    'objects_100_cubed': (
        'forall a in Many: forall b in Many: forall c in Many: always D[a, b] > E[c]', 100, 0,
    ),
    'a_million_objects': ('forall a in Many: p[a]', 1_000_000, 0),
    # As large as the limits allow: 10,000 instances, 4900 objects, some 20,000 words.
    'the_largest_formula': ('forall a in Many: forall b in Many: always D[a, b] > 0', 100, 5),
    'the_largest_disjunction': (
        'always exists a in Many: eventually[0 s, 2 s] (D[a] > 0 or E[a] > 2)', 4900, 3,
    ),
    'long_texts': (_balanced([f'p{number} < {number}' for number in range(5000)]), 1, 0),
}  # fmt: skip
"""Formulas, the number of their objects, and the states of them that are published."""

ROWS: dict[str, Callable[[HostileClient], None]] = {
    **{
        each.__name__: each
        for each in (
            random_requests, random_goals, flood, killed_client, forged_messages,
            malformed_source, objects_of_a_crowd_cubed,
        )
    },
    **{
        name: partial(_evaluate, formula=formula, count=count, states=states)
        for name, (formula, count, states) in LIMITS.items()
    },
}  # fmt: skip
"""All rows, by name."""
