"""Many states at once give, to the letter, what the same states give one by one."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reasoning_reference import begun, comparable, formulas, progressed, random_cases, started

from dyknow_reasoning import FormulaGroup, FormulaLimits
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution import block_progression, instance_monitor, instance_pool
from dyknow_reasoning.execution.automata import automaton, configurations
from dyknow_reasoning.execution.single_instance import SingleInstance
from dyknow_reasoning.language.terms import Feature

pytestmark = pytest.mark.long

PERIOD = 3
LEAVES = st.sampled_from([f'leaf{number}' for number in range(6)]).map(Feature)
ATOMS = ('N0[x] < 2', 'N1[x] >= 1', 'N0[x] = N1[x]', 'N0[x] + 1 > N2[x]', 'Q[x]', 'T[x] = "on"')
LASTING = (
    'always (P -> eventually{} Q)',
    'always (P -> (not Q until{} R))',
    'always (P -> always{} Q)',
    'always (P -> eventually{} always{} Q)',
    'always (P and Q -> (eventually{} R or eventually{} Q))',
    'always{} P or eventually{} (Q and R)',
)
NUMBERS = ('int8', 'int16', 'int32', 'int64', 'uint8', 'uint16', 'uint32', 'uint64')
NUMBERS += ('float16', 'float32', 'float64', '>f8', '>i4', 'object', 'list')
Column: TypeAlias = Any
Batch: TypeAlias = tuple[Sequence[int], Mapping[str, Column]]


class Limits:
    """The sizes beyond which progression goes another way, all small or as they are."""

    def __init__(self, draw: Any) -> None:
        few = draw(st.booleans())
        self.sizes = {
            (instance_monitor, '_FIRST_STATES'): draw(st.sampled_from([1, 3, 64])),
            (instance_monitor, '_FEWEST_STATES'): draw(st.sampled_from([1, 16])),
            (instance_monitor, '_MOST_STATES'): draw(st.sampled_from([4, 1 << 16])),
            (instance_monitor, '_MIN_INSTANCES'): draw(st.sampled_from([1, 30, 256])),
            (instance_pool, '_MIN_BATCH_SIZE'): draw(st.sampled_from([2, 24, 1000])),
            (block_progression, '_MAX_LOOK_UPS'): draw(st.sampled_from([1, 3, 256])),
            (block_progression, '_FEW_STATES'): draw(st.sampled_from([0, 8, 1 << 30])),
            (automaton, '_MAX_NODES'): 8 if few else 1 << 16,
            (configurations, '_MAX_CONFIGURATIONS'): draw(st.sampled_from([0, 9, 1 << 14])),
        }

    def set(self, patch: pytest.MonkeyPatch) -> None:
        for (module, name), value in self.sizes.items():
            patch.setattr(module, name, value)


def rows(batch: Batch) -> Iterator[tuple[int, dict[str, Any]]]:
    times, columns = batch
    for index, time in enumerate(times):
        yield (
            int(time),
            {
                name: column[index:][:1].tolist()[0]
                if isinstance(column, np.ndarray)
                else column[index]
                for name, column in columns.items()
            },
        )


def remaining(group: FormulaGroup) -> list[Any]:
    return [(each, group.residual(each), group.presumably_false(each)) for each in group.formulas]


def compare(
    formulas_: Sequence[str],
    objects: int,
    batches: Sequence[Batch],
    gaps: Sequence[bool] = (),
    node_limit: int = 100_000,
) -> None:
    """Check that results, and what remains after each batch, are equal."""
    domains = {'Thing': [f'o{number}' for number in range(objects)]}
    limits = FormulaLimits(node_limit=node_limit)
    one_by_one, at_once = (started(*formulas_, domains=domains, limits=limits) for _ in range(2))
    for batch, is_gap in zip(batches, [*gaps, *[False] * len(batches)], strict=False):
        expected = progressed(one_by_one, list(rows(batch)))
        assert comparable(at_once.progress_many(*batch)) == comparable(expected)
        assert remaining(at_once) == remaining(one_by_one)
        if is_gap:
            one_by_one.gap()
            at_once.gap()


def numbers(generator: np.random.Generator, states: int, kind: str) -> Column:
    """Small numbers, rarely changing, of a type; few of them are missing or very large."""
    runs = generator.integers(0, 4, states)[generator.integers(0, states, states).cumsum() % states]
    found = np.where(generator.random(states) < generator.choice([0.1, 0.9]), runs, 1)
    rare = generator.random(states) < generator.choice([0, 0, 0.003])
    if kind in {'object', 'list'}:
        values = [float(each) if each % 2 else int(each) for each in found.tolist()]
        for index in np.flatnonzero(rare).tolist():
            values[index] = generator.choice([None, np.nan, 1 << 60, 'text', True])
        return values if kind == 'list' else np.fromiter(values, object, states)
    column = found.astype(kind)
    if 'f' in kind:
        column[rare] = generator.choice([np.nan, np.inf])
    else:
        column[rare] = np.iinfo(kind).max
    # Every second value of a longer array, which is not writable either.
    strided = np.repeat(column, 2)[::2]
    strided.flags.writeable = False
    return strided


def column_of(name: str, generator: np.random.Generator, states: int, kind: str) -> Column:
    if name[0] == 'N':
        return numbers(generator, states, kind)
    chosen = generator.random(states) < generator.choice([0.02, 0.5, 0.98])
    if name[0] == 'Q':
        return chosen
    return np.where(chosen, 'on', 'off').astype(generator.choice(['U3', 'object']))


def times_of(generator: np.random.Generator, states: int) -> list[int]:
    steps = np.full(states, PERIOD)
    jitter = generator.choice([0, 0.1, 1])
    is_late = generator.random(states) < jitter
    steps[is_late] = generator.integers(1, 3 * PERIOD, states)[is_late]
    found: list[int] = steps.cumsum().tolist()
    return found


def ground(text: str, objects: int, generator: np.random.Generator) -> str:
    """A formula about all objects, some object or a certain one."""
    text = re.sub(r'leaf(\d)', lambda found: f'({ATOMS[int(found[1])]})', text)
    quantifier = generator.choice(['forall', 'exists', ''])
    if quantifier:
        return f'{quantifier} x in Thing: ({text})'
    return text.replace('[x]', f'[o{generator.integers(objects)}]')


def lasting(generator: np.random.Generator) -> str:
    """A formula that often remains undecided for many states, with windows of some states."""
    text = str(generator.choice(LASTING))
    while '{}' in text:
        begin, length = generator.integers(0, 4 * PERIOD), generator.integers(0, 9 * PERIOD)
        text = text.replace('{}', f'[{begin * generator.integers(2)} ns, {begin + length} ns]', 1)
    for name in 'PQR':
        negation = generator.choice(['', 'not '])
        text = re.sub(rf'\b{name}\b', f'{negation}leaf{generator.integers(len(ATOMS))}', text)
    return text


@st.composite
def cases(draw: st.DrawFn) -> Any:
    generator = np.random.default_rng(draw(st.integers(0, 1 << 32)))
    objects = draw(st.one_of(st.integers(1, 4), st.integers(5, 60)))
    states = draw(st.integers(1, 150))
    texts = [*map(str, draw(st.lists(formulas(2, LEAVES), max_size=3)))]
    texts += [lasting(generator) for _ in range(draw(st.integers(1, 8)))]
    found = [ground(each, objects, generator) for each in texts]
    names = ['N0', 'N1', 'N2', 'Q', 'T']
    kinds = {name: draw(st.sampled_from(NUMBERS)) for name in names}
    columns = {
        f'{name}[o{number}]': column_of(name, generator, states, kinds[name])
        for name in names
        for number in range(objects)
    }
    times = times_of(generator, states)
    if draw(st.booleans()):
        times[int(generator.integers(states))] -= int(generator.integers(2 * PERIOD))
    cuts = sorted({0, states, *draw(st.lists(st.integers(0, states), max_size=4))})
    batches = [
        (times[begin:end], {name: column[begin:end] for name, column in columns.items()})
        for begin, end in pairwise(cuts)
    ]
    if draw(st.booleans()):
        batches[int(generator.integers(len(batches)))][1].pop(generator.choice(list(columns)))
    gaps = draw(st.lists(st.booleans(), max_size=len(batches)))
    return found, objects, batches, gaps, draw(st.sampled_from([100_000, 100_000, 400]))


@settings(max_examples=random_cases(20))
@given(cases(), st.data())
def test_random_formulas_over_random_states(case: Any, data: st.DataObject) -> None:
    with pytest.MonkeyPatch.context() as patch:
        Limits(data.draw).set(patch)
        try:
            compare(*case)
        except Exception as error:
            if 'node limit' in str(error) or 'nodes, more than' in str(error):
                return  # The text is too large already.
            raise


@pytest.mark.parametrize(
    ('kind', 'objects', 'states'),
    [('normal', 3, 9000), ('normal', 40, 300), ('sine', 3, 9000), ('sine', 300, 30)],
)
def test_more_states_than_a_block_has(kind: str, objects: int, states: int) -> None:
    """Noise changes at each state, and a sine seldom; there are more objects than in a batch."""
    generator = np.random.default_rng(objects)
    columns = {}
    for number in range(objects):
        noise = generator.normal(size=states)
        wave = np.sin(np.arange(states) / 40 + number)
        columns[f'A[o{number}]'] = noise if kind == 'normal' else wave * 2
        columns[f'B[o{number}]'] = generator.random(states) < 0.999
    found = [
        'forall x in Thing: always (A[x] > 1 -> eventually[0 s, 0.3 s] A[x] < 0.5)',
        'forall x in Thing: always (A[x] > 1 -> always[0 s, 2 s] A[x] > -1.5)',
        'forall x in Thing: always[0 s, 700 s] A[x] > -4',
        'forall x in Thing: A[x] < 3 until[1 s, 60 s] not B[x]',
        'exists x in Thing: always (B[x] or eventually[0.2 s, 0.4 s] A[x] > 0)',
        'always eventually[0 s, 5 s] A[o0] > 1.9',
    ]
    jitter = generator.integers(1, 200_000_000, states).cumsum()
    for times in (np.arange(states) * 100_000_000, jitter):
        middle = int(generator.integers(states))
        parts = (slice(0, middle), slice(middle, states))
        batches = [(times[s], {name: column[s] for name, column in columns.items()}) for s in parts]
        compare(found, objects, batches)


def runs(generator: np.random.Generator, states: int, length: int) -> np.ndarray[Any, Any]:
    """Truths that stay the same for some states, of an average length."""
    return (generator.random(states) < 1 / length).cumsum() % 2 == 1


@pytest.mark.parametrize(
    ('atoms', 'objects', 'states', 'odd'),
    [
        (2, 1, 5000, False),
        (2, 1, 5000, None),
        (2, 1, 5000, np.nan),
        (2, 30, 150, np.nan),
        (8, 2, 900, None),
        (9, 3, 900, False),
        (12, 2, 900, np.nan),
        (13, 2, 900, None),
        (70, 1, 900, False),
    ],
)
def test_long_runs_of_states_that_change_nothing(
    atoms: int, objects: int, states: int, odd: Column
) -> None:
    """Windows open, close and expire between states; a value is odd near the end."""
    generator = np.random.default_rng([atoms, objects, states])
    columns: dict[str, Column] = {}
    for number in range(objects):
        columns[f'P[o{number}]'] = runs(generator, states, 40)
        columns[f'Q[o{number}]'] = runs(generator, states, 60)
        for atom in range(2, atoms):
            columns[f'Q{atom}[o{number}]'] = ~runs(generator, states, 9 * states)
    late = int(generator.integers(states // 2, states))
    columns['P[o0]'] = [*columns['P[o0]'][:late].tolist(), odd, *columns['P[o0]'][late + 1 :]]
    q = ' and '.join(['Q[x]', *(f'Q{atom}[x]' for atom in range(2, atoms))])
    found = [
        f'forall x in Thing: always (P[x] -> eventually[0 ns, 700 ns] ({q}))',
        f'exists x in Thing: always[0 ns, {2 * states} ns] (P[x] -> eventually[9 ns, 300 ns] {q})',
        f'exists x in Thing: always (P[x] -> always[0 ns, 90 ns] P[x] or eventually ({q}))',
        f'exists x in Thing: (P[x] or {q}) until[50 ns, {2 * states} ns] ({q} and not P[x])',
    ]
    for times in (np.arange(states) * PERIOD, generator.integers(1, 7, states).cumsum()):
        compare(found, objects, [(times, columns)])


@pytest.mark.parametrize('few', [0, 8, 1 << 30])
def test_each_state_may_be_the_first_after_a_window(
    few: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Windows of all lengths end between states, and just before and after them."""
    monkeypatch.setattr(block_progression, '_FEW_STATES', few)
    bounds = [(begin, begin + length) for begin in (0, 1, 4) for length in (0, 1, 2, 3, 5, 8)]
    found = [
        text.format(f'[{begin} ns, {end} ns]')
        for begin, end in bounds
        for text in (
            'always (p -> eventually{} q)',
            'always (p -> always{} not q)',
            'always (p -> r until{} q)',
            'always (p and eventually{} q -> r)',
        )
    ]
    for steps in ([1] * 24, [3] * 12, [2, 3] * 7, [1, 2, 3, 4] * 4):
        times = np.cumsum(steps)
        for last in (8, 14, 30):
            columns = {name: np.zeros(len(times), bool) for name in 'pqr'}
            columns['p'][5:7] = columns['q'][last:] = columns['r'][: last - 2] = True
            compare(found, 0, [(times, columns)])


