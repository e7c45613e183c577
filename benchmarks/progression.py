"""Speed of progression and of margins, compared with other tools in the same run.

python benchmarks/progression.py [--json] [--quick] [--only PART] [--peers PYTHON]

`--peers` names a Python with SENTIL, mstlo, reelay and RTAMT (see README.md). All execution paths
of DyKnow must first agree; a tool is skipped that gives another verdict, or another least margin.
A figure is the median of parts of a run, in microseconds of processor time a state, unless its
unit says otherwise. States come from a dict of their values, or from a recording of columns.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from itertools import cycle, islice
from math import isclose
from pathlib import Path
from statistics import mean, median
from time import process_time
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from parts import ask_peers, measure

from dyknow_reasoning import FormulaGroup, FormulaLimits
from dyknow_reasoning.execution.standing import standing_monitor

PERIOD_NS = 100_000_000
PART = 2000
"""The states of a part of a run whose clock is not read at each state."""

NO_LIMIT = 1 << 62
RESPONSE = 'always (Alt[x] > 2 -> eventually[0, 5 s] Alt[x] < 2)'
PAPER = 'always (not p[x] -> eventually[0, 1000] always[0, 999] p[x])'
POWER = 'always (Power[x] > 150 -> Power[x] < 200 until[0 s, 5 s] always[0 s, 3 s] Power[x] <= 150)'
NESTED = 'always always[0, 1 s] eventually[0, 0.5 s] Power[x] > 150'
INVARIANT = 'always Alt[x] > 0'
PAST = {
    'once': 'always (Alt[x] > 4 -> once[0, 5 s] Alt[x] < 2)',
    'once from 1 s': 'always (Alt[x] > 4 -> once[1 s, 5 s] Alt[x] < 2)',
    'since': 'always (Alt[x] > 4 -> Alt[x] > 2 since[0, 5 s] Alt[x] < 2)',
}
GROWING = 'always (p -> eventually[0, 5 s] (q and always[0, 2 s] (r or eventually[0, 1 s] s)))'
SAWTOOTH = [3.0] * 20 + [1.0] * 20
SLOW_SAWTOOTH = [3.0] * 20 + [1.0 + 0.01 * step for step in range(20)]
PULSES = [190.0] * 6 + [140.0] * 3
SURGES = [140.0] * 10 + [190.0] * 40 + [140.0] * 50
STREAMS = {
    'best': [True],
    'rare': [False] + [True] * 99,
    'often': [False] + [True] * 19,
    'worst': [False] * 5 + [True] * 25,
}

Rows = dict[str, Any]


class Nested(NamedTuple):
    """A formula in the languages of the tools, without its outer `always`; mstlo may have none."""

    ours: str
    mstlo: str = ''
    rtamt: str = ''
    horizon: int = 0


MARGINS = {
    'bounded response': Nested(
        'Alt[x] > 2 -> eventually[0, 5 s] Alt[x] < 2',
        '(x > 2) -> (F[0, 5](x < 2))',
        '(x > 2) implies (eventually[0,50] (x < 2))',
        50,
    ),
    'two operators': Nested(
        'Alt[x] > 2 -> eventually[0, 5 s] always[0, 1 s] Alt[x] < 2.5',
        '(x > 2) -> (F[0, 5](G[0, 1](x < 2.5)))',
        '(x > 2) implies (eventually[0,50] (always[0,10] (x < 2.5)))',
        60,
    ),
    'three operators': Nested(
        'Alt[x] > 2 -> eventually[0, 5 s] always[0, 1 s] eventually[0, 0.5 s] Alt[x] < 2.5',
        '(x > 2) -> (F[0, 5](G[0, 1](F[0, 0.5](x < 2.5))))',
        '(x > 2) implies (eventually[0,50] (always[0,10] (eventually[0,5] (x < 2.5))))',
        65,
    ),
    'until': Nested('Alt[x] > 2 -> Alt[x] < 5 until[0, 5 s] always[0, 1 s] Alt[x] < 2.5'),
}


def group_of(
    text: str, objects: int = 1, *, separate: bool = False, **options: bool
) -> FormulaGroup:
    """Return a group of one quantified formula, or of a separate formula for each object."""
    names = [f'o{index}' for index in range(objects)]
    group = FormulaGroup(FormulaLimits(node_limit=NO_LIMIT, part_limit=NO_LIMIT))
    for name in names if separate else ():
        group.add_formula(name, text.replace('[x]', f'[{name}]'))
    if not separate:
        group.add_formula('all', f'forall x in S: {text}', **options)
    group.begin({'S': names})
    return group


def times_of(states: int, *, regular: bool = True) -> list[int]:
    """Return valid times with a fixed period, or with random steps around it."""
    if regular:
        return [index * PERIOD_NS for index in range(states)]
    steps = np.random.default_rng(1).integers(PERIOD_NS // 2, 3 * PERIOD_NS // 2, states)
    found: list[int] = np.cumsum(steps).tolist()
    return found


def costs(
    progress: Callable[[int, Any], Any], times: Sequence[int], states: Sequence[Rows], part: int = 1
) -> list[float]:
    """Return the cost of a state in each part of a run over states that repeat."""
    found = []
    repeated = cycle(states)
    for first in range(0, len(times), part):
        some = list(zip(times[first : first + part], islice(repeated, part), strict=False))
        begin = process_time()
        for time, state in some:
            if progress(time, state):
                raise AssertionError('the stream must keep the formula undecided')
        found.append((process_time() - begin) / len(some) * 1e6)
    return found


def in_a_loop(
    text: str, feature: str, wave: Sequence[Any], *, regular: bool = True, **options: bool
) -> float:
    """Return the cost of a state of one object, in a loop that does not read the clock."""
    times = times_of(20 * PART, regular=regular)
    states = [{f'{feature}[o0]': value} for value in wave]
    return median(costs(group_of(text, **options).progress, times, states, PART)[1:])


def from_dicts(
    text: str, feature: str, wave: Sequence[Any], objects: int, states: int = 1000, **options: bool
) -> list[float]:
    """Return the cost of each state, a dict with a value for each object."""
    phases = np.random.default_rng(2).integers(0, len(wave), objects).tolist()
    cycle = [
        {
            f'{feature}[o{number}]': wave[(index + phase) % len(wave)]
            for number, phase in enumerate(phases)
        }
        for index in range(len(wave))
    ]
    times = times_of(max(len(wave), min(states, 3_000_000 // objects)))
    return costs(group_of(text, objects, **options).progress, times, cycle)


def recorded(text: str, feature: str, wave: Sequence[Any], objects: int, *, regular: bool) -> float:
    """Return the nanoseconds for a state and an object in a recording of columns."""
    states = 2000
    phases = np.random.default_rng(3).integers(0, len(wave), objects).tolist()
    cycle = np.array((list(wave) * (2 + 2 * states // len(wave)))[: 2 * states + len(wave)])
    columns = {
        f'{feature}[o{number}]': cycle[phase : phase + states]
        for number, phase in enumerate(phases)
    }
    times = times_of(2 * states, regular=regular)
    group = group_of(text, objects)
    assert not group.progress_many(times[:states], columns)
    begin = process_time()
    assert not group.progress_many(times[states:], columns)
    return (process_time() - begin) / states / objects * 1e9


def check_equality() -> None:
    """Check that all execution paths agree, over streams that violate the formulas."""
    rng = np.random.default_rng(4)
    objects, states = 30, 600
    for text, feature, data in (
        (RESPONSE, 'Alt', rng.choice([1.0] + [3.0] * 19, (objects, states))),
        (POWER, 'Power', rng.uniform(100, 200, (objects, states))),
        (PAPER, 'p', rng.choice([False] + [True] * 19, (objects, states))),
        *(
            (text, 'Alt', rng.choice([1.0, 5.0] + [3.0] * 40, (objects, states)))
            for text in PAST.values()
        ),
    ):
        columns = {f'{feature}[o{index}]': row for index, row in enumerate(data)}
        rows = [dict(zip(columns, row.tolist(), strict=True)) for row in data.T]
        for regular in (True, False):
            times = times_of(states, regular=regular)
            at_once = group_of(text, objects, separate=True).progress_many(times, columns)
            each = results_of(group_of(text, objects, separate=True), times, rows)
            assert at_once == each
            alone = []
            for index in range(objects):
                single = FormulaGroup()
                single.add_formula(f'o{index}', text.replace('[x]', f'[o{index}]'))
                single.begin({})
                alone += results_of(single, times, rows)
            verdicts = {(one.name, one.verdict, one.decided_at) for one in each}
            assert verdicts == {(one.name, one.verdict, one.decided_at) for one in alone}


def results_of(group: FormulaGroup, times: Sequence[int], rows: Sequence[Rows]) -> list[Any]:
    """Return the results of a group over states from dicts."""
    pairs = zip(times, rows, strict=True)
    return [result for time, row in pairs for result in group.progress(time, row)]


def one_formula(*, peers: str, **_: Any) -> Rows:
    """Measure formulas of one object, and other tools over the same states."""
    baseline = [median(costs(lambda *_: (), times_of(20 * PART), [{}], part)) for part in (PART, 1)]
    found: Rows = {
        'a call that does nothing': baseline[0],
        'the same, and reading the clock': baseline[1],
    }
    for name, text, feature, wave in (
        ('bounded response', RESPONSE, 'Alt', SAWTOOTH),
        ('figure 8', PAPER, 'p', STREAMS['often']),
        ('power', POWER, 'Power', SURGES),
        *((name, text, 'Alt', SAWTOOTH) for name, text in PAST.items()),
    ):
        found[name] = in_a_loop(text, feature, wave)
        found[f'{name}, irregular times'] = in_a_loop(text, feature, wave, regular=False)
    values = list(islice(cycle(SAWTOOTH), 50_000))
    for tool, each in (ask_peers(peers, 'response', values=values) if peers else {}).items():
        if each.get('violated') == [False, True]:
            found[f'{tool}, bounded response'] = each['us']
        else:
            skip(tool, each)
    return found


def skip(tool: str, found: Rows) -> None:
    """Report a tool that has no figures to compare."""
    sys.stderr.write(f'{tool} is skipped: {found.get("error", "another result")}\n')


def figure_8(**_: Any) -> list[Rows]:
    """Measure formulas and instances for each of the streams of the paper."""
    rows = []
    for name, wave in STREAMS.items():
        separate = median(from_dicts(PAPER, 'p', wave, 1000, separate=True))
        recordings = [
            recorded(PAPER, 'p', wave, 20_000, regular=regular) for regular in (True, False)
        ]
        rows.append({
            'stream': name,
            'separate formulas in 100 ms': 1000 * 100e3 / separate,
            'instances of a recording in 100 ms': 100e6 / recordings[0],
            'ns an instance, irregular times': recordings[1],
        })  # fmt: skip
    return rows


def many_objects(**_: Any) -> Rows:
    """Measure 100 objects, and the first states of 100,000."""
    first = from_dicts(PAPER, 'p', STREAMS['often'], 100_000)
    return {
        **{
            name: median(from_dicts(text, 'Alt', SAWTOOTH, 100))
            for name, text in (('bounded response', RESPONSE), *PAST.items())
        },
        'figure 8, 100,000 instances: worst first state, ms': max(first) / 1000,
        'figure 8, 100,000 instances: median, ms': median(first) / 1000,
    }


def every_state(**_: Any) -> list[Rows]:
    """Measure formulas asked at every state, beside one evaluation."""
    rows = []
    for what, body, once, feature, wave in (
        ('bounded response', RESPONSE.removeprefix('always '), RESPONSE, 'Alt', SAWTOOTH),
        ('invariant', INVARIANT.removeprefix('always '), INVARIANT, 'Alt', SAWTOOTH),
        ('window of 5 s', 'always[0, 5 s] Alt[x] > 0', INVARIANT, 'Alt', SAWTOOTH),
        ('power', POWER.removeprefix('always '), POWER, 'Power', SURGES),
        ('nested windows', NESTED.removeprefix('always '), NESTED, 'Power', PULSES),
    ):
        with patch.object(standing_monitor, 'quiet_starts', return_value=None):
            at_each_state = settled(from_dicts(body, feature, wave, 100, every_state=True))
        rows.append({
            'formula': what,
            '100 objects, progressed at each state': at_each_state,
            '100 objects': settled(from_dicts(body, feature, wave, 100, every_state=True)),
            '100 objects, once': settled(from_dicts(once, feature, wave, 100)),
            **{
                f'in a loop, {kind} times{", once" if text is once else ""}': in_a_loop(
                    text, feature, wave, regular=kind == 'regular', every_state=text is body
                )
                for kind in ('regular', 'irregular')
                for text in (body, once)
            },
        })  # fmt: skip
    return rows


def settled(found: Sequence[float]) -> float:
    """Return the mean cost of a state after the first fifth of a run."""
    return mean(found[len(found) // 5 :])


def open_starts(**_: Any) -> list[Rows]:
    """Measure windows whose starts stay open, in each quarter of a run.

    Triggers last for random times, and an answer comes shortly before the window ends.
    """
    states, random = 100_000, np.random.default_rng(7)
    rows = []
    for seconds in (5, 50, 500):
        wave = np.repeat([3.0, 1.0] * states, random.integers(1, 7, 2 * states))[:states]
        wave[:: 8 * seconds] = -1.0
        values = [{'Alt[o0]': value} for value in wave.tolist()]
        text = f'Alt[x] > 2 -> eventually[0, {seconds} s] Alt[x] < 0'
        group = group_of(text, every_state=True)
        quarters = costs(group.progress, times_of(states), values, states // 4)
        [formula] = group.standing.formulas.values()
        assert not formula.monitor.failure_count
        starts = len(formula.monitor.undecided())
        rows.append({'window_s': seconds, 'quarters': quarters, 'open starts': starts})
    return rows


def growth(**_: Any) -> Rows:
    """Measure growing windows, numbers of formulas and of objects, and a formula that grows."""
    windows = {each: RESPONSE.replace('5 s', f'{each} s') for each in (10, 100, 1000)}
    numbers = (10, 100, 1000, 10_000)
    rng = np.random.default_rng(6)
    truths = (rng.random((3000, 4)) < [0.5, 0.6, 0.8, 0.8]) | (np.arange(3000) % 7 == 0)[:, None]
    states = [dict(zip('pqrs', row, strict=True)) for row in truths.tolist()]
    growing = costs(group_of(GROWING).progress, times_of(3000), states)
    return {
        **{
            f'window of {each} s, {"regular" if regular else "irregular"}': in_a_loop(
                text, 'Alt', SAWTOOTH, regular=regular
            )
            for each, text in windows.items()
            for regular in (True, False)
        },
        **{
            f'{each} formulas': median(
                from_dicts(PAPER, 'p', STREAMS['often'], each, separate=True)
            )
            for each in numbers
        },
        **{
            f'{each} objects': median(from_dicts(RESPONSE, 'Alt', SAWTOOTH, each))
            for each in numbers
        },
        'a nested formula that grows, mean': mean(growing),
        'a nested formula that grows, worst': max(growing),
    }


def margins(*, peers: str, **_: Any) -> list[Rows]:
    """Measure margins of nested formulas, over a window of 5 s; all tools must agree on them."""
    rows = []
    for name, case in MARGINS.items():
        row: Rows = {'formula': name}
        row['with the verdict'], least = margin_cost(f'always ({case.ours})')
        row['bounds at each state'], _ = margin_cost(f'always ({case.ours})', ask=True)
        row['from every state'], every = margin_cost(case.ours, every_state=True)
        assert isclose(least, every)
        formulas = {'mstlo': case.mstlo, 'rtamt': case.rtamt, 'horizon': case.horizon}
        asked = peers if case.mstlo else ''
        wave = {'wave': SLOW_SAWTOOTH, 'states': 10 * PART}
        for tool, each in (
            ask_peers(asked, 'margins', **formulas, **wave) if asked else {}
        ).items():
            if isclose(each.get('margin', 0.0), least):
                row[tool] = each['us']
            else:
                skip(tool, each)
        rows.append(row)
    for name, text in (('bounded response', RESPONSE), ('invariant', 'always Alt[x] < 5')):
        cost, _ = margin_cost(text, 100)
        rows.append({'formula': f'{name}, 100 objects', 'with the verdict': cost})
    rows.append({'formula': 'invariant', 'with the verdict': margin_cost('always Alt[x] < 5')[0]})
    return rows


def margin_cost(
    text: str, objects: int = 1, *, ask: bool = False, every_state: bool = False
) -> tuple[float, float]:
    """Return the cost of a state with the margin of a formula, and the least margin.

    Args:
        text: the formula.
        objects: the number of objects.
        ask: True to ask for the margin after each state.
        every_state: True to ask for the formula at every state.
    """
    names = [f'o{index}' for index in range(objects)]
    group = FormulaGroup()
    number = group.add_formula('it', f'forall x in S: {text}', margin=True, every_state=every_state)
    group.begin({'S': names})
    states = [{f'Alt[{name}]': value for name in names} for value in SLOW_SAWTOOTH]

    def progress(time: int, state: Any) -> Any:
        results = group.progress(time, state)
        group.margin(number)
        return results

    times = times_of(10 * PART // objects)
    found = costs(progress if ask else group.progress, times, states, len(times) // 10)
    margin = group.margin(number)
    assert margin is not None
    return median(found), margin.upper


def memory(*, quick: bool, **_: Any) -> list[Rows]:
    """Measure the resident memory over ten million states at irregular times."""
    rows = []
    progress = group_of(POWER).progress
    states = [{'Power[o0]': value} for value in SURGES]
    times, span = times_of(1_000_000, regular=False), 0
    for million in range(1, 2 if quick else 11):
        for time, state in zip(times, cycle(states), strict=False):
            assert not progress(span + time, state)
        span += times[-1]
        if million in {1, 10}:
            pages = int(Path('/proc/self/statm').read_text(encoding='utf-8').split()[1])
            rows.append({'million states': million, 'resident_mib': pages * 4096 / 2**20})
    return rows


if __name__ == '__main__':
    check_equality()
    measure(
        __doc__, one_formula, figure_8, many_objects, every_state, open_starts, growth, margins,
        memory, peers='',
    )  # fmt: skip
