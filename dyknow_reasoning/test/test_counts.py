"""Counting quantifiers: verdicts, gaps, what remains and why."""

from __future__ import annotations

from itertools import combinations
from types import ModuleType

import pytest
from hypothesis import given
from hypothesis import strategies as st
from reasoning_reference import begun, counted, formulas, intervals, started
from test_paths import OBJECTS, grounded
from test_progression import irregular, verdicts

from dyknow_common import Verdict
from dyknow_reasoning import FormulaGroup, FormulaLimits, FormulaResult, ReasoningError
from dyknow_reasoning.execution.automata import automaton, configurations
from dyknow_reasoning.language.formula import And, CountBound, CountOf, Formula, Interval, Not, Or
from dyknow_reasoning.language.terms import Truth

BOUNDS = st.sampled_from(CountBound)


def results(text: str, states: list[dict[str, bool]], objects: tuple[str, ...] = OBJECTS) -> str:
    group, number = begun(text, {'S': objects})
    found: list[FormulaResult] = group.decided_at_once()
    for index, state in enumerate(states):
        found += group.progress(index * 1_000_000_000, state)
    if not found:
        return group.residual(number)
    return f'{found[0].verdict.name}: {found[0].explanation or found[0].error}'


@pytest.mark.parametrize(
    ('text', 'holds', 'expected'),
    [
        ('at least 2 u in S: P[u]', 'ac', 'TRUE: P[a] is true at 0.000 s; P[c] is true at 0.000 s'),
        (
            'at least 3 u in S: P[u]',
            'ac',
            'FALSE: P[b] is false at 0.000 s; P[d] is false at 0.000 s',
        ),
        ('at most 1 u in S: P[u]', 'bc', 'FALSE: P[b] is true at 0.000 s; P[c] is true at 0.000 s'),
        (
            'exactly 1 u in S: P[u]',
            'bc',
            'FALSE: P[b] is true at 0.000 s; P[c] is true at 0.000 s',
        ),
        ('exactly 3 u in S: P[u]', 'abc', None),
        ('at least 0 u in S: P[u]', 'a', 'TRUE: it is true for the objects of S, whatever the'),
        ('at least 5 u in S: P[u]', 'a', 'FALSE: it is false for the objects of S, whatever'),
        ('at most 4 u in S: P[u]', 'a', 'TRUE: it is true for the objects of S, whatever the'),
        ('exactly 2 of (P[a], P[b], P[a])', 'a', None),
        ('at least 2 of (P[a], P[a], P[b])', 'a', 'TRUE: P[a] is true at 0.000 s'),
        ('forall u in S: at least 2 v in S: u = v or P[v]', 'ab', None),
    ],
)
def test_one_state(text: str, holds: str, expected: str | None) -> None:
    found = results(text, [{f'P[{each}]': each in holds for each in OBJECTS}])
    assert found.startswith(expected or 'TRUE')


def test_objects_are_counted_over_time() -> None:
    text = 'at least 3 u in S: eventually P[u]'
    states = [{f'P[{each}]': each == now for each in OBJECTS} for now in 'abbd']
    assert results(text, states[:1]) == (
        'at least 2 of (eventually P[b], eventually P[c], eventually P[d])'
    )
    assert results(text, states[:3]) == '(eventually P[c]) or (eventually P[d])'
    assert results(text, states) == (
        'TRUE: P[d] is true at 3.000 s (eventually awaited since 0.000 s)'
    )


def test_no_objects() -> None:
    assert results('at most 0 u in S: P[u]', [], ()).startswith('TRUE')
    assert results('at least 1 u in S: P[u]', [], ()).startswith('FALSE')


def gapped(text: str, first: str, second: str, third: str = '') -> str:
    """The result over states of P with a gap after the first, or what remains."""
    group, number = begun(text, {'S': 'abc'})
    found = group.progress(0, {f'P[{each}]': each in first for each in 'abc'})
    group.gap()
    for time, holds in ((10, second), (20, third)):
        found += group.progress(time, {f'P[{each}]': each in holds for each in 'abc'})
    if not found:
        return group.residual(number)
    return found[0].verdict.name if found[0].error is None else 'ERROR'


@pytest.mark.parametrize(
    ('text', 'states', 'expected'),
    [
        # Two can still be seen to arrive after the gap; the others may have arrived in it.
        ('at least 2 u in S: eventually P[u]', ('', 'ab'), 'TRUE'),
        ('at least 2 u in S: eventually P[u]', ('a', 'b'), 'TRUE'),
        ('at least 2 u in S: eventually[0, 15 ns] P[u]', ('', 'a', ''), 'ERROR'),
        ('at most 1 u in S: eventually P[u]', ('a', 'b'), 'FALSE'),
        ('at most 1 u in S: eventually[0, 15 ns] P[u]', ('', 'b', ''), 'ERROR'),
        ('at least 2 u in S: always P[u]', ('abc', 'a'), 'FALSE'),
        ('at least 2 u in S: always[0, 15 ns] P[u]', ('abc', 'abc', ''), 'ERROR'),
        ('exactly 1 u in S: eventually P[u]', ('', 'ab'), 'FALSE'),
    ],
)
def test_gaps(text: str, states: tuple[str, ...], expected: str) -> None:
    assert gapped(text, *states) == expected


