"""Cost of other tools for formulas over signals that are in memory already.

recording_peers.py starts this script in the environment of those tools, with the
signals in a file of numpy; it prints JSON.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

REPETITIONS = 3
Signals = Mapping[str, 'np.ndarray[Any, np.dtype[Any]]']


def sentil(formulas: Sequence[str], signals: Signals, period: float) -> Callable[[], list[bool]]:
    """Return a function that evaluates the formulas by SENTIL over a trace made before."""
    import sentil as tool  # noqa: PLC0415

    values = dict(signals)
    count = len(next(iter(values.values())))
    trace = tool.Trace(np.arange(count) * period, values)
    parsed = [tool.Formula.parse(text) for text in formulas]
    return lambda: [formula.robustness(trace) > 0 for formula in parsed]


def rtamt(formulas: Sequence[str], signals: Signals, period: float) -> Callable[[], list[bool]]:  # noqa: ARG001
    """Return a function that evaluates the formulas by RTAMT, in discrete time."""
    import rtamt as tool  # noqa: PLC0415

    specifications = []
    for text in formulas:
        made = tool.StlDiscreteTimeOfflineSpecification()
        for name in signals:
            made.declare_var(name, 'float')
        made.spec = text
        made.parse()
        specifications.append(made)
    lists = {name: column.tolist() for name, column in signals.items()}
    lists['time'] = list(range(len(lists[next(iter(signals))])))
    return lambda: [made.evaluate(lists)[0][1] > 0 for made in specifications]


def measured(evaluate: Callable[[], list[bool]]) -> tuple[float, list[bool]]:
    """Return the least seconds of processor time of some runs, and the verdicts."""
    times = []
    for _ in range(REPETITIONS):
        begin = process_time()
        verdicts = evaluate()
        times.append(process_time() - begin)
    return min(times), verdicts


def main() -> None:
    """Measure the tool that standard input names."""
    task = json.load(sys.stdin)
    tool = {'sentil': sentil, 'rtamt': rtamt}[task['tool']]
    signals = dict(np.load(Path(task['signals'])))
    try:
        seconds, verdicts = measured(tool(task['formulas'], signals, task['period_s']))
    except ImportError as error:
        found: dict[str, Any] = {'error': f'not installed: {error}'}
    else:
        found = {'seconds': seconds, 'verdicts': verdicts}
    json.dump(found, sys.stdout)


if __name__ == '__main__':
    main()
