"""Speed of margins of nested formulas, compared with other tools in the same run.

`python benchmarks/nested_margins.py [--json] [--peers PYTHON]`; see README.md. Each tool computes
the least margin over a sawtooth, which must be that of DyKnow.
"""

from __future__ import annotations

import argparse
import json
import sys
from statistics import median
from time import process_time
from typing import NamedTuple

from parts import ask_peers

from dyknow_reasoning import FormulaGroup

PERIOD_NS = 100_000_000
STATES = 20_000
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


def dyknow(formula: str, *, every_state: bool = False, ask: bool = False) -> Found:
    """Return the median cost of a state, with bounds and the verdict, and the least margin."""
    cycle = [{'x': value} for value in SAWTOOTH]
    text = formula if every_state else f'always ({formula})'
    costs = []
    for _ in range(REPETITIONS):
        group = FormulaGroup()
        formula_id = group.add_formula('it', text, margin=True, every_state=every_state)
        group.begin({})
        begin = process_time()
        for index in range(STATES):
            group.progress(index * PERIOD_NS, cycle[index % len(cycle)])
            if ask:
                group.margin(formula_id)
        found = group.margin(formula_id)
        costs.append((process_time() - begin) / STATES * 1e6)
    assert found is not None
    return median(costs), found.upper


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
    options = parser.parse_args()
    found = own()
    for name, case in CASES.items():
        if not (options.peers and case.mstlo):
            continue
        formulas = {'mstlo': case.mstlo, 'rtamt': case.rtamt, 'horizon': case.horizon}
        tools = ask_peers(options.peers, 'margins', **formulas, wave=SAWTOOTH, states=STATES)
        for tool, each in tools.items():
            if 'error' in each:
                sys.stderr.write(f'{tool} is skipped: {each["error"]}\n')
            else:
                found[name][tool] = each['us'], each['margin']
    for name, tools in found.items():
        _, expected = tools['DyKnow']
        for tool, (cost, least) in tools.items():
            assert abs(least - expected) < 1e-9, (name, tool, least, expected)  # noqa: PLR2004
            line = {'what': f'{name}: {tool}', 'unit': 'us a state', 'value': round(cost, 2)}
            shown = f'{line["what"]:60} {cost:10.2f} us a state'
            print(json.dumps(line) if options.json else shown, flush=True)


if __name__ == '__main__':
    main()
