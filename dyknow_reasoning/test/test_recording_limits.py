"""Recordings give the results of single states, also beyond the sizes they are designed for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reasoning_reference import started
from test_many_states import compare

from dyknow_reasoning.execution import instance_monitor, instance_pool

PERIOD_NS = 100_000_000


@given(st.data())
def test_formulas_of_many_atoms(data: st.DataObject) -> None:
    atoms = data.draw(st.integers(1, 70))
    objects = data.draw(st.integers(1, 30))
    states = data.draw(st.integers(1, 12))
    generator = np.random.default_rng(data.draw(st.integers(0, 1 << 32)))
    body = ' or '.join(f'P{number}[x]' for number in range(atoms))
    formulas = [
        f'forall x in Thing: always ({body})',
        f'forall x in Thing: eventually[0 s, 500 ms] P{atoms - 1}[x]',
    ]
    columns = {
        f'P{number}[o{thing}]': (generator.random(states) < 2 / atoms).tolist()
        for number in range(atoms)
        for thing in range(objects)
    }
    compare(formulas, objects, [([PERIOD_NS * n for n in range(states)], columns)])


@pytest.mark.parametrize('slot', [0, 7, 8, 31, 32, 62, 63, 64, 69])
def test_the_atom_that_decides_may_have_any_slot(slot: int) -> None:
    names = [f'p{number}' for number in range(70)]
    columns = {name: [True, name == f'p{slot}', False] for name in names}
    formula = f'always ({" or ".join(names)})'
    compare([formula], 0, [([0, PERIOD_NS, 2 * PERIOD_NS], columns)])


@given(st.data())
def test_values_that_are_not_known_in_some_instances(data: st.DataObject) -> None:
    objects = data.draw(st.integers(1, 60))
    states = data.draw(st.integers(1, 40))
    generator = np.random.default_rng(data.draw(st.integers(0, 1 << 32)))
    formulas = [
        'forall x in Thing: always (A[x] > 0.1 -> eventually[0 s, 300 ms] B[x] > 0.2)',
        'always A[o0] > 0.05',
        'exists x in Thing: always A[x] > 0.9',
        *(f'always[0 s, {thing % 5} s] A[o{thing}] > 0.02' for thing in range(objects)),
    ]
    columns: dict[str, list[float]] = {}
    for name in 'AB':
        for thing in range(objects):
            column = generator.random(states)
            column[generator.random(states) < 0.01] = np.nan
            columns[f'{name}[o{thing}]'] = column.tolist()
    with pytest.MonkeyPatch.context() as patch:
        # Few states a block, so that blocks follow on one that cannot be read as a whole.
        patch.setattr(instance_monitor, '_FIRST_STATES', data.draw(st.sampled_from([1, 2, 5])))
        patch.setattr(instance_pool, '_MIN_BATCH_SIZE', data.draw(st.sampled_from([2, 1000])))
        compare(formulas, objects, [([PERIOD_NS * n for n in range(states)], columns)])


def test_times_beyond_the_precision_of_floats() -> None:
    times = [(1 << 62) + 1, (1 << 62) + 2, (1 << 62) + 3]
    columns = {'p': [True, True, True]}
    compare(['always[0 ns, 1 ns] p', 'always[0 ns, 2 ns] p'], 0, [(times, columns)])
    for kind in (np.uint64, np.int64):
        found = started('always[0 ns, 1 ns] p').progress_many(np.array(times, kind), columns)
        assert [result.decided_at for result in found] == [times[1]]


def test_times_at_and_beyond_the_limit_of_64_bits() -> None:
    compare(['always[0 ns, 2 ns] p'], 0, [([-1, 1 << 63], {'p': [True] * 2})])
    times = [(1 << 63) - 1, 1 << 63, (1 << 63) + 1, 1 << 64]
    compare(['always[0 ns, 2 ns] p'], 0, [(times, {'p': [True] * 4})])
    found = started('always[0 ns, 1 ns] p').progress_many(
        np.array(times[:3], np.uint64), {'p': [True] * 3}
    )
    assert [result.decided_at for result in found] == [times[1]]
