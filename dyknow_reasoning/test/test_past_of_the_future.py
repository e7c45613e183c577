"""Operators of the past over operators of the future, evaluated from every state on."""

from __future__ import annotations

from collections.abc import Iterable
from random import Random

import pytest
from reasoning_reference import (
    NAMES,
    Trace,
    begun,
    holds,
    progressed,
    progressed_many,
    random_cases,
    started,
    with_history,
)

from dyknow_common import Verdict
from dyknow_reasoning import FormulaGroup, FormulaLimits, FormulaResult, parse_formula
from dyknow_reasoning.language.formula import (
    Always,
    And,
    Comparison,
    Eventually,
    Formula,
    Freeze,
    Historically,
    Implies,
    Interval,
    Not,
    Once,
    PastFormula,
    Previous,
    Since,
    Until,
    looks_forward,
    walk,
)
from dyknow_reasoning.language.terms import Feature, Kept
from dyknow_reasoning.standing import start_verdicts

CASES = random_cases(50)

Outcome = tuple[Verdict, int | None] | None
"""A verdict and the time of the deciding state; None without one."""


def is_mixed(formula: Formula) -> bool:
    return any(isinstance(each, PastFormula) and looks_forward(each) for each in walk(formula))


def random_formula(random: Random, depth: int) -> Formula:
    """A formula with operators of the past and the future in any order, and kept values."""
    if not depth or random.random() < 0.1:
        return Feature(random.choice(NAMES))
    start = random.choice([0, 0, 0, 1, 2, 5])
    interval = Interval(start, random.choice([None, start, start + 1, start + 4]))
    body, other = (random_formula(random, depth - 1) for _ in range(2))
    if random.random() < 0.2:
        first, second = (Feature(random.choice(NAMES)) for _ in range(2))
        same = Comparison('=', second, Kept('v', first))
        other = Freeze('v', first, random.choice([Eventually, Always])(same, interval))
    temporal = (Once, Historically, Eventually, Always)
    if random.random() < 0.6:
        return random.choice(temporal)(body, interval)
    return random.choice(
        [
            Since(body, other, interval),
            Until(body, other, interval),
            Previous(body),
            Not(body),
            And(body, other),
            Implies(body, other),
        ]
    )


def is_kept_in_the_past(formula: Formula) -> bool:
    """Return True for a value that is kept within an operator of the past, which is an error."""
    past = (each for each in walk(formula) if isinstance(each, PastFormula))
    return any(isinstance(inner, Freeze) for each in past for inner in walk(each))


def random_mixed(random: Random) -> Formula:
    while True:
        found = random_formula(random, random.choice([2, 3, 3, 4]))
        if is_mixed(found) and not is_kept_in_the_past(found):
            return found


def random_trace(random: Random, most: int = 12) -> Trace:
    step, time, trace = random.choice([1, 1, 2, 4]), 0, []
    for _ in range(random.randint(1, most)):
        time += random.randint(1, step)
        trace.append((time, {name: random.random() < 0.5 for name in NAMES}))
    return trace


def delayed(text: str, trace: Trace) -> list[Outcome]:
    """The outcomes from each state on, by evaluations that begin with the first state."""
    delays = [time - trace[0][0] for time, _ in trace]
    group = started(*(f'eventually[{each} ns, {each} ns] ({text})' for each in delays))
    return outcomes(range(1, len(trace) + 1), progressed(group, trace))


def kept(text: str, trace: Trace) -> list[Outcome]:
    """The outcomes of formulas that begin with each state, and look back to all states."""
    group = with_history(text)
    numbers: list[int] = []
    results: list[FormulaResult] = []
    for state in trace:
        numbers.append(group.add_formula('it', text))
        results += progressed(group, [state])
    return outcomes(numbers, results)


def kept_at_once(text: str, trace: Trace, begin: int) -> Outcome:
    """The same from one state on, if states come in two blocks."""
    group = with_history(text)
    assert not progressed_many(group, trace[:begin])
    number = group.add_formula('it', text)
    return outcomes([number], progressed_many(group, trace[begin:]))[0]


def standing(text: str, trace: Trace) -> list[Outcome]:
    group, number = begun(text, every_state=True)
    monitor = group.standing.formulas[number].monitor
    log = monitor.keep_all()
    assert not progressed(group, trace)
    verdicts = start_verdicts(monitor, log, [time for time, _ in trace])
    return [(each.verdict, each.decided_at) if each.verdict else None for each in verdicts]


def outcomes(numbers: Iterable[int], results: Iterable[FormulaResult]) -> list[Outcome]:
    found = {each.formula_id: each for each in results}
    assert not [each.error for each in found.values() if each.error]
    return [
        (found[each].verdict, found[each].decided_at) if each in found else None for each in numbers
    ]


def check(formula: Formula, trace: Trace) -> None:
    text = str(formula)
    expected = delayed(text, trace)
    begin = len(trace) // 2
    assert same(kept_at_once(text, trace, begin), expected[begin]), (text, trace)
    for number, found in enumerate(zip(standing(text, trace), kept(text, trace), strict=True)):
        for outcome in found:
            assert same(outcome, expected[number]), (text, trace, number)
            final = holds(formula, trace, number)
            assert final is None or outcome is not None, (text, trace, number)
            if outcome is not None:
                assert final in {None, outcome[0] is Verdict.TRUE}, (text, trace, number)


def test_every_start_is_that_of_the_reference() -> None:
    random = Random(1)  # noqa: S311 - no secret
    for _ in range(CASES):
        check(random_mixed(random), random_trace(random))