@pytest.mark.parametrize('atoms', [1, 8, 9, 12, 13, 31, 32, 33, 62, 63, 64, 65, 70])
def test_more_atoms_than_a_machine_word_has(atoms: int) -> None:
    generator = np.random.default_rng(atoms)
    states = 500
    columns = {f'p{number}': generator.random(states) < 0.98 for number in range(atoms)}
    columns[f'p{atoms - 1}'][300] = False
    every = ' and '.join(columns)
    some = ' or '.join(f'not {name}' for name in columns)
    last = f'p{atoms - 1}'
    found = [
        f'always ({every} or eventually[0 ns, 9 ns] ({every}))',
        f'always[0 ns, 450 ns] (({some}) -> eventually[0 ns, 40 ns] {last})',
        f'{every} until[20 ns, 400 ns] ({some})',
        f'always[0 ns, 299 ns] {last} or ({every})',
    ]
    compare(found, 0, [(range(1, states + 1), columns)])


@pytest.mark.parametrize(
    'kind', ['int8', 'int16', 'int32', 'int64', 'uint8', 'uint16', 'uint32', 'uint64', '>i8', 'O']
)
def test_times_are_integers_of_any_type(kind: str) -> None:
    times = np.array([1, 2, 100, 101]).astype(kind)
    columns = {'p': [True, True, True, False]}
    for found in (times, list(times), tuple(times.tolist()), np.repeat(times, 2)[::2]):
        compare(['always[0 ns, 99 ns] p', 'always p'], 0, [(found, columns)])