def expansion(bound: CountBound, number: int, members: tuple[Formula, ...]) -> Formula:
    """A count as all subsets of its members, which is exponential."""
    if bound is CountBound.EXACTLY:
        return And(
            expansion(CountBound.AT_LEAST, number, members),
            expansion(CountBound.AT_MOST, number, members),
        )
    if bound is CountBound.AT_MOST:
        return Not(expansion(CountBound.AT_LEAST, number + 1, members))
    found: Formula = Truth(False)
    for chosen in combinations(members, number):
        together: Formula = Truth(True)
        for each in chosen:
            together = And(together, each)
        found = Or(found, together)
    return found


@given(BOUNDS, st.integers(0, 4), st.lists(formulas(2), min_size=1, max_size=4), irregular)
def test_a_count_is_its_expansion(
    bound: CountBound, number: int, members: list[Formula], trace: list[tuple[int, dict[str, bool]]]
) -> None:
    """Neither contradicts the other; both are decided once all members are."""
    one = verdicts(CountOf(bound, number, tuple(members)), trace)
    other = verdicts(expansion(bound, number, tuple(members)), trace)
    each = [verdicts(member, trace) for member in members]
    for index, (first, second) in enumerate(zip(one, other, strict=True)):
        assert None in {first, second} or first == second
        known = counted(bound, number, [member[index] for member in each])
        if known is not None:
            assert first == known


@given(BOUNDS, st.integers(0, 5), formulas(2), st.data())
def test_a_quantifier_is_a_count_of_its_instances(
    bound: CountBound, number: int, body: Formula, data: st.DataObject
) -> None:
    members = ', '.join(grounded(body, name) for name in OBJECTS)
    quantified = f'{bound} {number} x in S: ({grounded(body, "x")})'
    group = started(quantified, f'{bound} {number} of ({members})', domains={'S': OBJECTS})
    found = group.decided_at_once()
    for time in range(8):
        state: dict[str, float | bool] = {}
        for name in OBJECTS:
            state[f'N[{name}]'] = data.draw(st.sampled_from([0.5, 1.5]))
            state[f'Q[{name}]'] = data.draw(st.booleans())
        found += group.progress(time, state)
    first, second = (
        [(each.verdict, each.decided_at) for each in found if each.formula_id == number]
        for number in (1, 2)
    )
    assert first == second


def test_many_objects_take_little_time() -> None:
    objects = [f'o{index}' for index in range(500)]
    group, number = begun('always at least 250 u in S: eventually[0 s, 3 s] P[u]', {'S': objects})
    for time in range(20):
        state = {f'P[{name}]': (index + time) % 4 < 2 for index, name in enumerate(objects)}
        assert group.progress(time * 1_000_000_000, state) == []
    assert 'at least' in group.residual(number)


@pytest.mark.parametrize('limit', [automaton, configurations])
def test_steps_over_many_atoms_do_not_fill_the_memory(
    limit: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = '_MAX_NODES' if limit is automaton else '_MAX_ENTRIES'
    monkeypatch.setattr(limit, name, 100)
    objects = [f'o{index}' for index in range(16)]
    group, _ = begun('always at least 2 u in S: P[u]', {'S': objects})
    sizes = set()
    for time in range(1000):
        state = {
            f'P[{name}]': bool((time + 3 << 4 | 3) >> index & 1)
            for index, name in enumerate(objects)
        }
        assert group.progress(time, state) == []
        monitor = group._monitor
        assert monitor is not None
        (found,) = monitor.states()
        sizes.add(len(found.location.moves))
    assert max(sizes) < (110 if limit is automaton else 2000)
    assert max(sizes) > (90 if limit is automaton else 500)


def test_the_size_of_a_count() -> None:
    group = FormulaGroup(FormulaLimits(instance_part_limit=1000))
    group.add_formula('it', 'exactly 2 u in S: exactly 1 v in S: P[u] and P[v]')
    with pytest.raises(ReasoningError, match='has 4882 parts for each choice'):
        group.begin({'S': [f'o{index}' for index in range(20)]})


@given(intervals())
def test_what_remains_can_be_read_again(interval: Interval) -> None:
    text = f'at least 2 of (always{interval} p, eventually{interval} q, p until q)'
    group, number = begun(text)
    found = group.progress(0, {'p': True, 'q': False})
    if not found:
        again = FormulaGroup()
        assert str(again.formulas[again.add_formula('it', group.residual(number))].formula) == (
            group.residual(number)
        )
    assert all(result.verdict is not Verdict.UNDECIDED for result in found)
