"""Formulas that are tried at states: the verdicts of a group, and no traces."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import Alternatives, DyKnowError, LanguageError
from dyknow_reasoning import (
    FormulaGroup,
    ReasoningError,
    TrialFormula,
    asked_of_each_state,
    check_trial,
)

OBJECTS = {'Sort': ['a', 'b']}


def random_text(random: Random, depth: int, variable: str = '') -> str:
    """A formula without operators of the future."""
    atoms = ['p', 'q', 'x > 1', 'x + y < 3', 'true']
    if variable:
        atoms.append(f'R[{variable}]')
    if not depth or random.random() < 0.15:
        return random.choice(atoms)
    inner, other = (random_text(random, depth - 1, variable) for _ in range(2))
    start = random.choice([0, 0, 1, 2])
    bounds = f'[{start} ns, {random.choice(["inf", f"{start + random.choice([0, 1, 4])} ns"])}]'
    shapes = [
        f'(not ({inner}))',
        f'(({inner}) and ({other}))',
        f'(({inner}) or ({other}))',
        f'(({inner}) -> ({other}))',
        f'(({inner}) <-> ({other}))',
        f'(at least 1 of ({inner}, {other}))',
        f'(exactly 1 of ({inner}, {other}, p))',
        f'(once{bounds} ({inner}))',
        f'(historically{bounds} ({inner}))',
        f'(({inner}) since{bounds} ({other}))',
        f'(previous ({inner}))',
    ]
    if not variable:
        body = random_text(random, depth - 1, 'u')
        shapes += [f'(exists u in Sort: {body})', f'(forall u in Sort: {body})']
    return random.choice(shapes)


def random_states(random: Random, count: int) -> list[tuple[int, dict[str, Any]]]:
    time, found = 0, []
    for _ in range(count):
        time += random.choice([1, 1, 2, 5])
        booleans = {name: random.random() < 0.5 for name in ('p', 'q', 'R[a]', 'R[b]')}
        found.append((time, {**booleans, 'x': random.randint(0, 3), 'y': random.randint(0, 3)}))
    return found


@given(
    st.randoms(use_true_random=False), st.sampled_from(['', 'always ', 'forall v in Sort: always '])
)
def test_the_verdicts_are_those_of_a_group_over_the_accepted_states(
    random: Random, prefix: str
) -> None:
    text = prefix + random_text(random, 3)
    tried, group = TrialFormula(text, OBJECTS), FormulaGroup()
    asked = str(asked_of_each_state(check_trial(text)))
    number = group.add_formula('f', asked, every_state=True)
    group.begin(OBJECTS)
    for time, values in random_states(random, 12):
        found = tried.holds(time, values)
        if random.random() < 0.4:
            continue  # The state leaves no trace.
        tried.accept()
        group.progress(time, values)
        summary = group.standing.summary(number)
        assert found is not summary.is_violated, text


def test_the_example_of_the_module() -> None:
    tried = TrialFormula('speed < 1 or previous speed > 0.5', {})
    proposed = [(0.6, 1), (1.5, 1), (0.2, 0), (1.4, 1), (0.3, 1), (1.2, 0)]
    found = []
    for time, (speed, is_accepted) in enumerate(proposed):
        found.append(tried.holds(time, {'speed': speed}))
        if is_accepted:
            tried.accept()
    assert found == [True, True, True, True, True, False]


def test_an_error_leaves_no_trace() -> None:
    tried = TrialFormula('previous p', {})
    assert not tried.holds(1, {'p': True})
    tried.accept()
    for values, said in (({}, "no field 'p'"), ({'p': 3}, 'not a boolean')):
        with pytest.raises(ReasoningError, match=said):
            tried.holds(2, values)
    with pytest.raises(ReasoningError, match='not later'):
        tried.holds(1, {'p': True})
    assert tried.holds(2, {'p': False})


def test_operands_are_read_whatever_the_others_are() -> None:
    tried = TrialFormula('p or x > 1', {})
    with pytest.raises(ReasoningError, match="'x'"):
        tried.holds(1, {'p': True, 'x': float('nan')})


@pytest.mark.parametrize(
    ('text', 'said', 'column'),
    [
        ('always p -> eventually q', "'eventually q' looks into the future", 13),
        ('always[0 s, 1 s] p', "'always[0 s, 1 s] p' looks into the future", 1),
        ('p and always q', "'always q' looks into the future", 7),
        ('exists u in Sort: always R[u]', "'always R[u]' looks into the future", 19),
    ],
)
def test_what_looks_into_the_future_is_refused(text: str, said: str, column: int) -> None:
    with pytest.raises(LanguageError) as caught:
        check_trial(text)
    assert caught.value.reason.startswith(said)
    assert caught.value.position.column == column


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('forall u in V: R[u]', "the sort 'V' has no domain"),
        ('x > 3 m', "the unit of 'x' is not known"),
        (' <-> '.join(f'p{number}' for number in range(40)), "the limit 'node_limit'"),
    ],
)
def test_what_needs_more_than_the_states_is_refused(text: str, said: str) -> None:
    with pytest.raises(DyKnowError, match=said):
        TrialFormula(text, OBJECTS)


@pytest.mark.parametrize('wide', ['gap > 2', 'P(normal(gap, 1) > 2) > 0.5'])
def test_a_formula_holds_for_all_alternatives_of_values(wide: str) -> None:
    either = Alternatives.of((1.0, 3.0), 'the clocks of a and b differ')
    formula = TrialFormula(f'speed < 0.5 or {wide}', {})
    assert formula.holds(1, {'speed': 0.1, 'gap': either, 'other': either})
    assert not formula.holds(1, {'speed': 0.6, 'gap': either})
    assert formula.holds(1, {'speed': 0.6, 'gap': 3.0, 'other': either})
    formula = TrialFormula('speed < 0.5 or once (gap > 2)', {})
    with pytest.raises(ReasoningError, match='the clocks of a and b differ: too much'):
        formula.holds(1, {'speed': 0.6, 'gap': either})
