"""Operators of the past, and those that are written with others, by hand and at random."""

from __future__ import annotations

import math
from itertools import accumulate
from random import Random
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st
from reasoning_reference import (
    NAMES,
    Trace,
    begun,
    conjunction,
    disjunction,
    formulas,
    holds,
    negation,
    past_operator,
    progressed,
    progressed_many,
    random_cases,
    started,
    with_history,
)

from dyknow_common import Verdict
from dyknow_reasoning import FormulaGroup, FormulaLimits, FormulaResult, parse_formula
from dyknow_reasoning.execution.past import register_groups
from dyknow_reasoning.language.formula import (
    Always,
    And,
    Formula,
    Historically,
    Implies,
    Interval,
    Not,
    Once,
    Or,
    PastFormula,
    Previous,
    Since,
)
from dyknow_reasoning.language.terms import Feature, Truth
from dyknow_reasoning.progression.past_operators import ALL_ROWS, SinceMemory

CASES = random_cases(80)


def truths(text: str, trace: Trace) -> str:
    """The truth of a formula of the past at each state, one by one and at once."""
    one_by_one = ''
    group = with_history(text)
    for time, values in trace:
        number = group.add_formula(text, text)
        results = group.progress(time, values) or group.decided_at_once()
        group.remove_formula(number)
        assert [result.error for result in results] == [None]
        one_by_one += '1' if results[0].verdict is Verdict.TRUE else '0'
    group = started(*(f'eventually[{n} ns, {n} ns] ({text})' for n, _ in timed(trace)))
    results = progressed_many(group, trace)
    found = {result.name: result.verdict is Verdict.TRUE for result in results}
    at_once = ''.join(str(int(value)) for value in found.values())
    assert sorted(at_once) == sorted(one_by_one)
    return one_by_one


def timed(trace: Trace) -> Trace:
    return [(time - trace[0][0], values) for time, values in trace]


def trace_of(times: str, **columns: str) -> Trace:
    """States at some times, in which a feature holds where its column has a 1."""
    rows = zip(*columns.values(), strict=True)
    return [
        (int(time), {name: bit == '1' for name, bit in zip(columns, row, strict=True)})
        for time, row in zip(times.split(), rows, strict=True)
    ]


@pytest.mark.parametrize(
    ('text', 'times', 'p', 'q', 'expected'),
    [
        ('once p', '0 1 2 3', '0100', '0000', '0111'),
        ('historically p', '0 1 2 3', '1101', '0000', '1100'),
        ('previous p', '0 1 2 3', '1010', '0000', '0101'),
        ('not previous p', '0 1 2 3', '1010', '0000', '1010'),
        ('previous previous p', '0 1 2 3', '1010', '0000', '0010'),
        # Windows that end exactly at a state, and 1 ns before or after.
        ('once[0, 3 ns] p', '0 3 4', '100', '000', '110'),
        ('once[0, 3 ns) p', '0 2 3', '100', '000', '110'),
        ('once(3 ns, 5 ns] p', '0 3 4 5 6', '10000', '00000', '00110'),
        ('once[4 ns, inf) p', '0 3 4 9', '1000', '0000', '0011'),
        ('historically[2 ns, 3 ns] p', '0 1 2 3 5', '01111', '00000', '11001'),
        # `since` of the paper's kind: open at both ends, so p need not hold now or when q did.
        ('p since q', '0 1 2 3', '0000', '1000', '1100'),
        ('p since q', '0 1 2 3', '0110', '1000', '1111'),
        ('p since q', '0 1 2 3', '0100', '1000', '1110'),
        ('p since[2 ns, 3 ns] q', '0 1 2 3 4', '01111', '10000', '00110'),
        # As in MonPoly: p at every state after the one with q, and now.
        ('q or (p and (p since q))', '0 1 2 3', '0101', '1001', '1101'),
        ('q or (p and (p since q))', '0 1 2 3', '0110', '1000', '1110'),
        ('once[1 ns, 2 ns] (p and previous q)', '0 1 2 3 4', '01000', '10000', '00110'),
        ('(once (p and previous q)) or (once (p and once q))', '0 1 2 3', '0010', '1000', '0011'),
        ('historically (p -> once[0, 2 ns] q)', '0 1 3 4', '0110', '1000', '1100'),
    ],
)
def test_past_operators_by_hand(text: str, times: str, p: str, q: str, expected: str) -> None:
    assert truths(text, trace_of(times, p=p, q=q)) == expected