def test_a_kept_value_beside_the_past_of_the_future() -> None:
    """A history that later formulas look back to does not read the kept value of any of them."""
    names = [{name: name in values for name in NAMES} for values in ('pq', 'q', '', 'p', 'q')]
    for past in ('previous eventually[0, 1 ns] p', 'once[0, 2 ns] eventually[0, 1 ns] p'):
        text = f'({past}) or let v = q in eventually[1 ns, 2 ns] q = v'
        check(parse_formula(text), list(enumerate(names)))


def same(first: Outcome, second: Outcome) -> bool:
    """Return True for equal outcomes; what needs no state may be known at once in one alone."""
    if first is None or second is None:
        return all(each is None or each[1] is None for each in (first, second))
    return first == second or (None in {first[1], second[1]} and first[0] is second[0])


FLEET = 'forall x in S: p[x] -> once[0, 3 ns] eventually[0, 2 ns] q[x]'


def test_many_objects() -> None:
    """Each object has what it remembers; those without operators of the future have registers."""
    objects = ('a', 'b', 'c')
    rows = [(1, 'a', ''), (2, 'b', 'a'), (3, '', ''), (8, 'c', ''), (9, '', ''), (14, '', '')]
    states = [
        (time, {f'p[{x}]': x in p for x in objects} | {f'q[{x}]': x in q for x in objects})
        for time, p, q in rows
    ]
    group, number = begun(FLEET, {'S': objects}, every_state=True)
    group.keep_history(FLEET)
    later = {group.add_formula('it', FLEET): 0}
    results: list[FormulaResult] = []
    for index, state in enumerate(states):
        results += progressed(group, [state])
        later[group.add_formula('it', FLEET)] = index + 1
    found = {later[each.formula_id]: (each.verdict, each.decided_at) for each in results}
    true, false = Verdict.TRUE, Verdict.FALSE
    # b at 2 has no q until 4, which no state shows before 8; the same for c at 8.
    assert found == {
        0: (true, 2),
        1: (false, 8),
        2: (true, 3),
        3: (false, 14),
        4: (true, 9),
        5: (true, 14),
    }
    episodes = group.standing.summary(number).latest_episodes
    assert [(each.begin, each.decided_at, each.objects) for each in episodes] == [
        (2, 8, 'x = b'),
        (8, 14, 'x = c'),
    ]
    assert episodes[0].explanation == (
        "for x = b: 'q[b]' held at no state in [0.000000002 s, 0.000000004 s]"
    )


MIXED = 'once[0, 3 ns] eventually[0, 1 ns] q'


def result_at(group: FormulaGroup, time: int, value: float) -> FormulaResult | None:
    """The result of the formula that begins with a state, if that decides it."""
    number = group.add_formula('it', MIXED)
    results = group.progress(time, {'q': value})
    return next((each for each in results if each.formula_id == number), None)


@pytest.mark.parametrize('is_gap', [True, False])
def test_a_history_is_known_again_after_its_window(is_gap: bool) -> None:  # noqa: FBT001
    group = with_history(MIXED)
    group.progress(1, {'q': True})
    if is_gap:
        group.gap()
        error = 'states that are missing between 0.000000001 s and 0.000000005 s'
    else:
        group.progress(4, {'q': 2.5})
        error = "the field 'q' holds the number 2.5, not a boolean"
    for time in (5, 6, 7):
        result = result_at(group, time, value=False)
        assert result is not None
        assert error in str(result.error)
    result = result_at(group, 8, value=True)
    assert result is not None
    assert (result.error, result.verdict) == (None, Verdict.TRUE)


def test_without_an_end_a_history_stays_unknown() -> None:
    text = 'previous eventually[0, 1 ns] q'
    group = with_history(text)
    group.progress(1, {'q': True})
    group.gap()
    group.progress(5, {'q': True})
    group.add_formula('it', text)
    (result,) = group.progress(100, {'q': True})
    assert 'missing' in str(result.error)


def test_what_a_history_remembers_is_limited() -> None:
    text = 'once[0, 100 ns] (p and eventually[0, 100 ns] q)'
    group = with_history(text, limits=FormulaLimits(node_limit=20))
    for time in range(1, 40):
        assert not group.progress(time, {'p': True, 'q': False})
    group.add_formula('it', text)
    (result,) = group.progress(40, {'p': True, 'q': False})
    assert "(the limit 'node_limit')" in str(result.error)


def test_memory_does_not_grow_with_states() -> None:
    """Over many states at irregular times, standing formulas and histories keep what they need."""
    text = 'p -> once[0, 3 ns] eventually[0, 2 ns] q'
    group, number = begun(text, every_state=True)
    group.keep_history(text)
    monitor = group.standing.formulas[number].monitor
    (history,) = group._monitor.histories.memories.values()  # type: ignore[union-attr]
    random, time = Random(2), 0  # noqa: S311 - no secret
    for _ in range(3000):
        time += random.randint(1, 3)
        group.progress(time, {'p': random.random() < 0.5, 'q': random.random() < 0.3})
        assert history.node.size < 40
        assert sum(each.run_count() for each in monitor._starts) < 10
    counts = group.standing.summary(number)
    assert counts.holds + counts.fails + counts.undecided == 3000
    assert len(history._automaton._locations) < 3000


def test_what_needs_no_state_has_one_result() -> None:
    text = 'forall x in S: x = a and once[0, 9 ns] eventually[0, 1 ns] q'
    group = with_history(text, {'S': ['a', 'b']})
    group.add_formula('other', 'eventually not q')
    group.progress(1, {'q': True})
    group.gap()
    group.add_formula('it', text)
    (result,) = group.progress(5, {'q': True})
    assert (result.verdict, result.error) == (Verdict.FALSE, None)