@pytest.mark.parametrize(
    ('times', 'type_name'),
    [
        (np.array([1.0, 2.0]), 'float64'),
        (np.array([1, 2], np.float32), 'float32'),
        (np.array([True, False]), 'bool'),
        (np.array([1, 2], 'datetime64[ns]'), r'datetime64\[ns\]'),
        (np.array([1, 2], 'timedelta64[s]'), r'timedelta64\[s\]'),
        (np.array(['1', '2']), 'str'),
        (np.array([1, 2.0], object), 'float'),
        (np.ma.masked_array([1, 2], [False, True]), 'NoneType'),
        ([1, 2.0], 'float'),
        ([1, np.float64(2)], 'float64'),
        ([1, True], 'bool'),
        ([1, np.True_], 'bool'),
        ([1, None], 'NoneType'),
        ([1, '2'], 'str'),
        ([np.datetime64(1, 'ns'), 2], 'datetime64'),
    ],
)
def test_times_of_other_types_are_errors(times: Any, type_name: str) -> None:
    group, _ = begun('always p')
    with pytest.raises(ReasoningError, match=f'valid times are of type {type_name}.*; give int'):
        group.progress_many(times, {'p': [True, False]})
    assert group.undecided


@pytest.mark.parametrize(
    ('times', 'column', 'message'),
    [
        ([[1, 2]], [True], 'type list'),
        (np.array([[1, 2]]), [True], 'the valid times have 2 dimensions'),
        ([1, 2], np.array([[True, False]]), "'p' has 2 dimensions"),
        ([1], np.array(True), "'p' has 0 dimensions"),
        ([1, 2], np.array([True]), "'p' has 1 values for 2 states"),
        ([], [True], "'p' has 1 values for 0 states"),
    ],
)
def test_columns_and_times_of_other_shapes_are_errors(
    times: Any, column: Any, message: str
) -> None:
    group, _ = begun('always p')
    with pytest.raises(ReasoningError, match=message):
        group.progress_many(times, {'p': column})


