"""Cost of other tools for a state of `always (x > 2 -> eventually[0, 5 s] x < 2)`.

progression.py starts this script in the environment of those tools; it prints JSON. Each tool gets
the formula in its own form, and must first distinguish a recording that violates it from one that
does not.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from statistics import median
from time import process_time

PERIOD_S = 0.1
STEPS = 50
REPETITIONS = 5


def sentil(values: Sequence[float]) -> bool:
    """Monitor online; SENTIL gives a verdict for each state about five seconds later."""
    import sentil as tool  # noqa: PLC0415

    monitor = tool.OnlineMonitor('(x > 2) -> (eventually[0, 5] (x < 2))')
    violated = False
    for index, value in enumerate(values):
        verdict = monitor.update(index * PERIOD_S, {'x': value})
        if verdict.resolved and not verdict.satisfied:
            violated = True
    return violated


def mstlo(values: Sequence[float]) -> bool:
    """Monitor online with eager qualitative semantics; mstlo gives a verdict for each state."""
    import mstlo_python as tool  # noqa: PLC0415

    formula = tool.parse_formula('(x > 2) -> (F[0, 5](x < 2))')
    monitor = tool.Monitor(formula, semantics='EagerQualitative')
    violated = False
    for index, value in enumerate(values):
        for _, verdict in monitor.update('x', value, index * PERIOD_S).verdicts():
            violated = violated or not verdict
    return violated


def reelay(values: Sequence[float]) -> bool:
    """Monitor online in discrete time; reelay has past operators only."""
    import reelay as tool  # noqa: PLC0415

    monitor = tool.discrete_timed_monitor(
        pattern=f'(once[{STEPS}:{STEPS}]{{x > 2}}) -> (once[0:{STEPS}]{{x < 2}})', condense=False
    )
    violated = False
    for value in values:
        if not monitor.update({'x': value})['value']:
            violated = True
    return violated


def rtamt(values: Sequence[float]) -> bool:
    """Monitor online in discrete time; RTAMT rewrites the formula with past operators."""
    import rtamt as tool  # noqa: PLC0415

    monitor = tool.StlDiscreteTimeSpecification()
    monitor.declare_var('x', 'float')
    monitor.spec = f'(x > 2) implies (eventually[0,{STEPS}] (x < 2))'
    monitor.parse()
    monitor.pastify()
    violated = False
    for index, value in enumerate(values):
        if monitor.update(index, [('x', value)]) < 0 and index >= STEPS:
            violated = True
    return violated


def mstlo_margins(values: Sequence[float]) -> bool:
    """Monitor online with delayed quantitative semantics: margins without bounds."""
    return _mstlo_margins(values, 'DelayedQuantitative')


def mstlo_bounds(values: Sequence[float]) -> bool:
    """Monitor online with robust satisfaction intervals: margins with bounds."""
    return _mstlo_margins(values, 'Rosi')


def _mstlo_margins(values: Sequence[float], semantics: str) -> bool:
    import mstlo_python as tool  # noqa: PLC0415

    formula = tool.parse_formula('(x > 2) -> (F[0, 5](x < 2))')
    monitor = tool.Monitor(formula, semantics=semantics)
    violated = False
    for index, value in enumerate(values):
        for _, margin in monitor.update('x', value, index * PERIOD_S).verdicts():
            upper = margin[1] if isinstance(margin, tuple) else margin
            violated = violated or upper < 0
    return violated


def measured(
    watch: Callable[[Sequence[float]], bool], values: Sequence[float]
) -> dict[str, object]:
    """Return the median cost of a state in microseconds, or the reason for its absence."""
    try:
        clean = ([3.0] * 20 + [1.0] * 20) * 10
        bad = [*clean[:100], *[3.0] * 100, *clean]
        if watch(clean) or not watch(bad):
            return {'error': 'gives another verdict'}
        costs = []
        for _ in range(REPETITIONS):
            begin = process_time()
            watch(values)
            costs.append((process_time() - begin) / len(values) * 1e6)
        return {'microseconds': median(costs)}
    except ImportError as error:
        return {'error': f'not installed: {error}'}
    except Exception as error:  # noqa: BLE001 - a tool that fails must not hide the others
        return {'error': f'{type(error).__name__}: {error}'}


def main() -> None:
    """Measure all tools over the values on standard input."""
    values = json.load(sys.stdin)
    tools = {
        'sentil': sentil,
        'mstlo': mstlo,
        'mstlo, margins': mstlo_margins,
        'mstlo, margins with bounds': mstlo_bounds,
        'reelay': reelay,
        'rtamt, margins': rtamt,
    }
    fewer = {'rtamt, margins': values[: len(values) // 10]}
    found = {name: measured(watch, fewer.get(name, values)) for name, watch in tools.items()}
    json.dump(found, sys.stdout)


if __name__ == '__main__':
    main()
