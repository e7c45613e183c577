"""Time for a state of spatial operators over a team of robots.

`python benchmarks/space_graph.py [--robots 100] [--states 50]` prints JSON: milliseconds a state,
without and with the margin of the formula.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from itertools import permutations
from math import hypot
from random import Random
from time import process_time

from dyknow_reasoning import FormulaGroup

PERIOD_NS = 100_000_000
POSITIONS = 'hypot(X[a] - X[b], Y[a] - Y[b]) <= 80'
CASES = {
    'somewhere, distances': ('Dist[a, b] <= 80', 'somewhere[0, 2000] Charge[s] > 20'),
    'somewhere, positions': (POSITIONS, 'somewhere[0, 2000] Charge[s] > 20'),
    'reach, positions': (POSITIONS, 'Charge[s] > 20 reach[0, 9 hops] Base[s]'),
    'escape, positions': (POSITIONS, 'not escape[9000, inf) Charge[s] > 20'),
    'reach, neighbours': ('delaunay(X[a], Y[a])', 'Charge[s] > 20 reach[0, 9 hops] Base[s]'),
    'eventually, positions': (
        POSITIONS,
        'somewhere[0, 5 hops] eventually[0 s, 0.2 s] Charge[s] > 20',
    ),
}


def states(robots: int, count: int, *, distances: bool) -> Iterator[dict[str, float | bool]]:
    """Yield states of robots that walk at random in a square of 500 m."""
    random = Random(1)  # noqa: S311 - no secrets
    places = {f'r{n}': [random.uniform(0, 500), random.uniform(0, 500)] for n in range(robots)}
    for _ in range(count):
        values: dict[str, float | bool] = {}
        for name, place in places.items():
            place[:] = [each + random.uniform(-0.5, 0.5) for each in place]
            x, y = place
            values |= {f'X[{name}]': x, f'Y[{name}]': y, f'Charge[{name}]': 50.0}
            values[f'Base[{name}]'] = name == 'r0'
        for a, b in permutations(places, 2) if distances else ():
            (x, y), (u, v) = places[a], places[b]
            values[f'Dist[{a}, {b}]'] = hypot(x - u, y - v)
        yield values


def milliseconds(link: str, formula: str, robots: int, count: int, *, margin: bool) -> float:
    """Return the time for a state of a formula for each robot."""
    group = FormulaGroup()
    # Robots that reach nothing for a while do not end the formula.
    text = f'over ({link} for a, b in R) from r to s: ({formula})'
    number = group.add_formula(
        'all', f'forall r in R: always eventually[0 s, 1 h] {text}', margin=margin
    )
    group.begin({'R': [f'r{n}' for n in range(robots)]})
    spent = 0.0
    for index, values in enumerate(states(robots, count, distances='Dist' in link)):
        start = process_time()
        group.progress(index * PERIOD_NS, values)
        group.margin(number)
        spent += process_time() - start
    return round(1000 * spent / count, 2)


def main() -> None:
    """Print the times as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--robots', type=int, default=100)
    parser.add_argument('--states', type=int, default=50)
    given = parser.parse_args()
    found = {
        name: [
            milliseconds(*case, given.robots, given.states, margin=margin)
            for margin in (False, True)
        ]
        for name, case in CASES.items()
    }
    print(json.dumps(found))


if __name__ == '__main__':
    main()
