"""Values that `let` keeps, against a naive reading: `let v = x in eventually[0 s, 3 s] x < v`."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reasoning_reference import (
    COMPARISONS,
    Trace,
    begun,
    holds,
    intervals,
    of_present_and_future,
    random_cases,
)
from test_gaps import Segments, check_sound, verdict
from test_past_terms import results
from test_standing_monitor import check

from dyknow_common import Alternatives, LanguageError, Verdict
from dyknow_reasoning import (
    FormulaGroup,
    ReasoningError,
    TrialFormula,
    UnknownFeatures,
    parse_formula,
)
from dyknow_reasoning.execution import kept_values
from dyknow_reasoning.execution.automata import automaton
from dyknow_reasoning.language.formula import (
    Always,
    And,
    Comparison,
    Eventually,
    Formula,
    Freeze,
    Implies,
    Once,
    Or,
    Previous,
    Until,
)
from dyknow_reasoning.language.terms import Arithmetic, Feature, Kept, Number, Term

SECOND = 1_000_000_000
BRAKE = 'always (Brake -> let v = Speed in eventually[0 s, 3 s] Speed < v - 1)'
X, Y, P = Feature('x'), Feature('y'), Feature('p')
OPERATORS = st.sampled_from(sorted(COMPARISONS))
STATE = st.fixed_dictionaries({'x': st.integers(0, 2), 'y': st.integers(0, 2), 'p': st.booleans()})


def leaves(known: tuple[Kept, ...], *, past: bool) -> st.SearchStrategy[Formula]:
    numbers: list[Term] = [Number(0), Number(1), X, *known, *known]
    right = st.sampled_from(numbers)
    left = st.sampled_from([X, Y, Arithmetic('-', X, known[-1] if known else Y)])
    found = [st.just(P), st.builds(Comparison, OPERATORS, left, right)]
    if past and not known:
        found += [st.just(Previous(P)), st.just(Once(P))]
    return st.one_of(found)


def formulas(
    depth: int, known: tuple[Kept, ...] = (), *, past: bool = True
) -> st.SearchStrategy[Formula]:
    """Formulas in which some values are kept, also within the reach of others."""
    leaf = leaves(known, past=past)
    if not depth:
        return leaf
    inner = formulas(depth - 1, known, past=past)
    others = of_present_and_future(inner)
    if past and not known:
        others.append(st.builds(Once, formulas(depth - 1, (), past=False).filter(keeps_nothing)))
    kept = freezes(depth, known, past=past)
    return st.one_of(leaf, *others, kept, kept, kept)


@st.composite
def freezes(draw: st.DrawFn, depth: int, known: tuple[Kept, ...], *, past: bool) -> Freeze:
    term = draw(st.sampled_from([X, Arithmetic('-', X, known[-1] if known else Y)]))
    value = Kept(f'v{len(known)}', term)
    inner = formulas(depth - 1, (*known, value), past=past)
    use = Comparison(draw(OPERATORS), draw(st.sampled_from([X, Y])), value)
    later = draw(st.sampled_from([Always, Eventually]))(use, draw(intervals()))
    used = draw(st.sampled_from([use, later, Until(use, P, draw(intervals()))]))
    body = draw(st.sampled_from([And, Or, Implies]))(used, draw(inner))
    return Freeze(value.name, term, body)


def keeps_nothing(formula: Formula) -> bool:
    return 'let' not in str(formula)


@st.composite
def traces(draw: st.DrawFn, most: int = 10) -> Trace:
    time, found = 0, []
    for values in draw(st.lists(STATE, min_size=1, max_size=most)):
        time += draw(st.integers(1, 3))
        found.append((time, values))
    return found


@settings(max_examples=random_cases(100))
@given(formulas(3), traces())
def test_verdicts_are_those_of_the_reference(formula: Formula, trace: Trace) -> None:
    text = str(formula)
    assert parse_formula(text) == formula
    one_by_one, at_once = (results(text, trace, at_once=each) for each in (False, True))
    assert one_by_one == at_once
    assert not any(result.error for result in one_by_one)
    found = [result.verdict is Verdict.TRUE for result in one_by_one]
    expected = holds(formula, trace, 0)
    assert expected is None or found == [expected]
    for result in one_by_one:  # No later than it must be, and by no more than what was seen.
        seen = [state for state in trace if state[0] <= (result.decided_at or 0)]
        assert not seen or holds(formula, seen, 0) in {None, found[0]}


@settings(max_examples=random_cases(50))
@given(formulas(2, past=False), traces(12), st.sets(st.integers(1, 11)))
def test_each_state_is_asked(formula: Formula, trace: Trace, gaps: set[int]) -> None:
    states: Any = [(*state, number in gaps) for number, state in enumerate(trace)]
    check(str(formula), {}, states)


@settings(max_examples=random_cases(50))
@given(formulas(2), traces(9))
def test_each_state_is_asked_with_a_past(formula: Formula, trace: Trace) -> None:
    check(str(formula), {}, [(time, values, False) for time, values in trace])


@st.composite
def cut(draw: st.DrawFn) -> tuple[Segments, list[Trace]]:
    """Segments of traces with a gap in the middle, and some traces that they may be of."""
    before = draw(traces(4))
    start = before[-1][0] + draw(st.integers(1, 5))
    after = [(start + time - 1, values) for time, values in draw(traces(5))]
    times = range(before[-1][0] + 1, after[0][0])
    fillings = []
    for _ in range(4):
        missing = sorted(draw(st.sets(st.sampled_from(times)))) if times else []
        fillings.append([*before, *((time, draw(STATE)) for time in missing), *after])
    return [before, after], fillings


@settings(max_examples=random_cases(50))
@given(formulas(2), cut())
def test_no_verdict_depends_on_what_is_missing(
    formula: Formula, found: tuple[Segments, list[Trace]]
) -> None:
    result = verdict(formula, found[0])
    for filled in found[1]:
        check_sound(result, formula, filled)


def run(text: str, states: list[dict[str, Any]], **asked: Any) -> tuple[FormulaGroup, list[str]]:
    """A group after states a second apart, and what it told of each verdict."""
    group, _ = begun(text, **asked)
    told = [
        str(each.error or f'{each.verdict.name}: {each.explanation}')
        for second, values in enumerate(states)
        for each in group.progress(second * SECOND, values)
    ]
    return group, told


def speeds(*values: float, brakes: int = 1) -> list[dict[str, Any]]:
    return [{'Brake': second == brakes, 'Speed': value} for second, value in enumerate(values)]


def test_what_remains_and_why_it_is_false() -> None:
    group, told = run(BRAKE, speeds(5.0, 6.0, 5.5))
    assert not told
    assert group.residual(1) == (
        '(always (Brake -> (let v = Speed in (eventually[0 s, 3 s] (Speed < (v - 1)))))) '
        'and (eventually[0 s, 2 s] (Speed < (6.0 - 1)))'
    )
    _, told = run(BRAKE, speeds(5.0, 6.0, 5.5, 5.4, 5.3, 5.2))
    (why,) = told
    assert why == (
        "FALSE: 'Speed < (6.0 - 1)' held at no state in [1.000 s, 4.000 s]; "
        'Speed = 5.3 at 4.000 s is not < 6.0 - 1 = 5.0'
    )
    assert not run(BRAKE, speeds(5.0, 6.0, 5.5, 4.9, 5.3, 5.2))[1]


def test_values_of_each_object_with_units() -> None:
    text = (
        'let Speed: m/s in forall u in UAV: let least = Speed[u] + 3.6 km/h in '
        'always Speed[u] < least + 3.6 km/h'
    )
    states = [{'Speed[a]': 1.0, 'Speed[b]': 2.0}, {'Speed[a]': 2.5, 'Speed[b]': 4.5}]
    _, told = run(text, states, domains={'UAV': ['a', 'b']})
    assert told == ['FALSE: for u = b: Speed[b] = 4.5 at 1.000 s is not < 3.0 + 3.6 km/h = 4.0']


def test_texts_and_booleans_are_kept_as_they_are() -> None:
    change = 'let m = Mode in eventually[0 s, 3 s] Mode != m'
    assert run(change, [{'Mode': 'a'}, {'Mode': 'b'}])[1] == [
        'TRUE: Mode = "b" at 1.000 s is not "a" (eventually awaited since 0.000 s)'
    ]
    assert 'both must be of one type' in run(change, [{'Mode': 'a'}, {'Mode': 3}])[1][0]
    assert run('let b = On in b = true', [{'On': True}])[1]


def test_what_cannot_be_kept() -> None:
    for text, message in (
        ('let v = x in p', "nothing uses 'v'; leave it out"),
        ('let v = p in v', 'compare it: v = true'),
        ('let v = 2 * 3 in x < v', 'or a term with a feature, whose value is kept'),
        ('let v = prev(x) in x < v', "'prev(x)' cannot stand in 'let v = ...'"),
        ('let v = x in once x < v', 'make it a feature of a stream, or move it before the let'),
        ('once let v = x in x < v', 'cannot hold that; move it out'),
        ('let r = u1 in A[u1] and v = r', "'u1' is an object"),
        (f'let v = {"x + " * 60} 1 in x < v', 'has more than 100 parts'),
    ):
        with pytest.raises(LanguageError, match='formula:1:') as caught:
            FormulaGroup().add_formula('it', text)
        assert message in str(caught.value)
    with pytest.raises(LanguageError, match=r"'let v = ...' keeps a value for states to come"):
        TrialFormula('always let v = x in x < v + 1', {})
    with pytest.raises(ReasoningError, match="no margin is defined for 'let v = x in"):
        begun('let v = x in eventually x < v', margin=True)


def test_unusable_values_and_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    each = 'always let v = x in eventually[0 s, 60 s] x < v'
    assert 'holds nan' in run(each, [{'x': float('nan')}])[1][0]
    for module in (automaton, kept_values):
        monkeypatch.setattr(module, 'MAX_SLOTS', 8)
    for every_state in (False, True):
        text = each if not every_state else each.removeprefix('always ')
        _, told = run(text, [{'x': second} for second in range(20)], every_state=every_state)
        (why,) = told
        assert why == (
            "at 7.000 s: 'let v = x in (eventually[0 s, 60 s] (x < v))' keeps values of too many "
            'states at once, with more than 8 comparisons; shorten its intervals, or write when '
            'to keep a value, p -> let ...'
        )


@pytest.mark.parametrize('every_state', [False, True])
def test_a_formula_of_many_atoms(every_state: bool) -> None:  # noqa: FBT001
    """It keeps no value, so it may have more slots; with one, it fails."""
    objects = {'S': [f'u{number}' for number in range(automaton.MAX_SLOTS + 9)]}
    states = [dict.fromkeys((f'p[{each}]' for each in objects['S']), True) | {'x': 1.0}]
    some = 'exists u in S: eventually[0 s, 1 s] p[u]'
    group, told = run(some, states, domains=objects, every_state=every_state)
    assert bool(told) is not every_state
    assert not every_state or group.standing.summary(1).holds == 1
    kept = f'({some}) and (let v = x in always x = v)'
    _, told = run(kept, states, domains=objects, every_state=every_state)
    assert 'keeps values of too many states at once' in told[0]


def test_a_gap_after_which_an_edge_is_unknown() -> None:
    """What looks back across the gap makes the verdict unknown, an error, never wrong."""
    text = 'always (p and not (previous p) -> let v = x in eventually[0 s, 3 s] x > v)'
    group, told = run(text, [{'p': second > 1, 'x': 1} for second in range(3)])
    assert not told
    group.gap()
    (result,) = group.progress(5 * SECOND, {'p': True, 'x': 2})
    assert 'depends on states that are missing between' in str(result.error)


@pytest.mark.parametrize('every_state', [False, True])
def test_open_values_are_errors(every_state: bool) -> None:  # noqa: FBT001
    """It is not progressed over all that they may be."""
    text = 'p -> let v = x in eventually[0 s, 3 s] x > v'
    for value in (None, float('nan')):
        unknown = UnknownFeatures(all_may_be=True)
        group, _ = begun(text, unknown=unknown, every_state=every_state)
        assert not group.progress(0, {'p': True, 'x': 1.0})
        (result,) = group.progress(1, {'p': True, 'x': value})
        assert "the field 'x' holds" in str(result.error)
        assert 'it may not be unknown while' not in str(result.error)
    group, _ = begun(text, every_state=every_state)
    assert not group.progress(0, {'p': True, 'x': 1.0})
    found = group.progress(1, {'p': True, 'x': Alternatives.of((1.0, 2.0), 'the clocks differ')})
    told = [str(each.error) for each in found] + list(group.standing.omitted.values())
    assert len(told) == 1
    assert 'the clocks differ' in told[0]
