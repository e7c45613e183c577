"""Formulas asked at every state over recordings: the same as state by state."""

from __future__ import annotations

from itertools import accumulate
from math import nan
from random import Random
from typing import Any

from reasoning_reference import progressed, random_cases

from dyknow_reasoning import FormulaGroup, FormulaLimits

CASES = random_cases(40)
OBJECTS = ['a', 'b']
FORMULAS = [
    'v[x] > 1 -> eventually[0, 5 ns] p[x]',
    'p[x] -> once[0, 3 ns] v[x] < 1',
    'v[x] + 1 > 1 until[1 ns, 4 ns] always[0, 3 ns] not p[x]',
    'always[0, 3 ns] (p[x] -> eventually[0, 4 ns] (v[x] < 2 and previous p[x]))',
    'true',
    'p[x]',
]


def random_columns(random: Random, count: int) -> dict[str, list[Any]]:
    odd = random.choice([0, 0, 0.01])
    columns: dict[str, list[Any]] = {}
    for name in OBJECTS:
        columns[f'p[{name}]'] = [random.random() < 0.6 for _ in range(count)]
        columns[f'v[{name}]'] = [random.choice([0.0, 1.0, 2.0, 3.0]) for _ in range(count)]
    for column in columns.values():
        for index in range(count):
            if random.random() < odd:
                column[index] = random.choice([nan, 'text', True, 1 << 70])
    return columns


def told(group: FormulaGroup) -> Any:
    standing = group.standing
    found = [(standing.summary(each), group.presumably_false(each)) for each in standing.formulas]
    return found, standing.changed()


def test_recordings_are_progressed_as_states_are() -> None:
    random = Random(1)  # noqa: S311 - no secret
    for _ in range(CASES):
        limits = FormulaLimits(node_limit=random.choice([40, 10_000]))
        groups = FormulaGroup(limits), FormulaGroup(limits)
        texts = [(random.choice(FORMULAS), random.random() < 0.7) for _ in range(3)]
        for group in groups:
            for text, every_state in texts:
                group.add_formula(text, f'forall x in S: {text}', every_state=every_state)
            group.begin({'S': OBJECTS})
        one_by_one, at_once = groups
        time, case = 0, (texts, [])
        for _ in range(2):
            count = random.randint(0, 20)
            steps = [random.choice([1, 1, 1, 2]) for _ in range(count)]
            if count > 1 and random.random() < 0.1:
                steps[-1] = 0
            times = [time + step for step in accumulate(steps)]
            columns = random_columns(random, count)
            case[1].append((times, columns))
            rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values())]  # noqa: B905
            expected = progressed(one_by_one, list(zip(times, rows, strict=True)))
            found = at_once.progress_many(times, columns)
            assert list(map(repr, found)) == list(map(repr, expected)), case
            assert told(at_once) == told(one_by_one), case
            time = times[-1] if times else time
            if random.random() < 0.3:
                time += 2
                for group in groups:
                    group.gap()
