"""Speed of progression, compared with other tools in the same run.

`python benchmarks/progression.py [--json] [--peers PYTHON] [--memory]`; see README.md.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any

import numpy as np
from parts import ask_peers

from dyknow_reasoning import FormulaGroup, FormulaLimits

PERIOD_NS = 100_000_000
REPETITIONS = 5
MILLIONS = 10
NO_LIMIT = 1 << 62
RESPONSE = 'always (Alt[x] > 2 -> eventually[0, 5 s] Alt[x] < 2)'
PAPER = 'always (not p[x] -> eventually[0, 1000] always[0, 999] p[x])'
POWER = 'always (Power[x] > 150 -> Power[x] < 200 until[0 s, 5 s] always[0 s, 3 s] Power[x] <= 150)'
PAST = {
    'once': 'always (Alt[x] > 4 -> once[0, 5 s] Alt[x] < 2)',
    'once from 1 s': 'always (Alt[x] > 4 -> once[1 s, 5 s] Alt[x] < 2)',
    'since': 'always (Alt[x] > 4 -> Alt[x] > 2 since[0, 5 s] Alt[x] < 2)',
}
GROWING = 'always (p -> eventually[0, 5 s] (q and always[0, 2 s] (r or eventually[0, 1 s] s)))'
SAWTOOTH = [3.0] * 20 + [1.0] * 20
PULSES = [190.0] * 6 + [140.0] * 3
SURGES = [140.0] * 10 + [190.0] * 40 + [140.0] * 50
STREAMS = {
    'best': [True],
    'rare': [False] + [True] * 99,
    'often': [False] + [True] * 19,
    'worst': [False] * 5 + [True] * 25,
}


def group_of(
    text: str, objects: int, *, separate: bool = False, every_state: bool = False
) -> FormulaGroup:
    """Return a group of one quantified formula, or of a separate formula for each object."""
    names = [f'o{index}' for index in range(objects)]
    group = FormulaGroup(FormulaLimits(node_limit=NO_LIMIT, part_limit=NO_LIMIT))
    for name in names if separate else ():
        group.add_formula(name, text.replace('[x]', f'[{name}]'))
    if not separate:
        group.add_formula('all', f'forall x in S: {text}', every_state=every_state)
    group.begin({'S': names})
    return group


def times_of(states: int, *, regular: bool) -> list[int]:
    """Return valid times with a fixed period, or with random steps around it."""
    if regular:
        return [index * PERIOD_NS for index in range(states)]
    steps = np.random.default_rng(1).integers(PERIOD_NS // 2, 3 * PERIOD_NS // 2, states)
    found: list[int] = np.cumsum(steps).tolist()
    return found


def repeated(run: Callable[[], float]) -> float:
    """Return the median of some runs."""
    return median(run() for _ in range(REPETITIONS))


def one_formula(text: str, feature: str, wave: Sequence[Any], *, regular: bool) -> float:
    """Return the microseconds for a state, a dict of one value."""
    states = 50_000
    times = times_of(states, regular=regular)
    cycle = [{f'{feature}[o0]': value} for value in wave]
    values = [cycle[index % len(cycle)] for index in range(states)]

    def run() -> float:
        progress = group_of(text, 1).progress
        begin = process_time()
        for time, state in zip(times, values, strict=True):
            if progress(time, state):
                raise AssertionError('the stream must keep the formula undecided')
        return (process_time() - begin) / states * 1e6

    return repeated(run)


def margins(text: str, objects: int, *, ask: bool = False) -> float:
    """Return the microseconds for a state with the margin of a formula.

    Args:
        text: the formula.
        objects: the number of objects.
        ask: True to ask for the margin after each state.
    """
    states = 20_000 // objects
    times = times_of(states, regular=True)
    names = [f'o{index}' for index in range(objects)]
    cycle = [{f'Alt[{name}]': value for name in names} for value in SAWTOOTH]

    def run() -> float:
        group = FormulaGroup()
        formula_id = group.add_formula('it', f'forall x in S: {text}', margin=True)
        group.begin({'S': names})
        begin = process_time()
        for index, time in enumerate(times):
            assert not group.progress(time, cycle[index % len(cycle)])
            if ask:
                group.margin(formula_id)
        cost = (process_time() - begin) / states * 1e6
        # The least margin: the longest climb above 2 was followed by a fall to 1 in time.
        assert (found := group.margin(formula_id)) is not None
        assert found.upper == (1.0 if text == RESPONSE else 2.0)
        return cost

    return repeated(run)


def growing(*, regular: bool) -> list[float]:
    """Return the microseconds for each state of a formula that grows and never repeats."""
    states = 3000
    rng = np.random.default_rng(6)
    truths = (rng.random((states, 4)) < [0.5, 0.6, 0.8, 0.8]) | (np.arange(states) % 7 == 0)[
        :, None
    ]
    group = FormulaGroup()
    group.add_formula('it', GROWING)
    group.begin({})
    costs = []
    for time, row in zip(times_of(states, regular=regular), truths.tolist(), strict=True):
        state = dict(zip('pqrs', row, strict=True))
        begin = process_time()
        results = group.progress(time, state)
        costs.append((process_time() - begin) * 1e6)
        assert not results
    return costs


def from_dicts(
    group: FormulaGroup, feature: str, objects: int, wave: Sequence[Any], *, states: int = 1000
) -> list[float]:
    """Return the microseconds for each state, a dict with a value for each object."""
    rng = np.random.default_rng(2)
    phases = rng.integers(0, len(wave), objects).tolist()
    distinct = len(wave)
    cycle = [
        {
            f'{feature}[o{number}]': wave[(index + phase) % len(wave)]
            for number, phase in enumerate(phases)
        }
        for index in range(distinct)
    ]
    costs = []
    for index in range(max(distinct, min(states, 3_000_000 // objects))):
        begin = process_time()
        results = group.progress(index * PERIOD_NS, cycle[index % distinct])
        costs.append((process_time() - begin) * 1e6)
        assert not results
    return costs


def recorded(
    text: str,
    feature: str,
    wave: Sequence[Any],
    objects: int,
    *,
    regular: bool,
) -> float:
    """Return the nanoseconds for a state and an object in a recording of columns."""
    states = 2000
    phases = np.random.default_rng(3).integers(0, len(wave), objects).tolist()
    cycle = np.array((list(wave) * (2 + 2 * states // len(wave)))[: 2 * states + len(wave)])
    columns = {
        f'{feature}[o{number}]': cycle[phase : phase + states]
        for number, phase in enumerate(phases)
    }
    times = times_of(2 * states, regular=regular)
    group = group_of(text, objects)
    assert not group.progress_many(times[:states], columns)
    begin = process_time()
    assert not group.progress_many(times[states:], columns)
    return (process_time() - begin) / states / objects * 1e9


def check_equality() -> None:
    """Check that all execution paths agree, over streams that violate the formulas."""
    rng = np.random.default_rng(4)
    objects, states = 30, 600
    for text, feature, data in (
        (RESPONSE, 'Alt', rng.choice([1.0] + [3.0] * 19, (objects, states))),
        (POWER, 'Power', rng.uniform(100, 200, (objects, states))),
        (PAPER, 'p', rng.choice([False] + [True] * 19, (objects, states))),
        *(
            (text, 'Alt', rng.choice([1.0, 5.0] + [3.0] * 40, (objects, states)))
            for text in PAST.values()
        ),
    ):
        columns = {f'{feature}[o{index}]': row for index, row in enumerate(data)}
        for regular in (True, False):
            times = times_of(states, regular=regular)
            at_once = group_of(text, objects, separate=True).progress_many(times, columns)
            group = group_of(text, objects, separate=True)
            rows = [dict(zip(columns, row.tolist(), strict=True)) for row in data.T]
            each = [
                one
                for time, row in zip(times, rows, strict=True)
                for one in group.progress(time, row)
            ]
            alone = []
            for index in range(objects):
                single = FormulaGroup()
                single.add_formula(f'o{index}', text.replace('[x]', f'[o{index}]'))
                single.begin({})
                alone += [
                    one
                    for time, row in zip(times, rows, strict=True)
                    for one in single.progress(time, row)
                ]
            assert at_once == each
            verdicts = {(one.name, one.verdict, one.decided_at) for one in each}
            assert verdicts == {(one.name, one.verdict, one.decided_at) for one in alone}


def do_nothing(_time: int, _values: dict[str, bool]) -> list[object]:
    """Return no results."""
    return []


def baseline() -> float:
    """Return the microseconds of the loop that calls `progress`: the speed of this machine."""
    times, state = times_of(50_000, regular=True), {'p': True}

    def run() -> float:
        begin = process_time()
        for time in times:
            if do_nothing(time, state):
                raise AssertionError
        return (process_time() - begin) / len(times) * 1e6

    return repeated(run)


def measurements() -> Iterator[tuple[str, str, float]]:
    """Yield the name, the unit and the value of each measurement."""
    yield 'the loop that calls progress, as a baseline', 'us a state', baseline()
    for regular in (True, False):
        kind = 'regular' if regular else 'irregular'
        microseconds = f'us a state, {kind}'
        yield (
            'bounded response',
            microseconds,
            one_formula(RESPONSE, 'Alt', SAWTOOTH, regular=regular),
        )
        yield 'figure 8', microseconds, one_formula(PAPER, 'p', STREAMS['often'], regular=regular)
        for name, text in PAST.items():
            yield name, microseconds, one_formula(text, 'Alt', SAWTOOTH, regular=regular)
        yield 'power', microseconds, one_formula(POWER, 'Power', SURGES, regular=regular)
        costs = growing(regular=regular)
        yield 'nested formula that grows, mean', microseconds, sum(costs) / len(costs)
        yield 'nested formula that grows, worst state', microseconds, max(costs)
    for objects in (1, 100):
        what = 'objects' if objects > 1 else 'object'
        cost = margins(RESPONSE, objects)
        yield f'margin of bounded response, {objects} {what}', 'us a state', cost
        cost = margins('always Alt[x] < 5', objects)
        yield f'margin of an invariant, {objects} {what}', 'us a state', cost
    cost = margins(RESPONSE, 1, ask=True)
    yield 'margin of bounded response, asked for at each state', 'us a state', cost
    for name, wave in STREAMS.items():
        group = group_of(PAPER, 1000, separate=True)
        cost = median(from_dicts(group, 'p', 1000, wave))
        yield f'figure 8, 1000 separate formulas, {name}', 'formulas in 100 ms', 1000 * 100e3 / cost
    for name, wave in STREAMS.items():
        cost = recorded(PAPER, 'p', wave, 20_000, regular=True)
        yield f'figure 8, 20000 instances, {name}', 'formulas in 100 ms', 100e6 / cost
    for name, wave in STREAMS.items():
        cost = recorded(PAPER, 'p', wave, 20_000, regular=False)
        yield f'figure 8, 20000 instances, {name}', 'ns each, irregular', cost
    cost = median(from_dicts(group_of(RESPONSE, 100), 'Alt', 100, SAWTOOTH))
    yield 'bounded response, 100 objects', 'us a state', cost
    for name, text in PAST.items():
        cost = median(from_dicts(group_of(text, 100), 'Alt', 100, SAWTOOTH))
        yield f'{name}, 100 objects', 'us a state', cost
    for regular in (True, False):
        cost = recorded(PAST['once'], 'Alt', SAWTOOTH, 1000, regular=regular)
        kind = 'regular' if regular else 'irregular'
        yield 'once, 1000 instances in a recording', f'ns each, {kind}', cost
    costs = from_dicts(group_of(PAPER, 100_000), 'p', 100_000, STREAMS['often'])
    yield 'figure 8, 100000 instances, first states from a dict, worst', 'ms', max(costs) / 1000
    yield 'figure 8, 100000 instances, first states from a dict, median', 'ms', median(costs) / 1000
    yield from every_state()
    yield from growth()


def in_a_loop(
    text: str, feature: str, wave: Sequence[Any], *, regular: bool, every_state: bool
) -> float:
    """Return the microseconds for a state of one object, after the first 2000, in parts of 2000.

    The least of some parts is that with the least effect of other processes.
    """
    parts, states = 20, 2000
    times = times_of(parts * states, regular=regular)
    values = [{f'{feature}[o0]': wave[index % len(wave)]} for index in range(len(times))]
    progress = group_of(text, 1, every_state=every_state).progress
    costs = []
    for first in range(0, len(times), states):
        pairs = zip(times[first : first + states], values[first : first + states], strict=True)
        begin = process_time()
        for time, state in pairs:
            if progress(time, state):
                raise AssertionError('the stream must keep the formula undecided')
        costs.append((process_time() - begin) / states * 1e6)
    return min(costs[1:])


def open_runs(seconds: int) -> list[tuple[float, int]]:
    """Return the microseconds for a state in each quarter of a run, and the open runs after it.

    Triggers last for random times, and an answer comes shortly before the window ends.
    """
    states, random = 100_000, np.random.default_rng(7)
    wave = np.repeat([3.0, 1.0] * states, random.integers(1, 7, 2 * states))[:states]
    wave[:: 8 * seconds] = -1.0
    values = [{'Alt[o0]': value} for value in wave.tolist()]
    text = f'Alt[x] > 2 -> eventually[0, {seconds} s] Alt[x] < 0'
    group = group_of(text, 1, every_state=True)
    times = times_of(states, regular=True)
    found = []
    for quarter in range(4):
        part = slice(quarter * states // 4, (quarter + 1) * states // 4)
        begin = process_time()
        for time, state in zip(times[part], values[part], strict=True):
            group.progress(time, state)
        cost = (process_time() - begin) / (states // 4) * 1e6
        [formula] = group.standing.formulas.values()
        assert not formula.monitor.failure_count
        found.append((cost, len(formula.monitor.undecided())))
    return found


def every_state() -> Iterator[tuple[str, str, float]]:
    """Yield the costs of formulas asked at every state, beside the costs of one evaluation."""
    response, power = (text.removeprefix('always ') for text in (RESPONSE, POWER))
    nested = 'always[0, 1 s] eventually[0, 0.5 s] Power[x] > 150'
    positive = 'always Alt[x] > 0'
    late = 'Alt[x] > 2 -> eventually[0, 500 s] Alt[x] < 0'
    for what, body, single, feature, wave in (
        ('response', response, RESPONSE, 'Alt', SAWTOOTH),
        ('invariant', 'Alt[x] > 0', positive, 'Alt', SAWTOOTH),
        ('window of 5 s', 'always[0, 5 s] Alt[x] > 0', positive, 'Alt', SAWTOOTH),
        ('late response', late, positive, 'Alt', SAWTOOTH),
        ('power', power, POWER, 'Power', SURGES),
        ('nested windows', nested, f'always {nested}', 'Power', PULSES),
    ):
        for objects in (1, 100):
            for name, text in (('every state', body), ('once', single)):
                group = group_of(text, objects, every_state=text is body)
                costs = from_dicts(group, feature, objects, wave, states=2000)
                for part, some in (('first', costs[:1000]), ('next', costs[1000:])):
                    cost = sum(some) / len(some)
                    yield f'{what}, {objects} objects, {name}, {part} 1000', 'us a state', cost
        for regular in (True, False):
            for name, text in (('every state', body), ('once', single)):
                cost = in_a_loop(text, feature, wave, regular=regular, every_state=text is body)
                kind = 'regular' if regular else 'irregular'
                yield f'{what}, in a loop, {name}', f'us a state, {kind}', cost
    for seconds in (5, 50, 500):
        for part, (cost, runs) in enumerate(open_runs(seconds), 1):
            yield f'window of {seconds} s, quarter {part}, {runs} open runs', 'us a state', cost
    cost = recorded(RESPONSE, 'Alt', SAWTOOTH, 100, regular=True)
    yield 'response, 100 instances in a recording', 'ns each', cost


def growth() -> Iterator[tuple[str, str, float]]:
    """Yield costs for growing windows, numbers of formulas and numbers of objects."""
    for seconds in (1, 10, 100):
        text = RESPONSE.replace('5 s', f'{10 * seconds} s')
        for regular in (True, False):
            kind = 'regular' if regular else 'irregular'
            cost = one_formula(text, 'Alt', SAWTOOTH, regular=regular)
            yield f'window of {10 * seconds} s', f'us a state, {kind}', cost
    for formulas in (10, 100, 1000, 10_000):
        cost = median(
            from_dicts(group_of(PAPER, formulas, separate=True), 'p', formulas, STREAMS['often'])
        )
        yield f'{formulas} formulas', 'us a state', cost
    for objects in (10, 100, 1000, 10_000):
        cost = median(from_dicts(group_of(RESPONSE, objects), 'Alt', objects, SAWTOOTH))
        yield f'{objects} objects', 'us a state', cost


def memory() -> Iterator[tuple[str, str, float]]:
    """Yield the resident memory over ten million states at irregular times."""
    group = group_of(POWER, 1)
    cycle = [{'Power[o0]': value} for value in SURGES]
    steps = np.random.default_rng(5).integers(PERIOD_NS // 2, 3 * PERIOD_NS // 2, 1000).tolist()
    time, index = 0, 0
    for million in range(MILLIONS + 1):
        if million in {1, MILLIONS}:
            pages = int(Path('/proc/self/statm').read_text(encoding='utf-8').split()[1])
            yield f'resident after {million} million states', 'MiB', pages * 4096 / 2**20
        for _ in range(0 if million == MILLIONS else 1_000_000):
            time += steps[index % 1000]
            assert not group.progress(time, cycle[index % len(cycle)])
            index += 1


def peers(python: str) -> Iterator[tuple[str, str, float]]:
    """Yield the costs of other tools, which run in their own environment."""
    values = [SAWTOOTH[index % len(SAWTOOTH)] for index in range(50_000)]
    for tool, found in ask_peers(python, 'response', values=values).items():
        if found.get('violated') == [False, True]:
            yield f'{tool}, bounded response', 'us a state, regular', found['us']
        else:
            sys.stderr.write(f'{tool} is skipped: {found.get("error", "another verdict")}\n')


def main() -> None:
    """Check, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--json', action='store_true', help='print a line of JSON for each figure')
    parser.add_argument('--peers', metavar='PYTHON', help='of an environment with the other tools')
    parser.add_argument('--memory', action='store_true', help='also progress ten million states')
    options = parser.parse_args()
    check_equality()
    sources = [measurements()]
    sources += [peers(options.peers)] if options.peers else []
    sources += [memory()] if options.memory else []
    for source in sources:
        for what, unit, value in source:
            line = {'what': what, 'unit': unit, 'value': round(value, 3)}
            print(
                json.dumps(line) if options.json else f'{what:65} {value:14.3f} {unit}', flush=True
            )


if __name__ == '__main__':
    main()