@pytest.mark.parametrize('batch', [2, 1000])
def test_times_that_do_not_fit_into_vectors(batch: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(instance_pool, '_MIN_BATCH_SIZE', batch)
    for begin in (-(1 << 63) - 3, (1 << 62) - 3, (1 << 63) - 3, 1 << 64):
        times = [begin, begin + 1, begin + 5, begin + (1 << 63), begin + (1 << 63) + 1]
        columns = {f'A[o{number}]': [2, 0, 0, 0, number % 3] for number in range(6)}
        formula = 'forall x in Thing: always (A[x] > 1 -> eventually[4 ns, 9 ns] A[x] > 1)'
        never = 'exists x in Thing: always[1 ns, 3000 ns] A[x] = 0'
        compare([formula, never], 6, [(times, columns), ([times[-1] + 1], {})])


@pytest.mark.parametrize(
    'column',
    [
        [1 << 53, (1 << 53) + 1, (1 << 53) + 2],
        np.array([(1 << 53) + 1, 1 << 62, -(1 << 63)]),
        np.array([(1 << 63) + 1, (1 << 64) - 1, 5], np.uint64),
        np.array([1 << 70, -(1 << 70), 2], object),
        [1, 2.5, np.float64(3)],
        [np.int8(1), 2, 3],
        np.array([1.5, 2, 3], np.longdouble),
        np.array([1, 2j, 3]),
        np.array([1, 2, 3], 'datetime64[ns]'),
        np.ma.masked_array([1, 2, 3], [False, True, False]),
        np.ma.masked_array([1.5, 2, 3], [False, False, False]),
        np.array([3, 1, 2], np.uint8).view(bool),
        np.array([(1, 2)] * 3, 'i4,i4'),
        [[1, 2], [3, 4], [5, 6]],
        ['a', 'b', 'c'],
        np.array([b'a', b'b', b'c']),
        [True, 1, 1.0],
    ],
    ids=repr,
)
@pytest.mark.parametrize('objects', [1, 30])
def test_values_of_any_type(column: Any, objects: int) -> None:
    found = [
        'forall x in Thing: always A[x] < 9007199254740993',
        'forall x in Thing: always A[x] != 9223372036854775808',
        'forall x in Thing: always A[x] + 1 > 2',
        'forall x in Thing: always A[x]',
        'forall x in Thing: always (A[x] and B[x] or eventually[0 ns, 1 ns] B[x])',
        'forall x in Thing: always A[x] = C[x]',
        'forall x in Thing: always A[x] = "a"',
        'forall x in Thing: always A[x] != o1',
    ]
    columns = {}
    for number in range(objects):
        columns[f'A[o{number}]'] = column
        columns[f'B[o{number}]'] = [True] * 3
        columns[f'C[o{number}]'] = column if number % 2 else [1, 2, 3]
    for text in found:
        compare([text], objects, [([1, 2, 3], columns)])


def test_no_states() -> None:
    group, _ = begun('always p')
    assert group.progress_many([], {}) == []
    assert group.progress_many(np.array([], np.int64), {'p': np.array([])}) == []
    assert group.progress_many(np.array([]), {'p': []}) == []


def test_noise_that_changes_nothing_is_skipped_while_a_clock_runs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    steps = 0
    step = SingleInstance.step

    def counted(single: SingleInstance, symbol: int, now: int, elapsed: int) -> Any:
        nonlocal steps
        steps += 1
        return step(single, symbol, now, elapsed)

    monkeypatch.setattr(SingleInstance, 'step', counted)
    group, _ = begun('always[0 s, 1 s] (p -> eventually[0 ns, 9 ns] q)')
    noise = np.random.default_rng(1).random(2000) < 0.5
    assert not group.progress_many(range(2000), {'p': np.zeros(2000, bool), 'q': noise})
    assert steps < 10


def test_batches_form_again_after_values_that_fit_into_no_vectors() -> None:
    names = [f'o{number}' for number in range(40)]
    text = 'forall x in S: always (v[x] > 0 -> eventually[0 ns, 9 ns] v[x] < 5)'
    group, _ = begun(text, {'S': names})
    assert group._monitor is not None
    sizes = []
    for time, odd in enumerate([1.0, 1, 1.0, 1.0, 1, 1.0, 1.0, 1.0]):
        values = dict.fromkeys((f'v[{name}]' for name in names), 1.0)
        assert not group.progress(time, {**values, 'v[o3]': odd})
        sizes.append(len(group._monitor._pool.batches))
    assert sizes == [1, 0, 1, 1, 0, 0, 1, 1]
