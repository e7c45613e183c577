"""Costs of other tools for temporal logic, each in the environment that has them.

progression.py and recording_peers.py start this script there (`ask_peers`). It reads a task as JSON
from the standard input: the name of one of TASKS, and its arguments; it prints what each tool
finds: an `error`, or its cost with its results, which the caller compares.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from itertools import cycle, islice
from statistics import median
from typing import Any

from parts import processor_times

PERIOD_S = 0.1
RTAMT_STATES = 2000
"""RTAMT needs far more time than the others for a state."""

REPETITIONS = 5


def sentil_violated(values: Sequence[float]) -> bool:
    """Monitor a response online; SENTIL gives a verdict for each state about 5 s later."""
    import sentil as tool  # noqa: PLC0415

    monitor = tool.OnlineMonitor('(x > 2) -> (eventually[0, 5] (x < 2))')
    verdicts = [
        monitor.update(index * PERIOD_S, {'x': value}) for index, value in enumerate(values)
    ]
    return any(each.resolved and not each.satisfied for each in verdicts)


def mstlo_violated(values: Sequence[float]) -> bool:
    """Monitor a response online with eager qualitative semantics."""
    return not all(mstlo_verdicts('(x > 2) -> (F[0, 5](x < 2))', 'EagerQualitative', values))


def reelay_violated(values: Sequence[float]) -> bool:
    """Monitor a response online in discrete time; reelay has past operators only."""
    import reelay as tool  # noqa: PLC0415

    monitor = tool.discrete_timed_monitor(
        pattern='(once[50:50]{x > 2}) -> (once[0:50]{x < 2})', condense=False
    )
    verdicts = [monitor.update({'x': value})['value'] for value in values]
    return not all(verdicts)


def mstlo_verdicts(formula: str, semantics: str, values: Sequence[float]) -> list[Any]:
    """Return what mstlo says of each state: a truth, a margin, or the bounds of a margin."""
    import mstlo_python as tool  # noqa: PLC0415

    monitor = tool.Monitor(tool.parse_formula(formula), semantics=semantics)
    return [
        verdict
        for index, value in enumerate(values)
        for _, verdict in monitor.update('x', value, index * PERIOD_S).verdicts()
    ]


def mstlo_margin(formula: str, semantics: str, values: Sequence[float]) -> float:
    """Return the least margin of a formula, or the least upper bound."""
    found = mstlo_verdicts(formula, semantics, values)
    return min(each[1] if isinstance(each, tuple) else each for each in found)


def rtamt_margin(formula: str, horizon: int, values: Sequence[float]) -> float:
    """Return the least margin of a formula, by operators of the past."""
    import rtamt as tool  # noqa: PLC0415

    monitor = tool.StlDiscreteTimeSpecification()
    monitor.declare_var('x', 'float')
    monitor.spec = formula
    monitor.parse()
    monitor.pastify()
    found = [monitor.update(index, [('x', value)]) for index, value in enumerate(values)]
    return float(min(found[horizon:]))


def response(values: Sequence[float]) -> dict[str, Any]:
    """Measure `x > 2 -> eventually[0, 5 s] x < 2`, and whether a violation is seen."""
    clean = ([3.0] * 20 + [1.0] * 20) * 10
    bad = [*clean[:100], *[3.0] * 100, *clean]
    tools = {'sentil': sentil_violated, 'mstlo': mstlo_violated, 'reelay': reelay_violated}

    def run(violated: Callable[[Sequence[float]], bool]) -> dict[str, Any]:
        found = [violated(clean), violated(bad)]
        cost = median(processor_times(lambda: violated(values), REPETITIONS))
        return {'violated': found, 'us': cost / len(values) * 1e6}

    return {name: attempted(lambda: run(each)) for name, each in tools.items()}  # noqa: B023


def margins(
    mstlo: str, rtamt: str, horizon: int, wave: Sequence[float], states: int
) -> dict[str, Any]:
    """Measure the margins of a formula over a wave: without bounds, and with bounds."""
    values, fewer = (list(islice(cycle(wave), each)) for each in (states, RTAMT_STATES))
    tools: dict[str, tuple[Callable[[], float], int]] = {
        'mstlo': (lambda: mstlo_margin(mstlo, 'DelayedQuantitative', values), states),
        'mstlo with bounds': (lambda: mstlo_margin(mstlo, 'Rosi', values), states),
        'RTAMT': (lambda: rtamt_margin(rtamt, horizon, fewer), RTAMT_STATES),
    }

    def measured(run: Callable[[], float], count: int) -> dict[str, Any]:
        cost = median(processor_times(run, REPETITIONS))
        return {'margin': run(), 'us': cost / count * 1e6}

    return {name: attempted(lambda: measured(*each)) for name, each in tools.items()}  # noqa: B023


def recorded(tool: str, formulas: Sequence[str], signals: str, period_s: float) -> dict[str, Any]:
    """Measure formulas over signals that are in memory already, from a file of numpy."""
    import numpy as np  # noqa: PLC0415

    values = dict(np.load(signals))

    def run() -> dict[str, Any]:
        evaluate = {'sentil': sentil_offline, 'rtamt': rtamt_offline}[tool](
            formulas, values, period_s
        )
        return {'verdicts': evaluate(), 'seconds': min(processor_times(evaluate, REPETITIONS))}

    return attempted(run)


def sentil_offline(
    formulas: Sequence[str], signals: Mapping[str, Any], period_s: float
) -> Callable[[], list[bool]]:
    """Return a function that evaluates formulas by SENTIL over a trace made before."""
    import numpy as np  # noqa: PLC0415
    import sentil as tool  # noqa: PLC0415

    count = len(next(iter(signals.values())))
    trace = tool.Trace(np.arange(count) * period_s, dict(signals))
    parsed = [tool.Formula.parse(text) for text in formulas]
    return lambda: [formula.robustness(trace) > 0 for formula in parsed]


def rtamt_offline(
    formulas: Sequence[str], signals: Mapping[str, Any], _period_s: float
) -> Callable[[], list[bool]]:
    """Return a function that evaluates formulas by RTAMT, in discrete time."""
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
    lists['time'] = list(range(len(next(iter(lists.values())))))
    return lambda: [made.evaluate(lists)[0][1] > 0 for made in specifications]


def attempted(run: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return what a tool finds, or the reason for its absence."""
    try:
        return run()
    except ImportError as error:
        return {'error': f'not installed: {error}'}
    except Exception as error:  # noqa: BLE001 - a tool that fails must not hide the others
        return {'error': f'{type(error).__name__}: {error}'}


TASKS = {each.__name__: each for each in (response, margins, recorded)}


def main() -> None:
    """Perform the task of the standard input."""
    task, arguments = json.load(sys.stdin)
    json.dump(TASKS[task](**arguments), sys.stdout)


if __name__ == '__main__':
    main()
