"""Speed of formulas over signals in memory, compared with offline evaluation by other tools.

python benchmarks/recording_peers.py [--peers PYTHON] [--json]; see README.md.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any, NamedTuple

import numpy as np
from parts import ask_peers, measure

from dyknow_common import Verdict
from dyknow_reasoning import FormulaGroup

STATES = 100_000
PERIOD_S = 0.01
CHECKED_STATES = 600
REPETITIONS = 3
LIMITS = {'waves': 2.9, 'noise': 9.0}
"""Limits that the signals keep, and come near to."""

TOOLS = {'sentil': STATES, 'rtamt': 1000}
"""The other tools, and the states that each is measured over: RTAMT needs far more time."""


class Texts(NamedTuple):
    """A formula in each tool's own form."""

    ours: str
    sentil: str
    rtamt: str


SHAPES = {
    'invariant': (
        'always[0 s, {end} s] {x} < {limit}',
        'always[0, {end}] ({x} < {limit})',
    ),
    'bounded response': (
        'always[0 s, {end} s] ({x} > {limit} - 1 -> eventually[0 s, {w} s] {x} < 0)',
        'always[0, {end}] (({x} > {limit} - 1) -> (eventually[0, {w}] ({x} < 0)))',
    ),
    'until': (
        (
            'always[0 s, {end} s] ({x} > {limit} - 1 -> {y} < {limit}'
            ' and ({y} < {limit} until[0 s, {w} s] {x} < 0))'
        ),
        'always[0, {end}] (({x} > {limit} - 1) -> (({y} < {limit}) until[0, {w}] ({x} < 0)))',
    ),
}
"""Formulas in our form and in that of the others; `{end}` and `{w}` are times, of RTAMT states.

The left side of the others' `until` has to hold at the present state too.
"""


def signals(kind: str, states: int) -> dict[str, np.ndarray[Any, np.dtype[Any]]]:
    """Return signals that cross the limits seldom (waves), or all the time (noise)."""
    generator = np.random.default_rng(1)
    waves = np.arange(states) / np.array([[20.0], [35.0], [50.0], [60.0]])
    rows = 2 * np.sin(waves) if kind == 'waves' else generator.normal(size=waves.shape)
    return {f'x{number}': row for number, row in enumerate(rows)}


def formulas(shape: str, states: int, limits: Sequence[float]) -> Iterator[Texts]:
    """Yield formulas of a shape, each about other signals and another window."""
    ours, others = SHAPES[shape]
    for number, limit in enumerate(limits):
        window = 200 + number
        end = states - window - 1
        names = {'x': f'x{number % 4}', 'y': f'x{(number + 1) % 4}', 'limit': limit}
        seconds = {'end': round(end * PERIOD_S, 2), 'w': round(window * PERIOD_S, 2)}
        yield Texts(
            ours.format(**names, **seconds),
            others.format(**names, **seconds),
            others.replace('->', 'implies').format(**names, end=end, w=window),
        )


def ours(texts: Sequence[str], columns: dict[str, Any]) -> tuple[float, list[bool]]:
    """Return the least seconds of some runs of ours, and the verdicts."""
    times = np.arange(len(columns['x0'])) * round(PERIOD_S * 1e9)
    costs = []
    for _ in range(REPETITIONS):
        group = FormulaGroup()
        ids = [group.add_formula(text, text) for text in texts]
        group.begin({})
        begin = process_time()
        results = group.progress_many(times, columns)
        costs.append(process_time() - begin)
    verdicts = {each.formula_id: each.verdict is Verdict.TRUE for each in results}
    return min(costs), [verdicts[each] for each in ids]


def theirs(
    peers: str, tool: str, texts: Sequence[Texts], columns: dict[str, Any]
) -> dict[str, Any]:
    """Return what another tool finds, which runs in its own environment."""
    with TemporaryDirectory() as folder:
        path = Path(folder, 'signals.npz')
        np.savez(path, **columns)
        formulas = [getattr(each, tool) for each in texts]
        return ask_peers(
            peers, 'recorded', tool=tool, formulas=formulas, signals=str(path), period_s=PERIOD_S
        )


def check_equality(peers: str, kind: str, shape: str) -> None:
    """Check that all tools agree on formulas, some of them false."""
    columns = signals(kind, CHECKED_STATES)
    texts = list(formulas(shape, CHECKED_STATES, [1.5, 9, 2.5, 9, 1.9, 2.1]))
    _, expected = ours([each.ours for each in texts], columns)
    for tool in TOOLS if peers else ():
        found = theirs(peers, tool, texts, columns)
        if found.get('verdicts', expected) != expected:
            raise AssertionError(f'{tool} gives {found["verdicts"]}, not {expected}: {texts}')


def twenty_formulas(*, peers: str, quick: bool) -> list[dict[str, Any]]:
    """Return the microseconds a state of 20 formulas of each shape, which all hold."""
    rows = []
    for kind, shape in product(('waves', 'noise'), SHAPES):
        check_equality(peers, kind, shape)
        row: dict[str, Any] = {'shape': shape, 'signals': kind}
        limits = [LIMITS[kind]] * 20
        states = STATES // 10 if quick else STATES
        texts = [each.ours for each in formulas(shape, states, limits)]
        seconds, verdicts = ours(texts, signals(kind, states))
        assert all(verdicts)
        row['dyknow_us'] = seconds / states * 1e6
        for tool, most in TOOLS.items() if peers else ():
            fewer = min(most, states)
            found = theirs(peers, tool, list(formulas(shape, fewer, limits)), signals(kind, fewer))
            if 'error' in found:
                sys.stderr.write(f'{tool} is skipped: {found["error"]}\n')
            else:
                row[f'{tool}_us'] = found['seconds'] / fewer * 1e6
        rows.append(row)
    return rows


if __name__ == '__main__':
    measure(__doc__, twenty_formulas, peers='')
