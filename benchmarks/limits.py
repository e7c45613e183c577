"""Latency of normal requests, and memory, while another client sends requests that are too large.

python benchmarks/limits.py [--json] [--quick] [--only products|...]

Each part runs the hostile client in a process of its own, which repeats one kind of request, while
another one has formulas evaluated that the first state decides, one after the other.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from dyknow_interfaces import srv
from dyknow_interfaces.msg import Domain, Field, FormulaResult, Sample
from parts import measure
from processes import Client, resident_memory, result_of, summary, use_private_domain, worker
from running_system import COORDINATOR, EVALUATE, REASONER, RunningSystem, ask, timed

from dyknow_common.ros import STREAM

NORMAL = 'forall u in UAV: Power[u] > 0'
PAIRS = 'forall a in Many: forall b in Many: always D[a, b] > 0'
TRIPLES = 'forall a in Many: forall b in Many: forall c in Many: always D[a, b] > E[c]'
CROWD = 202


def evaluated(client: Client, formula: str, count: int, states: int = 0) -> Any:
    """Evaluate a formula for some objects in a group of its own; return the exit status."""

    def call(service: str, **fields: Any) -> Any:
        name = ''.join(f'_{each.lower()}' if each.isupper() else each for each in service)[1:]
        return client.call(getattr(srv, service), f'{REASONER}/{name}', **fields)

    group = call('FormulaGroupCreate', formula_group_name='hostile').formula_group_id
    call('FormulaGroupAddFormula', formula_group_id=group, formula_name='f', formula=formula)
    objects = [f'o{number}' for number in range(count)]
    topic = f'/hostile_{group}'
    answer = call(
        'FormulaGroupEvaluate',
        formula_group_id=group,
        domains=[Domain(sort='Many', objects=objects)],
        state_stream=topic,
        result_topic=f'{topic}_results',
    )
    if states and not answer.exit_status.code:
        symbols = call('FormulaGroupExtractSymbols', formula_group_id=group).symbols
        names = [f'{each.name}[{", ".join(each.arguments)}]' for each in symbols]
        fields = [Field(type='float', name=name, value='1.0') for name in names]
        publisher = client.node.create_publisher(Sample, topic, STREAM)
        client.spin_until(lambda: publisher.get_subscription_count() > 0, 'the engine')
        for number in range(states):
            sample = Sample(fields=fields)
            sample.valid_time.sec = number + 1
            publisher.publish(sample)
        client.node.destroy_publisher(publisher)
    call('FormulaGroupDestroy', formula_group_id=group)
    return answer.exit_status


def long_text() -> str:
    """Return a formula of some 20,000 words, balanced as deep chains are refused."""
    parts = [f'p{number} < {number}' for number in range(5000)]
    while len(parts) > 1:
        parts = [f'({" and ".join(parts[at : at + 2])})' for at in range(0, len(parts), 2)]
    return parts[0]


def abandoned(client: Client) -> Any:
    """Create a group that nobody evaluates, with a formula."""
    made = client.call(srv.FormulaGroupCreate, f'{REASONER}/formula_group_create')
    if made.exit_status.code:
        return made.exit_status
    fields = {'formula_group_id': made.formula_group_id, 'formula': 'always p'}
    service = f'{REASONER}/formula_group_add_formula'
    return client.call(srv.FormulaGroupAddFormula, service, **fields).exit_status


def asked(client: Client, formula: str) -> Any:
    """Have the coordinator evaluate a formula."""
    future = ask(client, EVALUATE, formula, 10.0)
    client.spin_until(future.done, formula)
    return future.result().exit_status


HOSTILE: dict[str, Callable[[Client], Any]] = {
    'nothing': lambda client: time.sleep(0.1) or asked(client, ''),
    'objects_100_cubed': lambda client: evaluated(client, TRIPLES, 100),
    'objects_200_cubed': lambda client: evaluated(client, TRIPLES, 200),
    'a_million_objects': lambda client: evaluated(client, 'forall a in Many: p[a]', 1_000_000),
    'the_largest_formula': lambda client: evaluated(client, PAIRS, 100, states=5),
    'the_largest_disjunction': lambda client: evaluated(
        client, 'always exists a in Many: eventually[0 s, 2 s] (D[a] > 0 or E[a] > 2)', 4900, 3
    ),
    'long_texts': lambda client: evaluated(client, long_text(), 1),
    'abandoned_groups': abandoned,
    'coordinator_202_cubed': lambda client: asked(
        client,
        'forall a in Crowd: forall b in Crowd: forall c in Crowd: always XYDist[a, b] > Power[c]',
    ),
    'coordinator_202': lambda client: asked(client, 'forall a in Crowd: always Power[a] > 0'),
}


def be_hostile(name: str) -> None:
    """Repeat a kind of request until the end of the input; print the answers."""
    client, answers, slowest = Client(), Counter[str](), 0.0
    print('started', flush=True)
    ends: list[str] = []
    os.set_blocking(sys.stdin.fileno(), False)
    while not ends:
        begun = time.monotonic()
        status = HOSTILE[name](client)
        slowest = max(slowest, time.monotonic() - begun)
        answers[f'{status.code}: {status.message}'[:160]] += 1
        ends = [line for line in (sys.stdin.readline(),) if line]
    print(json.dumps({'answers': answers.most_common(3), 'slowest_s': round(slowest, 2)}))


def rows(names: Iterator[str], *, quick: bool) -> Iterator[Any]:
    """Yield the costs beside each kind of request."""
    seconds = 6.0 if quick else 30.0
    with RunningSystem(3, 20.0) as system:
        crowd = ['Crowd', *(f'c{number}' for number in range(CROWD))]
        service = 'ontology_manager/'
        system.client.call(
            srv.ConceptCreate, f'{service}concept_create', concept_name='Crowd',
            parent_concepts=['Object'],
        )  # fmt: skip
        for name in crowd[1:]:
            system.client.call(
                srv.InstanceCreate, f'{service}instance_create', instance_name=name,
                concept_names=['Crowd'],
            )  # fmt: skip
        for name in names:
            yield _beside(system, name, seconds)
        with worker('the_largest_formula', program=Path(__file__)):
            time.sleep(3.0)
            begun = time.monotonic()
            os.kill(system.pids[REASONER], signal.SIGTERM)
            while Path(f'/proc/{system.pids[REASONER]}/cmdline').read_bytes():
                time.sleep(0.02)
            yield {'beside': 'the_largest_formula', 'ended_s': round(time.monotonic() - begun, 2)}


def _beside(system: RunningSystem, name: str, seconds: float) -> Any:
    delays, memory = [], Counter[str]()
    with worker(name, program=Path(__file__)) as hostile:
        assert hostile.stdout
        hostile.stdout.readline()
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            begun = time.time_ns()
            future = system.ask(NORMAL, 20.0)
            ended = timed(future)
            system.client.spin_until(lambda: bool(ended), 'the answer', 60.0)  # noqa: B023
            answer = future.result()
            assert answer.verdict == FormulaResult.TRUE, answer.exit_status
            delays.append(ended[0] - begun)
            for node in (REASONER, COORDINATOR):
                memory[node] = max(memory[node], round(resident_memory(system.pids[node])))
        assert hostile.stdin
        hostile.stdin.write('end\n')
        hostile.stdin.flush()
        return {'beside': name, **summary(delays), 'mb': dict(memory), **result_of(hostile)}


def all_rows(*, quick: bool) -> Any:
    """Measure all rows."""
    return list(rows(iter(HOSTILE), quick=quick))


def main() -> None:
    """Measure and print."""
    if len(sys.argv) > 1 and sys.argv[1] in HOSTILE:
        be_hostile(sys.argv[1])
        return
    use_private_domain()
    measure(__doc__, all_rows)


if __name__ == '__main__':
    main()
