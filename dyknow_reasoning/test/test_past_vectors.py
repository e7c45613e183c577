"""Past operators of many objects, whose registers take states as vectors."""

from __future__ import annotations

from itertools import accumulate, pairwise
from math import inf, nan
from random import Random
from typing import Any

import pytest
from reasoning_reference import begun, progressed, random_cases

from dyknow_common import Verdict
from dyknow_reasoning import FormulaGroup
from dyknow_reasoning.execution import instance_pool
from dyknow_reasoning.execution.past import register_groups
from dyknow_reasoning.execution.past.register_groups import RegisterGroup
from dyknow_reasoning.language.interval import Interval
from dyknow_reasoning.progression.past_operators import ALL_ROWS, PreviousMemory, SinceMemory

CASES = random_cases(40)
NAMES = [f'o{number}' for number in range(6)]
PAST = [
    'once[a, b] p[x]',
    'historically[a, b] v[x] > 1',
    'p[x] since[a, b] v[x] < 2',
    'not p[x] since[a, b] (v[x] >= w[x] or q)',
    '(q or v[x] > 1) since[a, b] p[x]',
    'p[x] since[a, b] not s[x] = "on"',
    'previous p[x]',
    'previous (q and not p[x])',
    'once[a, b] p[x] or not once[a, b] v[x] = 2',
    'once[a, b] (p[x] and previous v[x] > 0)',
    'once[a, b] v[x] / w[x] > 1',
    'once[a, b] (s[x] = x or v[x] > 9007199254740993)',  # Stays single.
]


@pytest.mark.parametrize('seed', range(4))
def test_a_memory_of_many_objects_is_that_of_each(seed: int) -> None:
    random = Random(seed)  # noqa: S311 - no secret
    for _ in range(CASES):
        start = random.choice([0, 0, 1, 3, 5])
        end = random.choice([None, start, start + 1, start + 6])
        kind = random.choice([SinceMemory, SinceMemory, PreviousMemory])
        has_left = random.random() < 0.7
        singles = [kind(Interval(start, end)) for _ in range(5)]
        memory = kind(Interval(start, end))
        for time in accumulate(random.choice([1, 1, 2, 7]) for _ in range(30)):
            left = random.getrandbits(5) | random.getrandbits(5) if has_left else ALL_ROWS
            right = random.getrandbits(5) & random.getrandbits(5)
            expected = [
                each.step(time, -(left >> row & 1), right >> row & 1)
                for row, each in enumerate(singles)
            ]
            found = memory.step(time, left, right)
            assert [found >> row & 1 for row in range(5)] == expected
            if random.random() < 0.2:
                singles = [memory.of_row(row) for row in range(5)]


States = list[tuple[int, dict[str, Any]]]


def outcomes(group: FormulaGroup, states: States, gaps: set[int], blocks: set[int]) -> Any:
    """The results; all states from each of some indices to the next one at once."""
    found = []
    for first, end in pairwise(sorted({0, *gaps, *blocks, len(states)})):
        if first in gaps:
            group.gap()
        part = states[first:end]
        if first in blocks:
            columns = {name: [values[name] for _, values in part] for name in part[0][1]}
            found += group.progress_many([time for time, _ in part], columns)
        else:
            found += progressed(group, part)
    told = [(each.name, each.verdict, each.decided_at, each.explanation) for each in found]
    return told, [str(each.error) for each in found], group.standing.summary(1)


def uses_vectors(group: FormulaGroup) -> bool:
    assert group._monitor is not None
    units = group._monitor.histories._units
    return any(isinstance(each, RegisterGroup) and each._memory for each in units)


def random_states(random: Random) -> States:
    most, bias = random.choice([1, 2, 6]), random.random()
    odd = random.choice([0, 0, 0, 0.002])
    time = random.choice([0, 0, -(1 << 62) - 20, (1 << 62) - 20])
    states = []
    for _ in range(random.randint(1, 25)):
        time += random.randint(1, most)
        values: dict[str, Any] = {'q': random.random() < bias}
        for name in NAMES:
            values[f'p[{name}]'] = random.random() < bias
            values[f'v[{name}]'] = random.choice([0.0, 1.0, 2.0, 3.0])
            values[f'w[{name}]'] = random.choice([1.0, 2.0])
            values[f's[{name}]'] = random.choice(['on', 'off'])
        for name in list(values):
            if random.random() < odd:
                values[name] = random.choice([nan, inf, 1, True, 'text', 1 << 54, 0.0])
            if random.random() < odd / 4:
                del values[name]
        states.append((time, values))
    return states


