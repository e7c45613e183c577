"""Hostile rows for streams and formulas: products, doublings, rulers, and what nobody uses."""

from __future__ import annotations

from dyknow_interfaces.msg import Domain
from dyknow_interfaces.srv import (
    AddSemanticSpecification,
    EvaluateFormula,
    FormulaGroupAddFormula,
    FormulaGroupCreate,
    FormulaGroupDestroy,
    FormulaGroupEvaluate,
    OntologyLoad,
    StreamCreateFromSpec,
    StreamRegister,
)
from hostile_client import HostileClient
from sensor_msgs.msg import BatteryState

from dyknow_common import SECOND_NS
from dyknow_common.ros import nanoseconds_to_duration

REASONER = 'stream_reasoning_engine'
EVALUATE = 'stream_reasoning_coordinator/evaluate_formula'
CREATE = 'stream_manager/stream_create_from_spec'
TIMEOUT = nanoseconds_to_duration(5 * SECOND_NS)
DRONES = 200
FIELD_DOUBLINGS = 12
BATTERY = 'select current from "/uav1/battery"'


def product_100(client: HostileClient) -> None:
    """Evaluate a formula over 100 * 100 * 100 objects."""
    _product(client, 100)


def product_200(client: HostileClient) -> None:
    """Evaluate a formula over 200 * 200 * 200 objects."""
    _product(client, 200)


def sort_million(client: HostileClient) -> None:
    """Evaluate a formula over a sort of a million objects."""
    _evaluate(client, 'forall a in A: always F[a] > 0', {'A': 1_000_000})


def _product(client: HostileClient, number: int) -> None:
    formula = 'forall a in A: forall b in B: forall c in C: always F[a, b] > F[b, c]'
    _evaluate(client, formula, dict.fromkeys('ABC', number))


def _evaluate(client: HostileClient, formula: str, sizes: dict[str, int]) -> None:
    group = _group(client, formula)
    if group is None:
        return
    domains = [
        Domain(sort=sort, objects=[f'{sort.lower()}{each}' for each in range(size)])
        for sort, size in sizes.items()
    ]
    client.call(
        FormulaGroupEvaluate,
        f'{REASONER}/formula_group_evaluate',
        formula_group_id=group,
        domains=domains,
        state_stream='hostile/states',
        result_topic='hostile/results',
    )
    client.ask(FormulaGroupDestroy, f'{REASONER}/formula_group_destroy', formula_group_id=group)


def _group(client: HostileClient, *formulas: str) -> int | None:
    """Return the id of a new group with formulas."""
    answer = client.call(
        FormulaGroupCreate, f'{REASONER}/formula_group_create', formula_group_name='hostile'
    )
    if answer is None or answer.exit_status.code:
        return None
    group = int(answer.formula_group_id)
    for formula in formulas:
        client.ask(
            FormulaGroupAddFormula,
            f'{REASONER}/formula_group_add_formula',
            formula_group_id=group,
            formula_name='hostile',
            formula=formula,
        )
    return group


def nested_forall(client: HostileClient) -> None:
    """Evaluate a formula over the product of three times 200 vehicles that have a stream."""
    _make_drones(client)
    client.call(
        EvaluateFormula,
        EVALUATE,
        formula='forall a in Drone: forall b in Drone: forall c in Drone: '
        'always Altitude[a] + Altitude[b] > Altitude[c]',
        timeout=TIMEOUT,
    )


def _make_drones(client: HostileClient) -> None:
    """Declare vehicles of a sort of their own; their altitudes are on one topic."""
    uav, kind = (
        'http://www.dyknow.org/robots/uav',
        'http://www.w3.org/1999/02/22-rdf-syntax-ns#type',
    )
    owl, rdfs = 'http://www.w3.org/2002/07/owl#', 'http://www.w3.org/2000/01/rdf-schema#'
    triples = [
        f'<http://hostile> <{kind}> <{owl}Ontology> .',
        f'<http://hostile> <{owl}imports> <{uav}> .',
        f'<http://hostile#Drone> <{kind}> <{owl}Class> .',
        f'<http://hostile#Drone> <{rdfs}subClassOf> <{uav}#Vehicle> .',
    ]
    for number in range(DRONES):
        drone = f'<http://hostile#drone{number}> <{kind}>'
        triples += [f'{drone} <{owl}NamedIndividual> .', f'{drone} <http://hostile#Drone> .']
    client.call(
        OntologyLoad,
        'ontology_manager/ontology_load',
        content='\n'.join([*triples, '']),
        format='ntriples',
    )
    _create(client, 'hostile_drones', 'select serial_number, current from "/hostile/drones"')
    messages = [
        BatteryState(serial_number=f'drone{number}', current=1.0) for number in range(DRONES)
    ]
    client.publish(BatteryState, '/hostile/drones', messages)
    client.call(
        AddSemanticSpecification,
        'stream_semantics_manager/add_semantic_specification',
        ssl_statement='stream hostile_drones contains Altitude[d] = current '
        'for every d in Drone where d = serial_number',
    )


