"""A verdict is one for all that unknown values may be, and comes as early as that is so."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import accumulate, product
from math import inf
from typing import cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from margin_reference import ended, margin
from reasoning_reference import COMPARISONS, NAMES, Trace, begun, formulas, holds, with_history
from reasoning_reference import started as started_over

from dyknow_common import Alternatives, Value, Verdict, format_time
from dyknow_reasoning import FormulaGroup, FormulaLimits, UnknownFeatures, parse_formula
from dyknow_reasoning.language.formula import Comparison, Formula, Interval
from dyknow_reasoning.language.terms import Arithmetic, Feature, Number, StateCount, ValueBefore

ANY = UnknownFeatures(all_may_be=True)
State = Mapping[str, Value | None]
PartialTrace = list[tuple[int, State]]


def started(text: str, objects: Iterable[str] = (), unknown: UnknownFeatures = ANY) -> FormulaGroup:
    limits = FormulaLimits(possibility_limit=100_000)
    return started_over(text, domains={'S': tuple(objects)}, limits=limits, unknown=unknown)


def decided(group: FormulaGroup, states: Iterable[tuple[int, State]]) -> tuple[int, Verdict] | None:
    """The number of the deciding state, and the verdict."""
    for number, (time, values) in enumerate(states):
        for result in group.progress(time, values):
            assert result.error is None, result.error
            return number, result.verdict
    return None


def verdict(text: str, *states: State, **ranges: tuple[float, float]) -> Verdict | None:
    """The verdict over states a second apart."""
    group = started(text, ('a', 'b'), UnknownFeatures(ranges, all_may_be=True))
    found = decided(group, ((number * 10**9, each) for number, each in enumerate(states)))
    return found and found[1]


def between(low: float, high: float) -> Value:
    return Alternatives.between((low, high), 'the sender omits small changes')


@st.composite
def partial_traces(
    draw: st.DrawFn, values: Sequence[Value], names: Sequence[str], most: int
) -> PartialTrace:
    """Up to six states, a third of whose values are unknown, but not too many of them."""
    steps = draw(st.lists(st.integers(1, 4), min_size=2, max_size=6))
    trace: PartialTrace = []
    for time in accumulate(steps):
        state: dict[str, Value | None] = {}
        for name in names:
            is_unknown = most > 0 and draw(st.integers(0, 2)) == 0
            most -= is_unknown
            state[name] = None if is_unknown else draw(st.sampled_from(values))
        trace.append((time, state))
    return trace


def completions(trace: PartialTrace, values: Sequence[Value]) -> Iterable[Trace]:
    """The traces that a partial trace may be."""
    unknown = [
        (i, name) for i, (_, state) in enumerate(trace) for name in state if state[name] is None
    ]
    for chosen in product(values, repeat=len(unknown)):
        completed = [dict(state) for _, state in trace]
        for (i, name), value in zip(unknown, chosen, strict=True):
            completed[i][name] = value
        times = (time for time, _ in trace)
        yield [(t, cast('dict[str, Value]', s)) for t, s in zip(times, completed, strict=True)]


def check_completions(text: str, trace: PartialTrace) -> None:
    found = decided(started(text, 'ab'), trace)
    alone = [decided(started(text, 'ab'), each) for each in completions(trace, (False, True))]
    first = alone[0]
    expected = None
    if first and all(each and each[1] is first[1] for each in alone):
        expected = max(each[0] for each in alone if each), first[1]
    assert found == expected, (text, trace)


@given(formulas(), partial_traces((False, True), NAMES, 7))
def test_verdicts_are_those_of_all_completions(formula: Formula, trace: PartialTrace) -> None:
    check_completions(str(formula), trace)


@given(
    formulas(2).filter(lambda each: {'p', 'q'} <= {*re.findall(r'\w+', str(each))}),
    st.sampled_from(['', 'always[0, 4 ns] ', 'eventually[0, 4 ns] ']),
    partial_traces((False, True), ('p[a]', 'p[b]', 'q'), 5),
)
def test_verdicts_of_several_objects(formula: Formula, window: str, trace: PartialTrace) -> None:
    """They share `q`, and past operators over it."""
    body = re.sub(r'\bp\b', 'p[u]', str(formula))
    text = f'forall u in S: {window}({body})'
    check_completions(text, trace)
    group = started(text, 'ab')
    for number, (time, values) in enumerate(trace):
        for result in group.progress(time, values):
            if name := re.match('for u = ([ab])', result.explanation):
                alone = started(f'{window}({body.replace("[u]", f"[{name[1]}]")})')
                assert decided(alone, trace[: number + 1]), (text, trace, result.explanation)


@given(formulas(), partial_traces((False, True), NAMES, 7))
def test_a_verdict_that_is_no_longer_possible_is_named(
    formula: Formula, trace: PartialTrace
) -> None:
    """It is one that some completion excludes, as it has the other verdict already."""
    alone = [decided(started(str(formula)), each) for each in completions(trace, (False, True))]
    group = started(str(formula))
    for number, (time, values) in enumerate(trace):
        if group.progress(time, values):
            return
        found = {each[1] for each in alone if each and each[0] <= number}
        assert outlook(group) == OUTLOOKS[frozenset(found)], (str(formula), trace)


OUTLOOKS = {
    frozenset[Verdict](): '',
    frozenset({Verdict.FALSE}): 'it cannot become true',
    frozenset({Verdict.TRUE}): 'it cannot become false',
    frozenset({Verdict.FALSE, Verdict.TRUE}): 'no later state decides it',
}
"""What is said, by the verdicts that some completions have already."""


def outlook(group: FormulaGroup) -> str:
    """Which verdict is no longer possible, as an undecided formula says it."""
    text = group.residual(1)
    return next((each for each in OUTLOOKS.values() if each and each in text), '')


@pytest.mark.parametrize(
    ('text', 'states', 'expected'),
    [
        ('always C[u] > 1', [(None, 2)], 'it cannot become true'),
        ('eventually[0, 1 s] C[u] > 1', [(None, 0)], ''),
        ('eventually[0, 1 s] C[u] > 1', [(None, None)], 'it cannot become false'),
        ('eventually[0, 1 s] C[u] > 1', [(None, 0), (0, 2), (0, 0)], 'no later state decides it'),
    ],
)
def test_what_several_objects_make_possible(
    text: str, states: Sequence[tuple[Value | None, Value | None]], expected: str
) -> None:
    group = started(f'forall u in S: {text}', ('a', 'b'))
    for number, (a, b) in enumerate(states):
        assert not group.progress(number * 10**9, {'C[a]': a, 'C[b]': b})
    assert outlook(group) == expected


X, Y = Feature('x'), Feature('y')
ORDERS = tuple(COMPARISONS)
EXACT = st.one_of(
    st.builds(
        Comparison,
        st.sampled_from(ORDERS),
        st.sampled_from((X, Y)),
        numbers := st.sampled_from((Number(1), Number(2))),
    ),
    st.builds(Comparison, st.sampled_from(ORDERS), st.just(X), st.just(Y)),
    st.builds(Comparison, st.sampled_from(ORDERS), st.just(ValueBefore(X)), numbers),
    st.builds(
        lambda operator, body, end, number: Comparison(
            operator, StateCount(body, Interval(0, end)), number
        ),
        st.sampled_from(ORDERS),
        st.builds(Comparison, st.sampled_from(ORDERS), st.just(X), numbers),
        st.integers(1, 6),
        numbers,
    ),
)
SOUND = st.builds(
    Comparison,
    st.sampled_from(ORDERS),
    st.sampled_from((Arithmetic('-', X, Y), Arithmetic('-', X, ValueBefore(X)), ValueBefore(Y))),
    st.sampled_from((X, Number(1))),
)
GRID = tuple(number / 4 for number in range(13))
"""Numbers from 0 to 3, with as many between constants as there are unknown values."""
RANGES = UnknownFeatures({'x': (0.0, 3.0), 'y': (0.0, 3.0)})


def told(formula: Formula, traces: Sequence[Trace], length: int) -> Verdict | None:
    """The verdict that all completions have after some states."""
    found = {holds(formula, trace[:length], 0) for trace in traces}
    return {(True,): Verdict.TRUE, (False,): Verdict.FALSE}.get(tuple(found))


@given(formulas(2, EXACT), partial_traces((0, 1, 1.5, 2, 3), ('x', 'y'), 2))
def test_orders_of_numbers_are_exact(formula: Formula, trace: PartialTrace) -> None:
    found = decided(started(str(formula), (), RANGES), trace)
    traces = list(completions(trace, GRID))
    for length in range(1, len(trace) + 1):
        if expected := told(formula, traces, length):
            assert found, (str(formula), trace)
            assert found[0] < length, (str(formula), trace)
            assert found[1] is expected, (str(formula), trace)
            return
    told_apart = {holds(formula, each, 0) for each in traces}
    assert found is None or told_apart <= {found[1] is Verdict.TRUE, None}, (str(formula), trace)


@given(
    formulas(2, st.one_of(EXACT, SOUND)),
    partial_traces((0, 1, 1.5, 2, 3), ('x', 'y'), 2),
)
def test_calculations_are_sound(formula: Formula, trace: PartialTrace) -> None:
    found = decided(started(str(formula), (), RANGES), trace)
    if found:
        truths = {holds(formula, each, 0) for each in completions(trace, GRID)}
        assert truths <= {found[1] is Verdict.TRUE, None}, (str(formula), trace)


@pytest.mark.parametrize(
    ('text', 'states', 'expected'),
    [
        ('x > 1 or x < 1 or y > 0', [{'x': None, 'y': 1}], Verdict.TRUE),
        ('x < y and y < z -> x < z', [{'x': None, 'y': None, 'z': None}], Verdict.TRUE),
        ('x < y and y < z and z < 0', [dict.fromkeys('xyz')], None),
        ('y < z and x < y and z < 0', [dict.fromkeys('xyz')], None),
        ('x > y', [{'x': None, 'y': float('inf')}], Verdict.FALSE),
        ('always[0, 1 s] x < 2', [{'x': between(1, 3)}, {'x': between(3, 4)}], Verdict.FALSE),
        ('always[0, 1 s] x < 2', [{'x': 1}, {}], None),
        ('eventually[0, 1 s] x < 2', [{'x': float('nan')}, {'x': 1}], Verdict.TRUE),
        ('x - y > 1 or x - y <= 1', [{'x': None, 'y': 1}], Verdict.TRUE),
        ('always[0, 1 s] (prev(x) > 1 or prev(x) <= 1)', [{'x': None}, {'x': 0}], Verdict.FALSE),
        (
            'eventually[1 s, 1 s] (prev(x) > 1 or prev(x) <= 1)',
            [{'x': None}, {'x': 0}],
            Verdict.TRUE,
        ),
        ('eventually[1 s, 1 s] count(x > 1, 5 s) <= 2', [{'x': None}, {'x': None}], Verdict.TRUE),
        ('count(x + y > 1, 5 s) = 0', [{'x': None, 'y': 1}], None),
        ('eventually[1 s, 1 s] (x > prev(x) or x <= prev(x))', [{'x': None}, {'x': 0}], None),
        ('not (m starts with "ab" and m starts with "ac")', [{'m': None}], Verdict.TRUE),
        ('m contains "ab" -> m contains "a"', [{'m': None}], Verdict.TRUE),
        ('m = "abc" -> m contains "b" and m starts with "a"', [{'m': None}], Verdict.TRUE),
        ('m contains "b" -> m starts with "a"', [{'m': None}], None),
        ('m = n and m != "a" -> n != "a"', [{'m': None, 'n': None}], Verdict.TRUE),
        ('m starts with "ab" -> m = "ab"', [{'m': None}], None),
        ('m contains "ab" -> m starts with "ab"', [{'m': None}], None),
        ('m contains "a" and m contains "b" -> m contains "ab"', [{'m': None}], None),
        (
            'm = n or m = o or n = o or m = "a" or n = "a" or o = "a"',
            [dict.fromkeys('mno')],
            None,
        ),
        ('m contains n -> m = n', [{'m': None, 'n': 'ab'}], None),
        ('"ab" contains m', [{'m': None}], None),
        ('p = q or p = r or q = r', [{'p': None, 'q': None, 'r': True}], None),
        ('p or q or p = q', [{'p': None, 'q': None}], Verdict.TRUE),
        ('at least 1 of (x > 1, x <= 1, y > 5)', [{'x': None, 'y': 0}], Verdict.TRUE),
        ('forall u in S: C[u] > 1', [{'C[a]': None, 'C[b]': 0}], Verdict.FALSE),
        ('forall u in S: (u = a and x > 1) or (u = b and x < 1)', [{'x': None}], Verdict.FALSE),
        ('exists u in S: C[u] > 1', [{'C[a]': None, 'C[b]': 2}], Verdict.TRUE),
        ('max(C[u] for u in S) > 1', [{'C[a]': None, 'C[b]': 2}], Verdict.TRUE),
        ('max(C[u] for u in S) > 2', [{'C[a]': None, 'C[b]': 2}], None),
        ('count(C[u] > 1 for u in S) >= 1', [{'C[a]': None, 'C[b]': 2}], Verdict.TRUE),
        ('1 / x > 0', [{'x': None}], None),
        ('abs(x) + y * y >= 0', [{'x': None, 'y': 3}], Verdict.TRUE),
        ('x - x = 0', [{'x': None}], None),
    ],
)
def test_what_follows(text: str, states: list[State], expected: Verdict | None) -> None:
    assert verdict(text, *states) is expected


DECIDES = re.compile(r'(true|false) if ([^;]+?) at ([0-9.]+ s)(, false if not(?! ))?')


def check_deciding_truths(
    text: str, traces: Sequence[Trace], truths: Sequence[bool | None]
) -> None:
    """Check that what a text says to decide does, given the truth of the formula in each trace."""
    for verdict, literal, moment, is_both in DECIDES.findall(text):
        shown = zip(traces, truths, strict=True) if '…' not in literal else ()
        for trace, truth in shown:
            (at,) = (i for i, (time, _) in enumerate(trace) if format_time(time) == moment)
            is_so = holds(parse_formula(literal), trace, at)
            if is_so is True or (is_so is False and is_both):
                wanted = is_so if is_both else verdict == 'true'
                assert truth is wanted, (text, trace)


def check_each_state(
    formula: Formula, trace: PartialTrace, unknown: UnknownFeatures, values: Sequence[Value]
) -> None:
    traces, group = list(completions(trace, values)), started(str(formula), (), unknown)
    alone = [decided(started(str(formula)), each) for each in traces]
    for number, (time, state) in enumerate(trace):
        if group.progress(time, state):
            return
        truths = [
            found[1] is Verdict.TRUE if found and found[0] <= number else None for found in alone
        ]
        check_deciding_truths(group.residual(1), [each[: number + 1] for each in traces], truths)


@given(formulas(), partial_traces((False, True), NAMES, 6))
def test_what_is_said_to_decide_does(formula: Formula, trace: PartialTrace) -> None:
    check_each_state(formula, trace, ANY, (False, True))


@given(
    formulas(2, st.one_of(EXACT, SOUND)),
    partial_traces((0, 1, 1.5, 2, 3), ('x', 'y'), 2),
)
def test_comparisons_that_are_said_to_decide_do(formula: Formula, trace: PartialTrace) -> None:
    check_each_state(formula, trace, RANGES, GRID)


@pytest.mark.parametrize(
    ('text', 'states', 'expected'),
    [
        ('x > 1', [{'x': None}], 'true if x > 1 at 0.000 s, false if not'),
        ('not p', [{'p': None}], 'true if not p at 0.000 s, false if not'),
        ('x > y', [{'x': None, 'y': None}], 'true if x > y at 0.000 s, false if not'),
        ('x + y > 1', [{'x': None, 'y': 0}], 'true if (x + y) > 1 at 0.000 s, false if not'),
        ('always x > 1', [{'x': 2}, {'x': None}, {'x': None}], 'false if x <= 1 at 1.000 s'),
        ('eventually x > 1', [{'x': None}], 'true if x > 1 at 0.000 s'),
        ('p and q', [{'p': None, 'q': None}], 'false if not p at 0.000 s'),
        ('p and q or r', [{'p': None, 'q': None, 'r': None}], 'true if r at 0.000 s'),
        ('p = q', [{'p': None, 'q': None}], 'true if p = q at 0.000 s, false if not'),
        ('x > 1 and x < 2', [{'x': None}], 'false if x <= 1 at 0.000 s'),
        ('(p or q) and (p or r)', [{'p': None, 'q': None, 'r': None}], 'true if p at 0.000 s'),
        ('(p or q) and (r or s)', [dict.fromkeys('pqrs')], ''),
        ('forall u in S: always C[u] > 1', [{'C[a]': None, 'C[b]': None}], 'false if C[a] <= 1'),
        ('forall u in S: eventually C[u] > 1', [{'C[a]': None, 'C[b]': None}], ''),
        (
            'forall u in S: eventually C[u] > 1',
            [{'C[a]': None, 'C[b]': None}, {'C[a]': 2, 'C[b]': 0}],
            'true if C[b] > 1 at 0.000 s',
        ),
        ('always (p -> once q)', [{'p': None, 'q': None}, {'p': True, 'q': False}], 'false if'),
    ],
)
def test_a_truth_that_decides_alone_is_named(text: str, states: list[State], expected: str) -> None:
    group = started(text, ('a', 'b'))
    for second, each in enumerate(states):
        assert not group.progress(second * 10**9, each)
    found = group.residual(1)
    assert expected in found, found
    assert bool(DECIDES.search(found)) is bool(expected), found


@pytest.mark.parametrize(
    ('past', 'holds', 'fails', 'unknown'),
    [
        ('once[1 s, 1 s] x > 1', 1, 3, 1),
        ('once[1 s, 1 s] eventually[0, 1 s] x > 1', 2, 1, 2),
        ('prev(x) > 1', 1, 3, 1),
    ],
)
def test_what_is_unknown_before_a_start(past: str, holds: int, fails: int, unknown: int) -> None:
    """Objects share it."""
    texts, domains = (past, f'forall u in S: u = a <-> {past}'), {'S': ('a', 'b')}
    group = started_over(*texts, domains=domains, unknown=ANY, every_state=True)
    for second, x in enumerate((0, None, 0, 2, 0)):
        assert not group.progress(second * 10**9, {'x': x})
    alone, shared = (group.standing.summary(each) for each in (1, 2))
    assert (alone.holds, alone.fails, alone.unknown) == (holds, fails, unknown)
    assert (shared.holds, shared.fails, shared.unknown) == (0, 5, 0)


def test_values_outside_of_their_range_do_not_count() -> None:
    assert verdict('x < 2', {'x': None}, x=(0, 1)) is Verdict.TRUE
    assert verdict('x < 1', {'x': None}, x=(0, 1)) is None
    assert (
        verdict('forall u in S: C[u] >= 0', {'C[a]': None, 'C[b]': None}, C=(0, 1)) is Verdict.TRUE
    )


@pytest.mark.parametrize(
    ('text', 'expected'),
    [
        ('x + y >= 0', Verdict.TRUE),
        ('x + y < 2', None),
        ('x - y <= 1', Verdict.TRUE),
        ('2 - x > 0.5 * y', Verdict.TRUE),
        ('hypot(x, y) < 1.5', Verdict.TRUE),
        ('hypot(x, y) < 1.4', None),
        ('sqrt(x) > 1', Verdict.FALSE),
        ('sum(C[u] for u in S) = 3', Verdict.FALSE),
        ('min(x, y) > 1', Verdict.FALSE),
        ('cos(x) != 2', Verdict.TRUE),
    ],
)
def test_calculations_have_bounds(text: str, expected: Verdict | None) -> None:
    state = dict.fromkeys(('x', 'y', 'C[a]', 'C[b]'))
    assert verdict(text, state, x=(0, 1), y=(0, 1), C=(0, 1)) is expected


def test_bounds_of_sums_are_rounded_as_sums() -> None:
    """In Python 3.12 `sum` of ten times 0.1 is 1, while a formula adds them to less than 1."""
    objects = [f'o{number}' for number in range(10)]
    group = started('sum(C[u] for u in S) >= 1', objects, UnknownFeatures({'C': (0.1, 0.2)}))
    state = {**{f'C[{name}]': 0.1 for name in objects}, 'C[o3]': None}
    assert decided(group, [(0, state)]) is None


def test_an_undecided_formula_names_what_is_unknown() -> None:
    group = started('always x > 1')
    group.progress(0, {'x': 2})
    assert group.residual(1) == 'always (x > 1)'
    group.progress(10**9, {'x': None})
    group.progress(2 * 10**9, {'x': 2})
    want = (
        'undecided for want of x since 1.000 s; false if x <= 1 at 1.000 s; it cannot become true'
    )
    assert group.residual(1) == f'always (x > 1) (in one of 2 cases; {want})'
    assert group.presumably_false(1)


def test_a_verdict_names_what_made_no_difference() -> None:
    group = started('eventually x > 1')
    group.progress(0, {'x': None})
    (result,) = group.progress(10**9, {'x': 2})
    assert result.explanation == 'x = 2 at 1.000 s is > 1; so it is whatever x since 0.000 s was'


def test_a_verdict_names_the_known_value_that_decides_the_last_case() -> None:
    group = started('forall u in S: always C[u] > 0.2', 'ab')
    group.progress(0, {'C[a]': 0.9, 'C[b]': 0.9})
    group.progress(10**9, {'C[a]': 0.9, 'C[b]': None})
    (result,) = group.progress(2 * 10**9, {'C[a]': 0.9, 'C[b]': 0.1})
    why = 'C[b] = 0.1 at 2.000 s is not > 0.2; so it is whatever C[b] since 1.000 s was'
    assert result.explanation == f'for u = b: {why}'


@pytest.mark.parametrize(
    ('otherwise', 'expected'),
    [
        ('always C[u] > 1', 'for u = b: C[b] = 0 at 1.000 s is not > 1'),
        ('(P[u] and always C[u] > 1) or not P[u]', 'it is false whatever x since 0.000 s was'),
    ],
)
def test_an_object_is_named_if_it_alone_makes_it_false(otherwise: str, expected: str) -> None:
    """The second time, it is `b` if `x > 1`, and else `a`."""
    body = f'(x > 1 and (P[u] or always C[u] > 1)) or (x <= 1 and ({otherwise}))'
    group = started(f'forall u in S: {body}', 'ab')
    state = {'x': None, 'P[a]': True, 'P[b]': False, 'C[a]': 5, 'C[b]': 5}
    group.progress(0, state)
    (result,) = group.progress(10**9, {**state, 'C[a]': 0, 'C[b]': 0})
    assert result.explanation == expected


def test_what_was_unknown_and_makes_no_difference_is_not_named() -> None:
    group = started('always (x > 1 -> eventually[0, 1 s] p)')
    group.progress(0, {'x': None, 'p': False})
    group.progress(10**9, {'x': 0, 'p': True})
    assert group.residual(1) == 'always ((x > 1) -> (eventually[0 s, 1 s] p))'
    group.progress(2 * 10**9, {'x': 2, 'p': False})
    (result,) = group.progress(4 * 10**9, {'x': 0, 'p': False})
    assert 'held at no state' in result.explanation


def test_features_that_may_not_be_unknown_are_errors() -> None:
    unknown = UnknownFeatures({'x': (0.0, 9.0)})
    group = started_over('always x > 1', 'always y > 1', unknown=unknown)
    (result,) = group.progress(0, {'x': None, 'y': None})
    assert result.name == 'always y > 1'
    assert "'y' holds a value of type NoneType" in str(result.error)


def test_a_limit_of_cases() -> None:
    names, limits = [f'o{number}' for number in range(10)], FormulaLimits(possibility_limit=100)
    text = 'exists u in S: always C[u] > 1'
    group, _ = begun(text, {'S': names}, unknown=ANY, limits=limits)
    (result,) = group.progress(0, {f'C[{name}]': None for name in names})
    assert "more than 100 possibilities (the limit 'possibility_limit')" in str(result.error)


def test_objects_are_apart_unless_they_share_what_is_unknown() -> None:
    names = [f'o{number}' for number in range(50)]
    group = started('forall u in S: eventually[0, 2 s] C[u] > 1', names)
    for second in range(2):
        assert not group.progress(second * 10**9, {f'C[{name}]': None for name in names})
    (result,) = group.progress(2 * 10**9, {f'C[{name}]': 2 for name in names})
    assert result.verdict is Verdict.TRUE


@pytest.mark.parametrize(
    ('x', 'expected'), [(None, None), (3.0, Verdict.FALSE), (0.0, Verdict.TRUE)]
)
def test_objects_with_too_many_cases_stay_apart_while_they_remember_a_shared_value(
    x: float | None, expected: Verdict | None
) -> None:
    """Each has representatives of its own for `x`, relative to its own `C`."""
    body = (
        '(P[u] -> eventually[0 s, 15 s] Q[u]) and (prev(x) > 1 -> G[u]) and '
        '(x > C[u] -> H[u]) and (y > 0 -> H[u])'
    )
    text, limits = f'forall u in S: always[0 s, 20 s] ({body})', FormulaLimits(possibility_limit=30)
    group, _ = begun(text, {'S': ('a', 'b')}, unknown=ANY, limits=limits)
    known: dict[str, Value | None] = {'x': 0.0, 'y': 0.0, 'C[a]': 2.0, 'C[b]': 5.0}
    known |= {f'{name}[{u}]': name in 'GH' for name in 'PQGH' for u in 'ab'}
    states = [{'P[a]': None, 'P[b]': None}] * 5
    states += [{'Q[a]': True, 'Q[b]': True, 'x': x}, {'y': None, 'G[a]': False, 'G[b]': False}]
    trace = [(number * 10**9, known | each) for number, each in enumerate(states + [{}] * 20)]
    found = decided(group, trace)
    assert (found and found[1]) is expected


@pytest.mark.parametrize('constant', ['', ', 0 s', ', 2 s'])
def test_a_probability_of_later_states_beside_unknown_values(constant: str) -> None:
    """Several objects share it, and values that make no difference leave no trace."""
    probability = f'P(always[0 s, 30 s] normal(x, 1{constant}) > 0) >= 0.5'
    text = f'forall u in S: {probability} and always[0 s, 30 s] (w > 0 or Q[u])'
    group, _ = begun(text, {'S': ('a', 'b')}, unknown=ANY)
    known = {'x': 9.0, 'Q[a]': True, 'Q[b]': True}
    trace = [(second * 10**9, {**known, 'w': None}) for second in range(30)]
    assert decided(group, [*trace, (30 * 10**9, {**known, 'w': 1.0})]) == (30, Verdict.TRUE)


def test_recordings_give_the_same() -> None:
    nan = float('nan')
    columns = {'x': [2.0, 2.0, nan, 2.0, 0.0, 2.0], 'y': [1.0] * 6}
    for texts in (('always x > 1', 'always y > 0'), ('eventually x < 1', 'always x > 1')):
        alone, many = (started_over(*texts, unknown=ANY) for _ in range(2))
        one_by_one = [
            result
            for number, row in enumerate(zip(*columns.values(), strict=True))
            for result in alone.progress(number, dict(zip(columns, row, strict=True)))
        ]
        assert many.progress_many(range(6), columns) == one_by_one
        assert [many.residual(each) for each in (1, 2)] == [alone.residual(each) for each in (1, 2)]


@pytest.mark.parametrize(
    ('text', 'before', 'after'), [('always x > 1', None, 2), ('eventually x > 1', 0, None)]
)
def test_a_gap_beside_an_unknown_value_is_an_error(
    text: str, before: int | None, after: int | None
) -> None:
    group = started(text)
    group.progress(0, {'x': before})
    group.gap()
    (result,) = group.progress(9, {'x': after})
    assert 'depends on states that are missing' in str(result.error)


@pytest.mark.parametrize('value', [None, float('nan')])
def test_an_unknown_value_while_a_gap_has_an_effect(value: float | None) -> None:
    group = started('always (x > 1 or p)')
    group.progress(0, {'x': 2, 'p': False})
    group.gap()
    assert not group.progress(8, {'x': 2, 'p': False})
    (result,) = group.progress(9, {'x': value, 'p': False})
    reason = "'x' holds (nan|a value of type NoneType), not a number; it may not be unknown while"
    assert re.search(f'{reason} missing states', str(result.error))


def test_another_fault_beside_an_unknown_value_while_a_gap_has_an_effect() -> None:
    group = started('always (1 / y > 0 and (x > 1 or p))')
    group.progress(0, {'x': 2, 'y': 1, 'p': False})
    group.gap()
    assert not group.progress(8, {'x': 2, 'y': 1, 'p': False})
    (result,) = group.progress(9, {'x': None, 'y': 0, 'p': False})
    assert str(result.error) == "at 0.000 s: '1 / y' is 1 / 0: division by zero"


@pytest.mark.parametrize(
    'text',
    [
        'once[0, 2 ns] (x > 1)',
        'historically[1 ns, 3 ns] (x > 1)',
        'previous (x > 1)',
        'p since (x > 1)',
        'once[0, 2 ns] (p and previous (x > 1))',
        'count(x > 1, 3 ns) > 1',
        'prev(x) > 1',
    ],
)
def test_an_unknown_value_after_the_effect_of_a_gap(text: str) -> None:
    """It makes the same difference as without the gap."""
    found = []
    for has_gap in (True, False):
        group = with_history(text, unknown=ANY)
        if has_gap:
            group.progress(1, {'x': 2, 'p': True})
            group.gap()
        for time in range(5, 15):
            assert not group.progress(time, {'x': 0, 'p': time != 6})
        outcomes = []
        for time in range(15, 30):
            group.add_formula('f', text)
            x = None if time == 16 else 2 * (time % 5 == 0)
            results = group.progress(time, {'x': x, 'p': time != 18})
            outcomes.append([(each.verdict, str(each.error or '')) for each in results])
        found.append(outcomes)
    assert found[0] == found[1]
    assert 'may not be unknown' not in str(found)


COMPARED = st.one_of(EXACT, SOUND).filter(lambda atom: 'count' not in str(atom))


@given(formulas(2, COMPARED), partial_traces((0.0, 1.0, 1.5, 2.0, 3.0), ('x', 'y'), 2))
def test_margins_of_all_completions_are_within_bounds(
    formula: Formula, trace: PartialTrace
) -> None:
    group, _ = begun(str(formula), unknown=RANGES, margin=True)
    for states, (time, values) in enumerate(trace, 1):
        has_ended = bool(group.progress(time, values))
        found = group.margin(1)
        assert found
        for each in completions(trace[:states], GRID):
            steps = [(time, time, cast('Mapping[str, float]', state)) for time, state in each]
            lower, upper = margin(formula, ended(steps), 0)
            assert found.lower <= lower, (str(formula), trace, each)
            assert upper <= found.upper, (str(formula), trace, each)
        if has_ended:
            return


@pytest.mark.parametrize(
    ('text', 'lower', 'upper'),
    [
        ('x > 1', -1, 2),
        ('not x > 1', -2, 1),
        ('x = 1', -2, 0),
        ('x != 4', 1, 4),
        ('x - y < 4', 3, 6),
        ('always[0, 1 s] x > 1', -1, 1),
        ('eventually[0, 1 s] x > 1', 1, 2),
        ('z > 1', -inf, inf),
        ('forall u in S: y + x > 1', 1, 4),
    ],
)
def test_margins_have_bounds(text: str, lower: float, upper: float) -> None:
    unknown = UnknownFeatures({**RANGES.ranges, 'z': (-inf, inf)})
    group, _ = begun(text, {'S': ('a', 'b')}, unknown=unknown, margin=True)
    for second, x in enumerate((None, 2.0, 2.0)):
        group.progress(second * 10**9, {'x': x, 'y': 2.0, 'z': None})
    found = group.margin(1)
    assert found
    assert (found.lower, found.upper) == (lower, upper)
