"""Formula groups: the library interface."""

from __future__ import annotations

import gc
import re
import tracemalloc
from functools import partial

import numpy as np
import pytest
from reasoning_reference import begun, progressed
from reasoning_reference import started as started_over

from dyknow_common import ExitCode, LanguageError, Symbol, SymbolKind, Value, Verdict
from dyknow_reasoning import FormulaGroup, FormulaLimits, FormulaResult, ReasoningError
from dyknow_reasoning.execution import InstanceMonitor

MS = 1_000_000
FLEET = {'UAV': ['uav1', 'uav2']}
started = partial(started_over, domains=FLEET)

POWER = (
    'forall u in UAV: always (Power[u] > 150 -> '
    'Power[u] < 200 until[0 s, 5 s] always[0 s, 3 s] Power[u] <= 150)'
)
DISTANCE = 'forall x in UAV: x != uav1 -> always XYDist[x, uav1] > 10'
CROWDED = 'always (p -> eventually[1 s, 3 s] p)'
RESPONSE = 'always not p -> eventually[0,1000] always[0,999] p'


def run(text: str, states: list[tuple[int, dict[str, Value]]]) -> list[FormulaResult]:
    return progressed(started(text), states)


def fleet_power(first: float, second: float) -> dict[str, Value]:
    return {'Power[uav1]': first, 'Power[uav2]': second}


def test_power_formula_of_the_paper_allows_a_short_rise() -> None:
    powers = [140.0] * 5 + [190.0] * 40 + [140.0] * 60 + [160.0] + [150.0] * 60
    states = [(index * 100 * MS, fleet_power(140.0, power)) for index, power in enumerate(powers)]
    assert run(POWER, states) == []


def test_distance_formula_of_the_paper() -> None:
    states = [(index * MS, {'XYDist[uav2, uav1]': 12.0 - index}) for index in range(5)]
    [result] = run(DISTANCE, states)
    assert (result.verdict, result.decided_at) == (Verdict.FALSE, 2 * MS)


def test_response_formula_of_the_paper() -> None:
    good = [(index * 100 * MS, {'p': index % 20 > 8}) for index in range(100)]
    assert run(RESPONSE, good) == []
    bad = [(index * 100 * MS, {'p': index % 20 > 11}) for index in range(100)]
    [result] = run(RESPONSE, bad)
    assert (result.verdict, result.decided_at) == (Verdict.FALSE, 1000 * MS)


def test_symbols_before_and_after_the_domains_are_known() -> None:
    group = FormulaGroup()
    group.add_formula('distance', DISTANCE)
    group.add_formula('mixed', 'uav1_power.power > 3 and not "/uav1/battery".low and p')
    feature = SymbolKind.FEATURE
    assert group.symbols() == [
        Symbol(SymbolKind.SORT, 'UAV'),
        Symbol(SymbolKind.OBJECT, 'uav1'),
        Symbol(feature, 'XYDist', ('UAV', 'uav1')),
        Symbol(feature, 'uav1_power.power'),
        Symbol(feature, '"/uav1/battery".low'),
        Symbol(feature, 'p'),
    ]
    group.begin(FLEET)
    symbols = group.symbols()
    assert symbols[0] == Symbol(feature, 'XYDist', ('uav2', 'uav1'))
    assert {str(symbol) for symbol in symbols} == {
        'XYDist[uav2, uav1]',
        'uav1_power.power',
        '"/uav1/battery".low',
        'p',
    }


def test_symbols_tell_syntactic_references() -> None:
    assert not Symbol(SymbolKind.FEATURE, 'Power', ('uav1',)).is_reference
    assert Symbol(SymbolKind.FEATURE, '"/uav1/battery".cell.low').is_reference


def test_ground_features_that_simplify_away_are_not_needed() -> None:
    group = started('forall x in UAV: forall y in UAV: x != y -> always D[x, y] > 1', 'p or true')
    assert [str(symbol) for symbol in group.symbols()] == ['D[uav1, uav2]', 'D[uav2, uav1]']


