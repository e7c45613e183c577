"""Verdicts over several hosts, whose clocks differ and whose links fail, judged by the true times.

`python benchmarks/federation.py [--runs N] [--seed N]` prints JSON; see README.md.
The hosts run in simulated time (`dyknow_federation/test/federation_simulation.py`).
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections import Counter
from pathlib import Path
from time import process_time
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent / 'dyknow_federation' / 'test'))

from federation_simulation import Conditions, Outcome, PushDownSimulation, Simulation

from dyknow_common import SECOND_NS


def main() -> None:
    """Run, and print the counts; the exit code is 1 if a verdict is wrong or a run hangs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--runs', type=int, default=1000)
    parser.add_argument('--seed', type=int, default=0, help='of the first run')
    options = parser.parse_args()
    conditions = Conditions(offset=5 * SECOND_NS, loss=0.2)
    began = process_time()
    counts: Counter[str] = Counter()
    errors: Counter[str] = Counter()
    bad: list[str] = []
    packets = most_alternatives = 0
    # Of every fourth run, hosts evaluate the parts that are about them alone.
    for seed in range(options.seed, options.seed + options.runs):
        run = (PushDownSimulation if seed % 4 == 0 else Simulation)(seed, conditions)
        outcome = run.run()
        _count(outcome, counts, errors)
        packets += run.packets
        most_alternatives = max(most_alternatives, run.most_alternatives)
        if outcome.kind in {'wrong', 'hang'}:
            bad.append(f'seed {seed}: {outcome.error} {outcome.detail}')
    seconds = process_time() - began
    found: dict[str, Any] = {
        'runs': options.runs,
        **{each: counts[each] for each in ('right', 'unknown', 'wrong', 'hang')},
        'where the clocks allow all ticks': counts['allowed'],
        'of these, unknown as clocks differ': counts['unknown though allowed'],
        'errors': dict(errors.most_common()),
        'packets a run': round(packets / options.runs),
        'most alternatives of a value': most_alternatives,
        'processor ms a run': round(1000 * seconds / options.runs, 1),
        'wrong or hanging runs': bad[:20],
    }
    print(json.dumps(found, indent=2))
    sys.exit(1 if bad else 0)


def _count(outcome: Outcome, counts: Counter[str], errors: Counter[str]) -> None:
    counts[outcome.kind] += 1
    counts['allowed'] += outcome.allowed
    if outcome.kind == 'unknown':
        errors[re.sub(r'-?[0-9][0-9.]*( (ns|us|ms|s)\b)?', 'N', outcome.error)] += 1
        is_of_clocks = 'the clocks' in outcome.error and 'deadband' not in outcome.error
        counts['unknown though allowed'] += outcome.allowed and is_of_clocks


if __name__ == '__main__':
    main()