def random_past(random: Random, depth: int) -> Formula:
    if not depth or random.random() < 0.15:
        return Feature(random.choice(NAMES))
    start = random.choice([0, 0, 1, 2, 5])
    interval = Interval(start, random.choice([None, start, start + 1, start + 6]))
    body, other = random_past(random, depth - 1), random_past(random, depth - 1)
    return random.choice(
        [
            *(past_operator(each, (body, other), interval) for each in get_args(PastFormula)),
            Since(body, other, interval),
            Not(body),
            Or(body, other),
        ]
    )


def outcomes(results: list[FormulaResult]) -> list[tuple[str, Verdict, int | None, str]]:
    return [(each.name, each.verdict, each.decided_at, each.explanation) for each in results]


@pytest.mark.parametrize('least', [1, 1000])
def test_random_past_formulas_at_every_state(least: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """One by one, in blocks, and by the reference: the same truth, at the same states."""
    monkeypatch.setattr(register_groups, 'MIN_REGISTERS', least)
    random = Random(least)  # noqa: S311 - no secret
    for _ in range(CASES // 2):
        formula = random_past(random, 3)
        count = random.randint(2, 20)
        most = random.choice([1, 1, 3, 6])
        times = list(accumulate(random.randint(1, most) for _ in range(count)))
        bias = random.random()
        trace = [(time, {name: random.random() < bias for name in NAMES}) for time in times]
        expected = [holds(formula, trace, i) for i in range(count)]
        # q0 is true at the first state that falsifies `always (formula <-> t)`, or never.
        wrong = random.randrange(count)
        told = [value is not (i == wrong) for i, value in enumerate(expected)]
        rows = [{**values, 't': t} for (_, values), t in zip(trace, told, strict=True)]
        texts = (f'always (({formula}) <-> t)', f'eventually not (({formula}) <-> t)')
        one_by_one = started(*texts)
        states = list(zip(times, rows, strict=True))
        results = progressed(one_by_one, states)
        assert [(r.decided_at, r.error) for r in results] == [(times[wrong], None)] * 2, texts
        middle = random.randrange(count)
        group = started(*texts)
        blocks = [
            *progressed_many(group, states[:middle]),
            *progressed_many(group, states[middle:]),
        ]
        assert outcomes(blocks) == outcomes(results)


def test_the_past_begins_with_the_first_state_of_the_formula() -> None:
    group = started('always p')
    group.progress(0, {'p': True, 'q': True})
    group.add_formula('late', 'once q')
    group.add_formula('same', 'once q')
    assert group._monitor is not None
    assert len(group._monitor.histories.registers) == 1
    [late, same] = group.progress(1, {'p': True, 'q': False})
    assert (late.verdict, same.verdict) == (Verdict.FALSE, Verdict.FALSE)
    assert not group._monitor.histories.registers


def test_later_formulas_have_a_past_of_their_own() -> None:
    group = started('always (p -> once q)', 'eventually once q')
    group.progress(0, {'p': True, 'q': True})
    group.add_formula('late', 'once q')
    [late] = group.progress(1, {'p': True, 'q': False})
    assert late.verdict is Verdict.FALSE
    assert group._monitor is not None
    histories = group._monitor.histories
    assert len(histories.registers) == 1
    assert not group.progress(2, {'p': True, 'q': False})
    assert [unit.fields for unit in histories._units] == [list(histories.registers)]


def test_a_kept_history_is_that_of_later_formulas() -> None:
    text = 'once[0, 5 ns] q'
    group = FormulaGroup()
    group.begin({})
    assert not group.keeps_history
    group.keep_history('always p')
    assert not group.keeps_history
    group.keep_history(text)
    assert group.keeps_history
    group.progress(0, {'q': True})
    found = {}
    for time in (4, 5, 6):
        group.add_formula('it', text)
        [result] = group.progress(time, {'q': False})
        found[time] = result.verdict
    assert found == {4: Verdict.TRUE, 5: Verdict.TRUE, 6: Verdict.FALSE}


def test_unusable_values_matter_at_every_state() -> None:
    """Also where the operator is not reached: what it looks back to is not known then."""
    group = started('always (p -> once q)', 'always p', 'eventually not p')
    group.progress(0, {'p': False, 'q': False})
    [failed] = group.progress(1, {'p': True})[:1]
    assert str(failed.error) == (
        "at 0.000 s: the state has no field 'q'; the state stream must hold it"
    )


@pytest.mark.parametrize('at_once', [False, True])
def test_a_kept_history_recovers_from_unusable_values(at_once: bool) -> None:  # noqa: FBT001
    text = 'once[0, 2 ns] (x > 1)'
    group = with_history(text)
    found = []
    for time, value in enumerate([0.0, math.nan, 0.0, math.nan, 0.0, 0.0, 0.0, 2.0]):
        group.add_formula('it', text)
        if at_once:
            [result] = group.progress_many([time], {'x': [value]})
        else:
            [result] = group.progress(time, {'x': value})
        found.append('error' if result.error else result.verdict.name.lower())
    assert found == ['false', *['error'] * 5, 'false', 'true']


def test_previous_depends_on_unusable_values_of_the_state_before() -> None:
    text = 'previous (x > 1)'
    group = with_history(text)
    found = []
    for time, value in enumerate([2.0, math.nan, 2.0, 2.0]):
        group.add_formula('it', text)
        [result] = group.progress(time, {'x': value})
        found.append('error' if result.error else result.verdict.name.lower())
    assert found == ['false', 'error', 'error', 'true']


def test_memory_does_not_grow_with_states() -> None:
    texts = ('always once p', 'always not (q since[1 s, inf) q)', 'always not once[1 s, 2 s] q')
    group = started(*texts, 'always not historically[1 s, 3 s] q')
    for time in range(3000):
        group.progress(time * 1_000_000, {'p': True, 'q': time < 900})
    assert group._monitor is not None
    for register in group._monitor.histories.registers.values():
        assert len(getattr(register.memory, 'younger', ())) <= 3


@pytest.mark.parametrize(
    ('interval', 'most'), [(Interval(10, None), 1), (Interval(10, 12), 6), (Interval(10, 20), 3)]
)
def test_candidates_that_are_not_needed_are_dropped(interval: Interval, most: int) -> None:
    memory = SinceMemory(interval)
    for time in range(100):
        assert memory.step(time, ALL_ROWS, 1) == (time >= interval.start)
        assert len(memory.younger) <= most
        assert len(memory.ends) <= 1


def test_a_past_operator_over_a_future_one_keeps_what_its_window_needs() -> None:
    group = started('always (p -> once[0, 50 ns] eventually[0, 20 ns] q)')
    sizes = set()
    for time in range(0, 2000, 10):
        assert not group.progress(time, {'p': True, 'q': time % 60 == 0})
        if time > 200:
            assert group._monitor is not None
            sizes |= {state.node.size for state in group._monitor.states()}
    assert max(sizes) < 60


def test_what_a_past_operator_remembers_is_limited() -> None:
    text = 'always (p -> once[0, 1 s] eventually[0, 1 s] q)'
    group, _ = begun(text, limits=FormulaLimits(node_limit=50))
    results: list[FormulaResult] = []
    for time in range(100):
        results += group.progress(time * 1000, {'p': False, 'q': False})
    [failed] = results
    assert "more than 50 (the limit 'node_limit'): 11 windows of eventually[0 s, 1 s] q" in str(
        failed.error
    )


def test_a_past_operator_over_many_objects() -> None:
    names = [f'o{number}' for number in range(3000)]
    group, _ = begun('always once exists x in S: P[x]', {'S': names})
    state = {f'P[{name}]': False for name in names}
    for time in range(6):
        assert not group.progress(time, {**state, 'P[o2999]': True})
    assert not group.progress_many([9, 10], {name: [False, False] for name in state})
    assert group.residual(1).startswith('always (once (')


def test_formulas_of_constants_need_no_state() -> None:
    texts = ('once true', 'historically[0, 1 s] false', 'previous false', 'p since[1 s, 2 s] false')
    group = started(*texts, 'historically[1 s, 2 s] true', 'not once (p or not p)')
    found = [result.verdict is Verdict.TRUE for result in group.decided_at_once()]
    assert found == [True, False, False, False, True, False]
    [result] = started('once[1 s, 2 s] true').progress(0, {})
    assert result.verdict is Verdict.FALSE


def closed_until(left: Formula, right: Formula, interval: Interval, trace: Trace) -> bool | None:
    """F at all k from now to before the state with G."""
    begin = trace[0][0]
    end = float('inf') if interval.end is None else begin + interval.end
    cases = [
        conjunction([holds(right, trace, j), *(holds(left, trace, k) for k in range(j))])
        for j in range(len(trace))
        if begin + interval.start <= trace[j][0] <= end
    ]
    if trace[-1][0] < end:
        cases.append(conjunction([None, *(holds(left, trace, k) for k in range(len(trace)))]))
    return disjunction(cases)


def weak_until(left: Formula, right: Formula, interval: Interval, trace: Trace) -> bool | None:
    """The same, or F at all states to the end of the interval."""
    return disjunction(
        [
            closed_until(left, right, interval, trace),
            holds(Always(left, Interval(0, interval.end)), trace, 0),
        ]
    )


def released(left: Formula, right: Formula, interval: Interval, trace: Trace) -> bool | None:
    """G at all states of the interval but those after a state with F."""
    return negation(closed_until(Not(left), Not(right), interval, trace))


SUGAR = {'holds until': closed_until, 'unless': weak_until, 'release': released}


@pytest.mark.parametrize('word', SUGAR)
def test_operators_that_are_written_with_others(word: str) -> None:
    random = Random(word)  # noqa: S311 - no secret
    p, q = Feature('p'), Feature('q')
    for _ in range(CASES):
        start = random.choice([0, 0, 1, 3])
        interval = Interval(start, random.choice([None, start, start + 4]))
        states = random.randint(1, 8)
        times = list(accumulate(random.randint(1, random.choice([1, 3])) for _ in range(states)))
        trace = [(t, {name: random.random() < 0.6 for name in NAMES}) for t in times]
        group = started(f'p {word}{interval.suffix} q')
        known: bool | None = None
        for length, (time, values) in enumerate(trace, 1):
            for result in group.progress(time, values):
                known = result.verdict is Verdict.TRUE
            expected = SUGAR[word](p, q, interval, trace[:length])
            assert known is expected or (expected is None and known is not None), (interval, trace)


@pytest.mark.parametrize(
    ('text', 'canonical'),
    [
        ('■[0, 1 s] p', 'historically[0 s, 1 s] p'),
        ('◆ p and q', 'once (p and q)'),
        ('p and ● q or r', 'p and (previous (q or r))'),
        ('p since q until r', 'p since (q until r)'),
        ('p holds  until q', 'q or (p and (p until q))'),
        ('p holds until(0, 1 s] q', 'p and (p until(0 s, 1 s] q)'),
        ('p unless[0, 1 s] q', '(q or (p and (p until[0 s, 1 s] q))) or (always[0 s, 1 s] p)'),
        ('p release q', 'not ((not q) or ((not p) and ((not p) until (not q))))'),
        ('holds holds until holds', 'holds or (holds and (holds until holds))'),
    ],
)
def test_spellings(text: str, canonical: str) -> None:
    assert str(parse_formula(text)) == canonical
    assert str(parse_formula(canonical)) == canonical


@pytest.mark.parametrize('operator', ['unless', 'holds until', 'release'])
def test_repeated_sides_have_a_limit(operator: str) -> None:
    text = 'p'
    for _ in range(30):
        text = f'p {operator} ({text})'
    with pytest.raises(Exception, match=f"'{operator}' is written out to more than 20000 parts"):
        parse_formula(text)


MS = 1_000_000
P, NOT_P = {'p': True, 'q': False}, {'p': False, 'q': False}
Q = {'p': False, 'q': True}


@pytest.mark.parametrize(
    ('text', 'before', 'after', 'expected'),
    [
        # A p may have been missing for a while: no alarm before it would be too old.
        ('always (q -> once[0, 5 ms] p)', [(0, P)], [(9, Q), (13, Q), (14, Q)], ('false', 14)),
        ('always (q -> once[0, 5 ms] p)', [(0, P)], [(9, P), (13, Q), (14, Q)], None),
        # Some of the missing states are old enough at the first state, others later.
        ('always (q -> once[2 ms, 5 ms] p)', [(0, P)], [(9, Q), (13, Q), (14, Q)], ('false', 14)),
        ('eventually historically[0, 5 ms] p', [(0, Q)], [(9, P), (13, P), (14, P)], ('true', 14)),
        ('eventually once p', [(0, NOT_P)], [(9, NOT_P), (10, P)], ('true', 10)),
        ('always historically p', [(0, P)], [(9, P), (10, NOT_P)], ('false', 10)),
        ('always (q -> previous p)', [(0, P)], [(9, Q), (10, Q)], ('false', 10)),
        ('always (q -> not p since[0, 2 ms] p)', [(0, P)], [(9, Q), (12, Q)], ('false', 12)),
        ('eventually[0, 9 ms] (q and once[0, 5 ms] p)', [(0, NOT_P)], [(9, Q)], ('error', 9)),
        ('always (q or not once[0, 20 ms] p)', [(0, NOT_P)], [(9, NOT_P)], None),
        ('eventually (q and not once[0, 20 ms] p)', [(0, NOT_P)], [(9, Q)], None),
        ('always once[0, 1 s] eventually[0, 1 s] p', [(0, P)], [(9, Q)], ('error', 9)),
    ],
)
def test_past_operators_after_a_gap(
    text: str, before: Trace, after: Trace, expected: tuple[str, int] | None
) -> None:
    for at_once in (False, True):
        group = started(text)
        found: list[FormulaResult] = []
        for number, part in enumerate((before, after)):
            if number:
                group.gap()
            states = [(time * MS, values) for time, values in part]
            found += progressed_many(group, states) if at_once else progressed(group, states)
        told = [
            ('error' if each.error else each.verdict.name.lower(), (each.ended_at or 0) // MS)
            for each in found
        ]
        assert told == ([expected] if expected else [])


def with_gap(text: str, before: dict[str, bool]) -> FormulaGroup:
    """A group that keeps the history of a formula, after one state and a gap."""
    group = with_history(text)
    group.progress(0, before)
    group.gap()
    return group


def test_a_history_with_a_gap_is_known_again_after_its_window() -> None:
    text = 'once[0, 5 ns] p'
    group = with_gap(text, P)
    found = []
    for time in (9, 13, 14, 15, 16):
        group.add_formula('it', text)
        [result] = group.progress(time, P if time == 15 else NOT_P)
        found.append('error' if result.error else (result.verdict.name, result.explanation[:4]))
    assert found[:3] == ['error', 'error', ('FALSE', "'p' ")]
    assert found[3:] == [('TRUE', "'p' "), ('TRUE', "'p' ")]
    assert 'missing' not in result.explanation


def test_several_gaps_are_told_as_one() -> None:
    group = with_gap('once[0, 5 ms] p', NOT_P)
    group.progress(3 * MS, NOT_P)
    group.gap()
    group.add_formula('it', 'once[0, 5 ms] p')
    [result] = group.progress(6 * MS, NOT_P)
    assert 'missing between 0.000 s and 0.006 s' in str(result.error)


def test_a_history_depends_on_the_gap_as_long_as_that_of_its_operands() -> None:
    text = 'once[0, 1 ns] once[5 ns, 9 ns] p'
    group = with_gap(text, NOT_P)
    found = []
    for time in (3, 4, 5, 6):
        group.add_formula('it', text)
        [result] = group.progress(time, NOT_P)
        found.append('error' if result.error else result.verdict.name)
    assert found == ['error', 'FALSE', 'FALSE', 'error']


@given(
    formulas(2), st.lists(st.tuples(st.integers(1, 4), st.booleans(), st.booleans()), min_size=3)
)
def test_duals(formula: Formula, rows: list[tuple[int, bool, bool]]) -> None:
    """`historically` and `once`, and `once` and `since`."""
    times = accumulate(step for step, _, _ in rows)
    trace = [(time, {'p': p, 'q': q}) for time, (_, p, q) in zip(times, rows, strict=True)]
    interval = Interval(1, 4)
    for left, right in (
        (Historically(formula, interval), Not(Once(Not(formula), interval))),
        (Once(formula, interval), Since(Truth(True), formula, interval)),
        (Always(Implies(Previous(formula), formula)), Always(Or(Not(Previous(formula)), formula))),
        (And(formula, formula), formula),
    ):
        found = []
        for each in (left, right):
            results = progressed(started(str(each)), trace)
            found.append([(r.verdict, r.decided_at) for r in results])
        assert found[0] == found[1], (str(left), trace)


def test_a_kept_history_with_a_gap_is_sound() -> None:
    """Whatever was lost in the gap, no later formula is told something else."""
    random = Random(7)  # noqa: S311 - no secret
    known = 0
    for _ in range(CASES // 2):
        formula = random_past(random, 3)
        times = list(accumulate(random.randint(1, 4) for _ in range(random.randint(3, 14))))
        trace = [(t, {name: random.random() < 0.6 for name in NAMES}) for t in times]
        first = random.randint(1, len(trace) - 1)
        last = random.randint(first, len(trace) - 1)
        group = with_history(str(formula))
        for i, (time, values) in enumerate(trace):
            if i == last:
                group.gap()
            if first <= i < last:
                continue
            number = group.add_formula('it', str(formula))
            for result in group.progress(time, values):
                if result.error is None:
                    told = result.verdict is Verdict.TRUE
                    assert told is holds(formula, trace, i), (str(formula), trace, first, last)
                    known += i >= last
                else:
                    assert i >= last
                    assert 'depends on states that are missing between' in str(result.error)
            if number in group.formulas:
                group.remove_formula(number)
    assert known > CASES // 2