@pytest.mark.parametrize(
    ('text', 'verdict'),
    [
        ('true', Verdict.TRUE),
        ('false', Verdict.FALSE),
        ('exists x in None: p', Verdict.FALSE),
        ('forall x in None: always P[x]', Verdict.TRUE),
        ('p or not p', Verdict.TRUE),
        ('1 < 2', Verdict.TRUE),
        ('2 * 3 > 7 - 1', Verdict.FALSE),
        ('always "a" != "b"', Verdict.TRUE),
    ],
)
def test_formulas_that_need_no_state(text: str, verdict: Verdict) -> None:
    asked, not_asked = (started(text, domains={'None': []}) for _ in range(2))
    [result] = asked.decided_at_once()
    assert (result.verdict, result.decided_at) == (verdict, None)
    assert 'whatever the states are' in result.explanation
    assert asked.progress(5, {}) == []
    [result] = not_asked.progress(5, {})
    assert (result.verdict, result.decided_at) == (verdict, None)
    assert not_asked.residual(1) == ('true' if verdict is Verdict.TRUE else 'false')


def test_constants_without_a_value_are_an_error_before_the_first_state() -> None:
    """No state may ever come, as there is no feature."""
    for text, error in (('1 / 0 < 2', 'division by zero'), ('p or not sqrt(-1) < 2', 'sqrt(-1)')):
        with pytest.raises(ReasoningError, match=re.escape(error)):
            started(text)


@pytest.mark.parametrize(
    ('text', 'explanation'),
    [
        ('1 < 2', 'it is true, whatever the states are'),
        ('forall x in UAV: x = x', 'it is true for the objects of UAV, whatever the states are'),
        (
            'exists x in None: forall y in UAV: x = y',
            'it is false for the objects of None and UAV, whatever the states are',
        ),
    ],
)
def test_why_a_formula_needs_no_state(text: str, explanation: str) -> None:
    group, _ = begun(text, {'None': [], 'UAV': ['uav1']})
    [result] = group.decided_at_once()
    assert result.explanation == explanation


@pytest.mark.parametrize('opposites', ['a < 3 or a >= 3', 'a <= 3 or a > 3', 'a = 3 or a != 3'])
def test_opposite_comparisons_share_an_atom(opposites: str) -> None:
    group = started(f'always ({opposites})')
    assert [result.verdict for result in group.decided_at_once()] == [Verdict.TRUE]


def test_forall_over_nothing_is_true_and_each_formula_is_reported_once() -> None:
    nothing = 'forall x in None: always P[x]'
    group = started(nothing, 'p', 'always p', domains={'None': []})
    first = group.progress(0, {'p': True})
    assert [result.name for result in first] == [nothing, 'p']
    assert [result.name for result in group.progress(1, {'p': False})] == ['always p']
    assert group.progress(2, {}) == []


@pytest.mark.parametrize(
    ('text', 'values', 'message'),
    [
        ('always p', {}, "the state has no field 'p'; the state stream must hold it"),
        ('always Power[uav1] > 3', {'Power[uav1]': 'x'}, 'the string "x", not a number'),
        (
            'always Power[uav1] > 3',
            {'Power[uav1]': np.float32(4)},
            'a value of type numpy.float32, not a number of Python; write value.item()',
        ),
        ('always Power[uav1] > 3', {'Power[uav1]': True}, 'the boolean true, not a number'),
        ('always A > 3', {'A': float('nan')}, "the field 'A' holds nan, not a number; if "),
        (
            'always "/rng".range > 3',
            {'"/rng".range': float('nan')},
            "nan, not a number; if that is an unknown value, use a feature from it with 'missing: ",
        ),
        ('always p', {'p': 1}, "the field 'p' holds the number 1, not a boolean"),
        ('always Mode = "on"', {'Mode': False}, 'the boolean false, not a string'),
        ('always A = B', {'A': 1, 'B': 'x'}, '\'A = B\' compares the number 1 with the string "x"'),
        ('always A = B', {'A': float('nan'), 'B': 1}, "'A' holds nan, not a number; "),
        ('always 1 / A > 3', {'A': 0}, "'1 / A' is 1 / 0: division by zero"),
        ('always P(within(A, 1) > 3) >= 0.9', {'A': 3.5}, 'not known to be on one side of 0.9'),
        ('always A - A > 3', {'A': float('inf')}, "'A - A' is inf - inf: not a number"),
        ('always uav1.p', {'uav1.q': True}, "no field 'uav1.p'"),
        ('always p', {'p': None}, 'a value of type NoneType, not a boolean'),
    ],
)
def test_a_bad_state_fails_the_formulas_that_need_it(
    text: str, values: dict[str, Value], message: str
) -> None:
    group = started(text, 'always good')
    [result] = group.progress(12_300 * MS, {'good': True, **values})
    assert result.name == text
    assert (result.verdict, result.decided_at) == (Verdict.UNDECIDED, None)
    assert result.error is not None
    assert result.error.message.startswith('at 12.300 s: ')
    assert message in result.error.message
    # Another state may have usable values; a value of another type shows a wrong formula.
    may_pass = any(each in message for each in ('nan', '/', 'inf', 'one side'))
    assert result.error.code.name == ('CONSTRAINT_VIOLATION' if may_pass else 'INVALID_ARGUMENT')
    [other] = group.progress(13_000 * MS, {'good': False})
    assert (other.name, other.verdict) == ('always good', Verdict.FALSE)


