"""Operators of the past against Reelay and RTAMT, where these are installed.

In both, the left side of `since` must hold at the present state, too.
"""

from __future__ import annotations

from random import Random

import pytest
from reasoning_reference import with_history

from dyknow_common import Verdict

STATES = 30
FORMULAS = 40
BOUNDS = ((0, None), (0, 3), (1, 4), (2, 2))


def random_formula(random: Random, depth: int) -> tuple[str, str, str]:
    """A formula over p and q in our words, in Reelay's, and in RTAMT's."""
    if not depth or random.random() < 0.2:
        name = random.choice('pq')
        return name, f'{{{name}}}', f'({name} > 0.5)'
    left, right = (random_formula(random, depth - 1) for _ in range(2))
    start, end = random.choice(BOUNDS)
    ours = f'[{start} ns, {"inf" if end is None else f"{end} ns"}]'
    reelay = f'[{start}:{"" if end is None else end}]'
    rtamt = '' if end is None else f'[{start},{end}]'
    match random.choice(['once', 'historically', 'since', 'not', 'and', 'previous']):
        case 'since':
            strict = f'({left[0]}) and (({left[0]}) since{ours} ({right[0]}))'
            text = strict if start else f'({right[0]}) or ({strict})'
            return (
                f'({text})',
                f'({left[1]} since{reelay} {right[1]})',
                f'({left[2]} since{rtamt} {right[2]})',
            )
        case 'not':
            return f'(not {left[0]})', f'(not {left[1]})', f'(not ({left[2]}))'
        case 'and':
            return tuple(f'({a} and {b})' for a, b in zip(left, right, strict=True))  # type: ignore[return-value]
        case 'previous':
            return f'(previous {left[0]})', f'(pre {left[1]})', f'(once[1,1] {left[2]})'
        case word:
            return (
                f'({word}{ours} {left[0]})',
                f'({word}{reelay} {left[1]})',
                f'({word}{rtamt} {left[2]})',
            )


def ours(text: str, rows: list[dict[str, bool]]) -> list[bool]:
    group = with_history(text)
    found = []
    for time, row in enumerate(rows):
        number = group.add_formula('it', text)
        results = group.progress(time, row) or group.decided_at_once()
        found.append(results[0].verdict is Verdict.TRUE)
        group.remove_formula(number)
    return found


def cases() -> list[tuple[tuple[str, str, str], list[dict[str, bool]]]]:
    random = Random(15)  # noqa: S311 - no secret
    return [
        (
            random_formula(random, 3),
            [{name: random.random() < 0.6 for name in 'pq'} for _ in range(STATES)],
        )
        for _ in range(FORMULAS)
    ]


def test_reelay_agrees() -> None:
    reelay = pytest.importorskip('reelay')
    for (text, theirs, _), rows in cases():
        monitor = reelay.discrete_timed_monitor(pattern=theirs, semantics='boolean', condense=False)
        assert ours(text, rows) == [monitor.update(row)['value'] for row in rows], text


def test_rtamt_agrees() -> None:
    rtamt = pytest.importorskip('rtamt')
    for (text, _, theirs), rows in cases():
        specification = rtamt.StlDiscreteTimeOfflineSpecification()
        columns = {name: [float(row[name]) for row in rows] for name in 'pq'}
        for name in columns:
            specification.declare_var(name, 'float')
        specification.spec = theirs
        specification.parse()
        found = specification.evaluate({'time': list(range(STATES)), **columns})
        assert ours(text, rows) == [robustness > 0 for _, robustness in found], text