def equivalences(client: HostileClient) -> None:
    """Evaluate long chains of equivalences, and formulas whose residuals grow."""
    for length in (20, 500, 5000):
        chain = ' <-> '.join(f'Power[uav1] > {each}' for each in range(length))
        client.call(EvaluateFormula, EVALUATE, formula=chain, timeout=TIMEOUT)
        group = _group(client, chain)
        if group is not None:
            client.ask(
                FormulaGroupDestroy, f'{REASONER}/formula_group_destroy', formula_group_id=group
            )
    until = ' until[0 s, 9 s] '.join(f'Power[uav{1 + each % 3}] > {each}' for each in range(40))
    client.call(EvaluateFormula, EVALUATE, formula=f'always ({until})', timeout=TIMEOUT)


def doubling_streams(client: HostileClient) -> None:
    """Create streams that each read their predecessor twice."""
    for lines in (25, 60, 2000):
        merges = ''.join(f'stream a{each + 1} = merge(a{each}, a{each}); ' for each in range(lines))
        text = f'stream a0 = {BATTERY}; {merges} sink a{lines}'
        _create(client, f'hostile_merges_{lines}', text)
    text = 'stream a0 = select current as f from "/uav1/battery"; '
    for each in range(FIELD_DOUBLINGS):
        names = [f'f{number:0{each}b}' if each else 'f' for number in range(2**each)]
        left = ', '.join(f'{name} as {name}0' for name in names)
        right = ', '.join(f'{name} as {name}1' for name in names)
        text += (
            f'stream a{each + 1} = sync(select {left} from a{each}, select {right} from a{each}); '
        )
    _create(client, 'hostile_fields', f'{text} sink a{FIELD_DOUBLINGS}')


def wide_streams(client: HostileClient) -> None:
    """Create streams of thousands of inputs and fields."""
    for number in (500, 5000):
        inputs = ', '.join(f'select current as c{n} from "/uav1/battery"' for n in range(number))
        fields = ', '.join(f'current as c{n}' for n in range(number))
        _create(client, f'hostile_sync_{number}', f'sync({inputs}) with sample_period = 1 ms')
        _create(
            client, f'hostile_merge_{number}', 'merge(' + f'{BATTERY}, ' * number + BATTERY + ')'
        )
        _create(client, f'hostile_select_{number}', f'select {fields} from "/uav1/battery"')


def rulers(client: HostileClient) -> None:
    """Create streams from texts with rulers of comment signs, quotes and brackets."""
    for ruler in ('#' * 900_000, '#' + '-' * 900_000, '# ' * 400_000, '#=\n' * 200_000,
                  '"' * 900_001, '(' * 900_000, '/*' * 400_000):  # fmt: skip
        _create(client, 'hostile_ruler', f'{ruler}\n{BATTERY}')


def long_names(client: HostileClient) -> None:
    """Create and register streams with names that are empty, wrong, or longer than DDS allows."""
    for name in ('', '/', 'a b', '0', 'a' * 200, 'b' * 256, 'c' * 1_000_000):
        _create(client, name, BATTERY)
        _create(client, 'hostile_topic', f'select current from "/{name}"')
        client.ask(
            StreamRegister,
            'stream_manager/stream_register',
            stream_name=f'hostile{len(name)}',
            topic_name=name,
            message_type=name,
        )
        for field in ('state_stream', 'result_topic'):
            group = _group(client, 'always hostile.x > 0')
            if group is None:
                continue
            client.ask(
                FormulaGroupEvaluate,
                f'{REASONER}/formula_group_evaluate',
                formula_group_id=group,
                **{'state_stream': 'hostile/s', 'result_topic': 'hostile/r', field: name},
            )
            client.ask(
                FormulaGroupDestroy, f'{REASONER}/formula_group_destroy', formula_group_id=group
            )


def unused_groups(client: HostileClient) -> None:
    """Create hundreds of formula groups that nobody evaluates."""
    for number in range(300):
        _group(client, *(f'always Power[uav{each}] < {number}' for each in (1, 2, 3)))


def unused_streams(client: HostileClient) -> None:
    """Create dozens of streams that nobody reads."""
    first = client.chance.randrange(10**9)
    for number in range(first, first + 50):
        _create(client, f'hostile_{number}', BATTERY)


def _create(client: HostileClient, name: str, text: str) -> None:
    request = StreamCreateFromSpec.Request()
    request.spec.name, request.spec.specification = name, text
    client.ask(StreamCreateFromSpec, CREATE, request)


ROWS = (
    product_100, product_200, sort_million, nested_forall, equivalences, doubling_streams,
    wide_streams, rulers, long_names, unused_groups, unused_streams,
)  # fmt: skip