def test_integers_are_numbers_as_floats_are() -> None:
    assert run('always A = 3', [(0, {'A': 3}), (1, {'A': 3.0}), (2, {'A': np.float64(3)})]) == []


def test_a_formula_needs_only_what_remains_of_it() -> None:
    group = started('(eventually p) and always q')
    assert group.progress(0, {'p': True, 'q': True}) == []
    assert group.progress(1, {'q': True}) == []


@pytest.mark.parametrize('second', [5, 4])
def test_valid_times_must_increase(second: int) -> None:
    group = started('always p', 'eventually p')
    group.progress(5, {'p': True})
    [result] = group.progress(second, {'p': False})
    assert result.verdict is Verdict.UNDECIDED
    assert result.error is not None
    assert result.error.code is ExitCode.CONSTRAINT_VIOLATION
    assert 'is not later than 0.000000005 s' in result.error.message
    assert group.progress(9, {'p': False}) == []


def test_failing_all() -> None:
    group = started('always p', 'eventually p')
    results = group.fail(ReasoningError('the field p cannot be read'), 3 * MS)
    assert [str(result.error) for result in results] == [
        'at 0.003 s: the field p cannot be read'
    ] * 2
    assert group.progress(9, {'p': False}) == []


def test_misuse() -> None:
    group = FormulaGroup()
    with pytest.raises(ReasoningError, match='has not begun'):
        group.progress(0, {})
    with pytest.raises(ReasoningError, match='has not begun'):
        group.decided_at_once()
    with pytest.raises(ReasoningError, match='has not begun'):
        group.gap()
    group.add_formula('power', POWER)
    with pytest.raises(LanguageError, match='is a number, not a formula'):
        group.add_formula('bad', 'Power[u] and 3')
    with pytest.raises(ReasoningError, match=r"the sort 'UAV' has no domain \(there are: UGV\)"):
        group.begin({'UGV': ['ugv1']})
    group.begin(FLEET)
    with pytest.raises(ReasoningError, match='has begun already'):
        group.begin(FLEET)
    with pytest.raises(ReasoningError, match="the sort 'UGV' has no domain"):
        group.add_formula('late', 'forall x in UGV: always P[x]')
    with pytest.raises(ReasoningError, match='no formula 2'):
        group.remove_formula(2)
    with pytest.raises(ReasoningError, match='no formula 7'):
        group.residual(7)
    assert list(group.formulas) == [1]


def test_residuals() -> None:
    group = started('always (p -> eventually[0, 2 s] q)', 'p until[0, 1 s] q', 'not (p until q)')
    assert [str(formula) for formula in group.formulas.values()] == [
        'always (p -> (eventually[0 s, 2 s] q))',
        'p until[0 s, 1 s] q',
        'not (p until q)',
    ]
    assert group.residual(2) == 'p until[0 s, 1 s] q'
    group.progress(0, {'p': True, 'q': False})
    group.progress(400 * MS, {'p': True, 'q': False})
    assert group.residual(1) == (
        '(always (p -> (eventually[0 s, 2 s] q))) and (eventually[0 s, 1600 ms] q)'
    )
    assert group.residual(2) == 'p until[0 s, 600 ms] q'
    assert group.residual(3) == 'not (p until q)'
    group.progress(500 * MS, {'p': True, 'q': True})
    assert [group.residual(each) for each in (2, 3)] == ['true', 'false']


def test_many_states_at_once() -> None:
    times = np.arange(100) * 100 * MS
    first, second = np.full(100, 140.0), np.full(100, 160.0)
    columns = {'Power[uav1]': first, 'Power[uav2]': second}
    expected = run(POWER, [(time, fleet_power(140.0, 160.0)) for time in times.tolist()])
    assert started(POWER).progress_many(times, columns) == expected
    assert len(expected) == 1
    flags = started('eventually p').progress_many([1, 2], {'p': np.array([False, True])})
    assert [result.decided_at for result in flags] == [2]
    with pytest.raises(ReasoningError, match="'p' has 3 values for 2 states"):
        started('p').progress_many([1, 2], {'p': [True, True, True]})