def random_formulas(random: Random) -> list[tuple[str, str]]:
    past = random.choice(PAST)
    a = random.choice([0, 0, 1, 4])
    end = random.choice(['inf', f'{a} ns', f'{a + 1} ns', f'{a + 5} ns'])
    past = past.replace('[a, b]', f'[{a} ns, {end}]')
    text = random.choice(
        [
            f'always (({past}) or not ({past}))',
            f'always (p[x] -> eventually[0, 2 ns] ({past}))',
            f'eventually ({past})',
            f'{past}',
            f'always ({past})',
        ]
    )
    if random.random() < 0.5:
        return [('all', f'forall x in S: {text}')]
    return [(name, text.replace('[x]', f'[{name}]')) for name in NAMES]


def test_vectors_have_no_effect_on_results(monkeypatch: pytest.MonkeyPatch) -> None:
    """With unusable values, gaps, formulas that come and go, and formulas at every state."""
    random = Random(1)  # noqa: S311 - no secret
    used = 0
    for _ in range(CASES):
        texts, states = random_formulas(random), random_states(random)
        texts += random_formulas(random) if random.random() < 0.5 else []
        gaps = {random.randrange(len(states))} if random.random() < 0.2 else set()
        every_state = random.random() < 0.3
        is_whole = all(states[0][1].keys() == values.keys() for _, values in states)
        blocks = {index for index in range(len(states)) if random.random() < 0.2 * is_whole}
        found = []
        for least, recorded in ((2, set()), (1000, set()), (2, blocks), (1000, blocks)):
            monkeypatch.setattr(register_groups, 'MIN_REGISTERS', least)
            monkeypatch.setattr(instance_pool, '_MIN_BATCH_SIZE', least)
            monkeypatch.setattr(register_groups, '_MOST_VALUES', random.choice([1, 20, 1 << 20]))
            group = FormulaGroup()
            for name, text in texts:
                group.add_formula(name, text, every_state=every_state)
            group.begin({'S': NAMES})
            found.append(outcomes(group, states, gaps, recorded))
            assert group._monitor is not None
            used += least == 2 and uses_vectors(group)
        assert all(each == found[0] for each in found), (texts, states, gaps, blocks)
    assert used > CASES // 20


def test_times_that_no_vector_holds() -> None:
    names = [f'o{number}' for number in range(30)]
    group, _ = begun('forall x in S: always (r[x] -> once[0, 9 s] p[x])', {'S': names})
    begin = -(1 << 70)
    false = {f'{feature}[{name}]': False for name in names for feature in 'pr'}
    true = dict.fromkeys(false, True)
    for number in range(5):
        assert not group.progress(begin + number, false)
    assert not group.progress(begin + 5, true)
    assert not group.progress(0, false)
    assert not group.progress(1, true)
    assert not group.progress(2, true | {'p[o3]': False})
    [result] = group.progress(9_000_000_002, false | {'r[o3]': True})
    assert result.verdict is Verdict.FALSE


@pytest.mark.parametrize(
    ('operator', 'has_gap', 'expected'),
    [('once', False, 'TRUE'), ('historically', True, 'missing between')],
)
def test_registers_take_what_their_group_remembers(
    operator: str,
    has_gap: bool,  # noqa: FBT001
    expected: str,
) -> None:
    """A number that no vector holds, or a gap, ends the group."""
    names = [f'o{number}' for number in range(30)]
    text = f'forall x in S: always[0, 5 ns] (r[x] -> {operator}[0, 9 ns] v[x] > 1)'
    group, _ = begun(text, {'S': names})
    asked, usual = ({f'r[{x}]': r for x in names} for r in (True, False))
    high, low = ({f'v[{x}]': v for x in names} for v in (2.0, 0.0))
    assert not group.progress(0, usual | high)
    if has_gap:
        group.gap()
    else:
        assert not group.progress(1, usual | low | {'v[o3]': 1 << 60})
    [result] = group.progress(5, asked | (high if has_gap else low))
    assert expected in str(result.error or result.verdict.name)
