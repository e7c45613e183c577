"""However formulas are progressed, the results are the same, to the letter."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate, product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reasoning_reference import begun, formulas, random_cases
from reasoning_reference import started as started_over

from dyknow_reasoning import FormulaGroup, FormulaLimits, FormulaResult
from dyknow_reasoning.execution import instance_pool
from dyknow_reasoning.execution.automata import automaton, configurations
from dyknow_reasoning.execution.past import register_groups
from dyknow_reasoning.language.formula import Formula

OBJECTS = ('a', 'b', 'c', 'd')
Columns = dict[str, list[Any]]


def grounded(formula: Formula, name: str) -> str:
    """A formula about an object: p becomes a comparison, q a boolean feature of it."""
    text = re.sub(r'\bp\b', f'(N[{name}] < 1)', str(formula))
    return re.sub(r'\bq\b', f'Q[{name}]', text)


def started(formula: Formula) -> FormulaGroup:
    group = FormulaGroup()
    group.add_formula('all', f'forall x in S: ({grounded(formula, "x")})')
    group.add_formula('some', f'exists x in S: ({grounded(formula, "x")})')
    for name in OBJECTS:
        group.add_formula(name, grounded(formula, name))
    group.begin({'S': OBJECTS})
    return group


def one_by_one(group: FormulaGroup, times: Sequence[int], columns: Columns) -> list[FormulaResult]:
    rows = zip(*columns.values(), strict=True)
    states = [dict(zip(columns, row, strict=True)) for row in rows]
    results = (group.progress(time, state) for time, state in zip(times, states, strict=True))
    return [plain(result) for found in results for result in found]


def at_once(group: FormulaGroup, times: Sequence[int], columns: Columns) -> list[FormulaResult]:
    middle = len(times) // 2
    arrays = {name: np.array(column) for name, column in columns.items()}
    results = group.progress_many(times[:middle], {k: v[:middle] for k, v in arrays.items()})
    results += group.progress_many(times[middle:], {k: v[middle:] for k, v in columns.items()})
    return [plain(result) for result in results]


def plain(result: FormulaResult) -> FormulaResult:
    """A result that compares by the text of its error."""
    return replace(result, explanation=result.explanation or str(result.error), error=None)


# How; the fewest instances in a batch, the most configurations, the most nodes.
PATHS = list(product((one_by_one, at_once), (1, 1000), (0, 1 << 14), (8, 1 << 16)))


def set_limits(patch: pytest.MonkeyPatch, batch: int, configurations_: int, nodes: int) -> None:
    patch.setattr(instance_pool, '_MIN_BATCH_SIZE', batch)
    patch.setattr(register_groups, 'MIN_REGISTERS', batch)
    patch.setattr(configurations, '_MAX_CONFIGURATIONS', configurations_)
    patch.setattr(automaton, '_MAX_NODES', nodes)


@st.composite
def recordings(draw: st.DrawFn, most_step: int) -> tuple[list[int], Columns]:
    """Few or many states, at a period or not, in which each object has its own values."""
    states = draw(st.integers(2, 24))
    steps = draw(st.lists(st.integers(1, most_step), min_size=states, max_size=states))
    columns: Columns = {}
    for name in OBJECTS:
        numbers = st.lists(st.sampled_from([0.5, 1.5]), min_size=states, max_size=states)
        truths = st.lists(st.booleans(), min_size=states, max_size=states)
        columns[f'N[{name}]'], columns[f'Q[{name}]'] = draw(numbers), draw(truths)
    return list(accumulate(steps)), columns


def check(
    formula: Formula, recording: tuple[list[int], Columns], paths: Sequence[tuple[Any, ...]]
) -> None:
    found = []
    for progressed, *limits in (PATHS[-1], *paths):
        with pytest.MonkeyPatch.context() as patch:
            set_limits(patch, *limits)
            found.append(progressed(started(formula), *recording))
        assert found[-1] == found[0], (str(formula), progressed.__name__, limits)


SOME_PATHS = st.lists(st.sampled_from(PATHS[:-1]), min_size=3, max_size=3, unique=True)


@pytest.mark.parametrize('most_step', [1, 5])
@settings(max_examples=random_cases(20))
@given(formulas(3), SOME_PATHS, st.data())
def test_all_paths_give_the_same_results(
    most_step: int, formula: Formula, paths: list[tuple[Any, ...]], data: st.DataObject
) -> None:
    check(formula, data.draw(recordings(most_step)), paths)


BAD_VALUES = ['x', True, None, float('nan'), 1 << 60, -(1 << 60)]


@given(formulas(2), recordings(2), st.data())
def test_bad_values_give_the_same_errors(
    formula: Formula, recording: tuple[list[int], Columns], data: st.DataObject
) -> None:
    times, columns = recording
    for _ in range(2):
        name = data.draw(st.sampled_from(sorted(columns)))
        index = data.draw(st.integers(0, len(times) - 1))
        columns[name][index] = data.draw(st.sampled_from(BAD_VALUES))
    check_lists(formula, times, columns)


def check_lists(formula: Formula, times: list[int], columns: Columns) -> None:
    found = []
    for batch, progressed in product((1, 1000), (one_by_one, lists_at_once)):
        with pytest.MonkeyPatch.context() as patch:
            set_limits(patch, batch, 1 << 14, 1 << 16)
            found.append(progressed(started(formula), times, columns))
    assert all(each == found[0] for each in found)


def lists_at_once(
    group: FormulaGroup, times: Sequence[int], columns: Columns
) -> list[FormulaResult]:
    return [plain(result) for result in group.progress_many(times, columns)]


@pytest.mark.parametrize('batch', [1, 1000])
def test_absent_fields_matter_only_while_needed(
    batch: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_limits(monkeypatch, batch, 1 << 14, 1 << 16)
    texts = {name: f'(eventually P[{name}]) and always Q[{name}]' for name in OBJECTS}
    group = started_over(*texts.values())
    every = {f'{feature}[{name}]': True for name in OBJECTS for feature in 'PQ'}
    assert group.progress(0, every) == []
    assert group.progress(1, {f'Q[{name}]': True for name in OBJECTS}) == []
    [failed] = group.progress(2, {f'Q[{name}]': True for name in OBJECTS[1:]})
    assert "no field 'Q[a]'" in str(failed.error)
    values = {f'Q[{name}]': name != 'c' for name in OBJECTS[1:]}
    [false] = group.progress(3, values)
    assert false.name == texts['c']


NUMBERS = st.one_of(
    st.floats(allow_nan=False),
    st.integers(-9, 9),
    st.sampled_from([1 << 30, (1 << 53) + 1, -(1 << 62), 0]),
)
TERMS = st.recursive(
    st.sampled_from(['A[x]', 'B[x]', '2', '0.5', '3']),
    lambda inner: (
        st.tuples(inner, st.sampled_from('+-*/'), inner).map(lambda parts: f'({" ".join(parts)})')
        | st.tuples(st.sampled_from(['abs', 'sqrt']), inner).map('{0[0]}({0[1]})'.format)
        | st.tuples(
            st.sampled_from(['min', 'max', 'hypot', 'angle_difference', 'pow']), inner, inner
        ).map('{0[0]}({0[1]}, {0[2]})'.format)
    ),
    max_leaves=5,
)


@given(
    TERMS,
    st.sampled_from(['=', '!=', '<', '<=', '>', '>=']),
    TERMS,
    st.lists(st.tuples(NUMBERS, NUMBERS), min_size=len(OBJECTS), max_size=len(OBJECTS)),
)
def test_arithmetic_is_the_same_over_columns(
    left: str, operator: str, right: str, values: list[tuple[float, float]]
) -> None:
    found = []
    state = {}
    for name, (first, second) in zip(OBJECTS, values, strict=True):
        state[f'A[{name}]'], state[f'B[{name}]'] = first, second
    for batch in (1, 1000):
        with pytest.MonkeyPatch.context() as patch:
            set_limits(patch, batch, 1 << 14, 1 << 16)
            text = f'A[x] < 1 or {left} {operator} {right}'
            group = started_over(*(text.replace('[x]', f'[{name}]') for name in OBJECTS))
            found.append([plain(result) for result in group.progress(0, state)])
    assert found[0] == found[1]


@pytest.mark.parametrize('configurations_', [0, 1 << 14])
def test_what_remains_is_the_same_in_a_batch(
    configurations_: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    texts = []
    for batch in (1, 1000):
        set_limits(monkeypatch, batch, configurations_, 1 << 16)
        text = 'forall x in S: always (P[x] -> eventually[1 ms, 5 ms] not P[x])'
        group, number = begun(text, {'S': OBJECTS})
        for time in range(12):
            state = {f'P[{name}]': time % 5 > index for index, name in enumerate(OBJECTS)}
            assert group.progress(time * 1_000_000, state) == []
            texts.append((batch, time, group.residual(number)))
    half = len(texts) // 2
    assert [each[1:] for each in texts[:half]] == [each[1:] for each in texts[half:]]
    assert any('eventually[0 s, 4 ms]' in text for _, _, text in texts)


@pytest.mark.parametrize('batch', [1, 1000])
def test_the_node_limit_counts_all_instances(batch: int, monkeypatch: pytest.MonkeyPatch) -> None:
    set_limits(monkeypatch, batch, 1 << 14, 1 << 16)
    text, limits = 'always (P[x] -> eventually[5 ms, 9 ms] not P[x])', FormulaLimits(node_limit=60)
    group = started_over(
        f'forall x in S: {text}', 'always P[a]', domains={'S': OBJECTS}, limits=limits
    )
    state = {f'P[{name}]': True for name in OBJECTS}
    results = [result for time in range(8) for result in group.progress(time * 1_000_000, state)]
    [failed] = results
    assert failed.name == f'forall x in S: {text}'
    assert "more than 60 (the limit 'node_limit'): 3 windows of eventually[5 ms, 9 ms]" in str(
        failed.error
    )


@pytest.mark.parametrize('batch', [1, 1000])
def test_a_period_that_misses_states_and_one_that_changes(
    batch: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Regular, irregular and again regular times: the windows stay where they are."""
    set_limits(monkeypatch, batch, 1 << 14, 1 << 16)
    steps = [10] * 20 + [30] + [10] * 5 + list(range(1, 30)) + [7] * 30
    times = list(accumulate(steps))
    for late in range(40, 84):
        group = FormulaGroup()
        for name in OBJECTS:
            group.add_formula(name, f'eventually[40 ns, 60 ns] P[{name}] or always Q[{name}]')
            group.add_formula(
                f'{name} due', f'always (Q[{name}] or eventually[0, 60 ns] P[{name}])'
            )
        group.begin({})
        results = []
        for index, time in enumerate(times):
            state = {f'P[{name}]': False for name in OBJECTS}
            state |= {f'Q[{name}]': index != late for name in OBJECTS}
            results += group.progress(time, state)
        due = next((time for time in times if time >= times[late] + 60), None)
        found = {result.decided_at for result in results if 'due' in result.name}
        assert found == (set() if due is None else {due})