EXPLOSIVE = 'always (p -> eventually[0, 50 s] (q and always[0, 20 s] (r or eventually[0, 7 s] s)))'


def test_node_limit() -> None:
    group = started(EXPLOSIVE, 'always p', limits=FormulaLimits(node_limit=200))
    results = progressed(
        group,
        [
            (i * 100 * MS, {'p': True, 'q': i % 3 == 0, 'r': i % 5 == 0, 's': i % 7 == 0})
            for i in range(100)
        ],
    )
    assert [result.name for result in results] == [EXPLOSIVE]
    assert "more than 200 (the limit 'node_limit'): 7 windows of eventually[0 s, 50 s]" in str(
        results[0].error
    )


def test_exists_and_nested_quantifiers() -> None:
    text = 'forall x in UAV: exists y in UAV: x != y and D[x, y] < 5'
    [result] = run(text, [(0, {'D[uav1, uav2]': 3, 'D[uav2, uav1]': 7})])
    assert result.verdict is Verdict.FALSE
    [result] = run(text, [(0, {'D[uav1, uav2]': 3, 'D[uav2, uav1]': 4})])
    assert result.verdict is Verdict.TRUE


def test_always_forall_is_forall_always() -> None:
    group = started('always[0, 1 s] forall u in UAV: P[u]', 'forall u in UAV: always[0, 1 s] P[u]')
    for index in range(3):
        group.progress(index, {'P[uav1]': True, 'P[uav2]': True})
    assert group.residual(1) == group.residual(2)


@pytest.mark.parametrize('jitter', [0, 10 * MS])
def test_memory_stays_flat(jitter: int) -> None:
    group = started(RESPONSE, 'always (p -> eventually[0, 2 s] not p)', CROWDED)
    generator = np.random.default_rng(7)
    time = 0

    def run_for(states: int) -> int:
        nonlocal time
        for index in range(states):
            time += int(generator.integers(100 * MS - jitter, 100 * MS + jitter + 1))
            assert group.progress(time, {'p': index % 20 > 7}) == []
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        before = run_for(4_000)
        assert run_for(4_000) < 1.3 * before + 1_000_000
    finally:
        tracemalloc.stop()


def test_an_object_is_compared_with_a_field() -> None:
    group, _ = begun('forall x in UAV: always x != leader.name', {'UAV': ['uav1', 'uav2']})
    assert not group.progress(0, {'leader.name': 'uav3'})
    (result,) = group.progress(1, {'leader.name': 'uav2'})
    assert result.verdict is Verdict.FALSE


def faulty(*_: object) -> None:
    raise ZeroDivisionError('by zero')


@pytest.mark.parametrize('states', [2, 3])
@pytest.mark.parametrize('many', [False, True])
def test_after_a_fault_no_formula_goes_on(
    monkeypatch: pytest.MonkeyPatch, states: int, *, many: bool
) -> None:
    """A fault in DyKnow, at a state that other formulas see too: none of them stays silent."""
    group = FormulaGroup()
    group.add_formula('low', 'always x < 5')
    group.add_formula('each', 'eventually[0 s, 1 s] x > 2', every_state=True)
    group.begin({})
    for time in range(1, states):
        assert group.progress(time, {'x': 1.0}) == []
    monkeypatch.setattr(InstanceMonitor, 'progress', faulty)
    monkeypatch.setattr(InstanceMonitor, 'progress_many', faulty)
    results = group.progress_many([9], {'x': [1.0]}) if many else group.progress(9, {'x': 1.0})
    assert [(each.name, each.verdict) for each in results] == [
        ('low', Verdict.UNDECIDED),
        ('each', Verdict.UNDECIDED),
    ]
    for each in results:
        assert each.error is not None
        assert each.error.code is ExitCode.INTERNAL_ERROR
        assert 'internal error: ZeroDivisionError: by zero (' in str(each.error)
    assert not group.undecided


def test_a_fault_in_its_reasons_loses_no_verdict(monkeypatch: pytest.MonkeyPatch) -> None:
    group = started('always x < 5')
    monkeypatch.setattr('dyknow_reasoning.formula_group.explain', faulty)
    [result] = group.progress(1, {'x': 7.0})
    assert result.verdict is Verdict.FALSE
    assert 'its reasons are not known: internal error: ZeroDivisionError' in result.explanation
