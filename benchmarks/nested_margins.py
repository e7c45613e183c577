"""Speed of margins of nested formulas, compared with other tools in the same run.

`python benchmarks/nested_margins.py [--json] [--peers PYTHON]`; see README.md. Each tool computes
the least margin over a sawtooth, which must be that of DyKnow. The other tools run this script in
their own environment.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable
from statistics import median
from time import process_time
from typing import NamedTuple

PERIOD_NS = 100_000_000
STATES = 20_000
FEWER_STATES = 2000
REPETITIONS = 5
SAWTOOTH = [3.0] * 20 + [1.0 + 0.01 * step for step in range(20)]


class Case(NamedTuple):
    """A formula in the languages of the tools, without its outer `always`; mstlo may have none."""

    ours: str
    mstlo: str
    rtamt: str
    horizon: int


CASES = {
    'bounded response': Case(
        'x > 2 -> eventually[0, 5 s] x < 2',
        '(x > 2) -> (F[0, 5](x < 2))',
        '(x > 2) implies (eventually[0,50] (x < 2))',
        50,
    ),
    'two operators': Case(
        'x > 2 -> eventually[0, 5 s] always[0, 1 s] x < 2.5',
        '(x > 2) -> (F[0, 5](G[0, 1](x < 2.5)))',
        '(x > 2) implies (eventually[0,50] (always[0,10] (x < 2.5)))',
        60,
    ),
    'three operators': Case(
        'x > 2 -> eventually[0, 5 s] always[0, 1 s] eventually[0, 0.5 s] x < 2.5',
        '(x > 2) -> (F[0, 5](G[0, 1](F[0, 0.5](x < 2.5))))',
        '(x > 2) implies (eventually[0,50] (always[0,10] (eventually[0,5] (x < 2.5))))',
        65,
    ),
    'until': Case('x > 2 -> x < 5 until[0, 5 s] always[0, 1 s] x < 2.5', '', '', 0),
}

Found = tuple[float, float]
"""The microseconds for a state, and the least margin."""


def measured(run: Callable[[int], float], states: int = STATES) -> Found:
    """Return the median cost of a state of some runs, and the least margin."""
    costs, least = [], 0.0
    for _ in range(REPETITIONS):
        begin = process_time()
        least = run(states)
        costs.append((process_time() - begin) / states * 1e6)
    return median(costs), least


def dyknow(formula: str, *, every_state: bool = False, ask: bool = False) -> Found:
    """Measure DyKnow: bounds, and the verdict with them."""
    from dyknow_reasoning import FormulaGroup  # noqa: PLC0415

    cycle = [{'x': value} for value in SAWTOOTH]
    text = formula if every_state else f'always ({formula})'

    def run(states: int) -> float:
        group = FormulaGroup()
        formula_id = group.add_formula('it', text, margin=True, every_state=every_state)
        group.begin({})
        for index in range(states):
            group.progress(index * PERIOD_NS, cycle[index % len(cycle)])
            if ask:
                group.margin(formula_id)
        found = group.margin(formula_id)
        assert found is not None
        return found.upper

    return measured(run)


def mstlo(formula: str, semantics: str) -> Found:
    """Measure mstlo: margins, with `Rosi` also bounds."""
    import mstlo_python as tool  # noqa: PLC0415

    def run(states: int) -> float:
        monitor = tool.Monitor(tool.parse_formula(formula), semantics=semantics)
        least = float('inf')
        for index in range(states):
            value = SAWTOOTH[index % len(SAWTOOTH)]
            for _, margin in monitor.update('x', value, index * PERIOD_NS / 1e9).verdicts():
                least = min(least, margin[1] if isinstance(margin, tuple) else margin)
        return least

    return measured(run)


def rtamt(formula: str, horizon: int) -> Found:
    """Measure RTAMT: margins, by operators of the past."""
    import rtamt as tool  # noqa: PLC0415

    def run(states: int) -> float:
        monitor = tool.StlDiscreteTimeSpecification()
        monitor.declare_var('x', 'float')
        monitor.spec = formula
        monitor.parse()
        monitor.pastify()
        found = [
            monitor.update(index, [('x', SAWTOOTH[index % len(SAWTOOTH)])])
            for index in range(states)
        ]
        return float(min(found[horizon:]))

    return measured(run, FEWER_STATES)


def peers() -> dict[str, dict[str, Found]]:
    """Return what the other tools of this environment need, by formula."""
    return {
        name: {
            'mstlo': mstlo(case.mstlo, 'DelayedQuantitative'),
            'mstlo with bounds': mstlo(case.mstlo, 'Rosi'),
            'RTAMT': rtamt(case.rtamt, case.horizon),
        }
        for name, case in CASES.items()
        if case.mstlo
    }


def own() -> dict[str, dict[str, Found]]:
    """Return what DyKnow needs, by formula."""
    return {
        name: {
            'DyKnow': dyknow(case.ours),
            'DyKnow, asked for at each state': dyknow(case.ours, ask=True),
            'DyKnow, from every state': dyknow(case.ours, every_state=True),
        }
        for name, case in CASES.items()
    }


def main() -> None:
    """Measure, compare the margins, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--json', action='store_true', help='print a line of JSON for each figure')
    parser.add_argument('--peers', metavar='PYTHON', help='of an environment with the other tools')
    parser.add_argument('--as-peer', action='store_true', help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.as_peer:
        json.dump(peers(), sys.stdout)
        return
    found = own()
    if options.peers:
        command = [options.peers, __file__, '--as-peer']
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        for name, tools in json.loads(done.stdout).items():
            found[name] |= tools
    for name, tools in found.items():
        _, expected = tools['DyKnow']
        for tool, (cost, least) in tools.items():
            assert abs(least - expected) < 1e-9, (name, tool, least, expected)  # noqa: PLR2004
            line = {'what': f'{name}: {tool}', 'unit': 'us a state', 'value': round(cost, 2)}
            shown = f'{line["what"]:60} {cost:10.2f} us a state'
            print(json.dumps(line) if options.json else shown, flush=True)


if __name__ == '__main__':
    main()
