"""The knee of each resource: the number beyond which DyKnow gets slow, refuses or loses.

python benchmarks/knees.py [--json] [--quick]
    [--only evaluations|formulas|annotations]

Each resource grows until one of these does not hold any more, in the last row: another client gets
the verdict of a first state within half a second, with 99 % of its requests; no node takes more
than 0.9 of a core; and all requests are answered, without a refusal.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

from dyknow_interfaces.msg import Domain, ExitStatus, FormulaResult
from dyknow_interfaces.srv import (
    AddSemanticSpecification,
    FormulaGroupAddFormula,
    FormulaGroupCreate,
    FormulaGroupEvaluate,
)
from parts import measure
from processes import MANAGER, percentile, use_private_domain
from rclpy.task import Future
from running_system import AT_ONCE, REASONER, RunningSystem, timed

RATE = 10.0
VEHICLES = 3
HIGH = 500.0
PROBE_PERIOD_S = 0.25
MAX_P99_MS = 500.0
MAX_SHARE = 0.9
ANSWER_LIMIT_S = 60.0
AT_ONCE_REQUESTS = 200
"""Requests that wait for an answer at once, where one follows the other."""

ANNOTATIONS_OF_A_TEXT = 100


def evaluations(*, quick: bool) -> Any:
    """Grow the evaluations that the coordinator runs at once; then a high level decides them."""
    sizes = (20, 50) if quick else (50, 100, 200, 400, 800, 1600, 3200)
    with RunningSystem(VEHICLES, RATE) as system:
        system.warm_up()
        futures: list[Future] = []

        def grow(number: int) -> dict[str, int]:
            known = len(system.running)
            more = number - len(futures)
            futures.extend(
                system.ask(f'forall u in UAV: always Power[u] < {100 + len(futures) + each}')
                for each in range(more)
            )
            new = futures[-more:]
            _wait(
                system,
                lambda: len(system.running) - known >= sum(not f.done() for f in new),
            )
            return _outcomes(each for each in new if each.done())

        rows = _grown(system, sizes, grow, quick=quick)
        system.command('set', 'uav1', 10_000.0)
        _wait(system, lambda: all(each.done() for each in futures))
        rows[-1]['all_answers'] = _outcomes(futures)
        return rows


def formulas(*, quick: bool) -> Any:
    """Grow a formula group of the reasoning engine, over the states of the fleet."""
    with RunningSystem(VEHICLES, RATE) as system:
        system.warm_up()
        group = _make_group(system)

        def fields(number: int) -> dict[str, Any]:
            formula = f'always Power[uav{1 + number % VEHICLES}] < {100 + number}'
            name = f'formula {number}'
            return {'formula_group_id': group, 'formula_name': name, 'formula': formula}

        service = f'{REASONER}/formula_group_add_formula'
        return _grown_by_requests(system, FormulaGroupAddFormula, service, fields, quick=quick)


def _make_group(system: RunningSystem) -> int:
    """Return the id of a formula group that is evaluated over the power of all vehicles."""
    names = [f'uav{number}' for number in range(1, VEHICLES + 1)]
    inputs = ', '.join(f'select power as "Power[{name}]" from {name}_power' for name in names)
    topic = system.client.create('knee_states', f'sync({inputs})', MANAGER)
    created = system.client.call(
        FormulaGroupCreate, f'{REASONER}/formula_group_create', formula_group_name='knee'
    )
    group = int(created.formula_group_id)
    system.client.call(
        FormulaGroupAddFormula,
        f'{REASONER}/formula_group_add_formula',
        formula_group_id=group,
        formula_name='first',
        formula=' and '.join(f'always Power[{name}] < {HIGH}' for name in names),
    )
    # A group without a subscriber of its results and without requests is destroyed.
    system.client.node.create_subscription(FormulaResult, '/knee_results', lambda _: None, 1000)
    answer = system.client.call(
        FormulaGroupEvaluate,
        f'{REASONER}/formula_group_evaluate',
        formula_group_id=group,
        domains=[Domain(sort='UAV', objects=names)],
        state_stream=topic,
        result_topic='/knee_results',
    )
    assert answer.exit_status.code == ExitStatus.SUCCESS, answer
    return group


def annotations(*, quick: bool) -> Any:
    """Grow the annotations of streams."""
    with RunningSystem(VEHICLES, RATE) as system:
        system.warm_up()

        def fields(first: int) -> dict[str, Any]:
            numbers = range(first, first + ANNOTATIONS_OF_A_TEXT)
            texts = (f'stream knee{each} contains Altitude[uav1] = x;\n' for each in numbers)
            return {'ssl_statement': ''.join(texts)}

        service = 'stream_semantics_manager/add_semantic_specification'
        return _grown_by_requests(
            system, AddSemanticSpecification, service, fields, ANNOTATIONS_OF_A_TEXT, quick=quick
        )


def _grown_by_requests(
    system: RunningSystem,
    kind: Any,
    service: str,
    fields: Callable[[int], dict[str, Any]],
    step: int = 1,
    *,
    quick: bool,
) -> list[dict[str, Any]]:
    """Return a row for each size of a resource that requests make larger.

    Args:
        system: has the resource.
        kind: of the service.
        service: its name.
        fields: returns those of the request for the resource's part with a number.
        step: by which a request makes the resource larger.
        quick: True for small sizes.
    """
    sizes = (200, 500) if quick else (1000, 3000, 10_000, 30_000, 100_000)
    size = 0

    def grow(number: int) -> dict[str, int]:
        nonlocal size
        waiting, size = range(size, number, step), number
        futures: list[Future] = []
        for place in range(0, len(waiting), AT_ONCE_REQUESTS):
            part = waiting[place : place + AT_ONCE_REQUESTS]
            futures += [system.client.request(kind, service, **fields(each)) for each in part]
            _wait(system, lambda: all(each.done() for each in futures))  # noqa: B023
        return _outcomes(futures)

    return _grown(system, sizes, grow, quick=quick)


def _grown(
    system: RunningSystem,
    sizes: Iterable[int],
    grow: Callable[[int], dict[str, int]],
    *,
    quick: bool,
) -> list[dict[str, Any]]:
    """Return a row for each size until one is beyond the knee.

    Args:
        system: has the resource.
        sizes: growing.
        grow: makes the resource as large as its argument, and counts the answers to this.
        quick: True for shorter measurements.
    """
    rows: list[dict[str, Any]] = []
    for number in sizes:
        answers = grow(number)
        row = {'number': number, 'answers': answers, **_load(system, 4.0 if quick else 15.0)}
        row['ok'] = (
            row['probe_p99_ms'] < MAX_P99_MS
            and row['most_busy'][1] < MAX_SHARE
            and not row['probe_failures']
            and not set(answers) - {'success'}
        )
        rows.append(row)
        if not row['ok']:
            break
    return rows


def _load(system: RunningSystem, seconds: float) -> dict[str, Any]:
    """Return the costs of the nodes over a time, and the latencies of another client."""
    probes: list[tuple[int, Future, list[int]]] = []

    def probe() -> None:
        begun, future = time.time_ns(), system.ask(AT_ONCE)
        probes.append((begun, future, timed(future)))

    timer = system.client.node.create_timer(PROBE_PERIOD_S, probe)
    costs = system.costs(seconds)
    system.client.node.destroy_timer(timer)
    _wait(system, lambda: all(ended for *_, ended in probes))
    now = time.time_ns()
    delays = [(ended[0] if ended else now) - begun for begun, _, ended in probes]
    outcomes = _outcomes(future for _, future, _ in probes)
    outcomes.pop('verdict', None)
    busiest = max(costs, key=lambda name: costs[name]['share'])
    largest = max(costs, key=lambda name: costs[name]['memory_mb'])
    return {
        'probe_median_ms': round(percentile(delays, 50) / 1e6, 1),
        'probe_p99_ms': round(percentile(delays, 99) / 1e6, 1),
        'probe_failures': outcomes,
        'most_busy': [busiest, costs[busiest]['share']],
        'most_memory': [largest, costs[largest]['memory_mb']],
    }


def _outcomes(futures: Iterable[Future]) -> dict[str, int]:
    """Count the answers: verdicts, successes without one, errors with their messages, losses."""
    found: Counter[str] = Counter()
    for each in futures:
        if not each.done():
            found['lost'] += 1
            continue
        answer = each.result()
        if answer.exit_status.code:
            found[f'error {answer.exit_status.code}: {answer.exit_status.message[:200]}'] += 1
        else:
            found['verdict' if getattr(answer, 'verdict', 0) else 'success'] += 1
    return dict(found)


def _wait(system: RunningSystem, condition: Callable[[], bool]) -> None:
    """Wait for a condition, but not for ever: what is missing then is counted as lost."""
    end = time.monotonic() + ANSWER_LIMIT_S
    system.client.spin_until(
        lambda: condition() or time.monotonic() > end, 'time', ANSWER_LIMIT_S + 1.0
    )


if __name__ == '__main__':
    use_private_domain()
    measure(__doc__, evaluations, formulas, annotations)
