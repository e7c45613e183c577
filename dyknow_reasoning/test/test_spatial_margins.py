"""Margins of spatial operators against routes that are listed one by one."""

from __future__ import annotations

from itertools import product
from math import nan
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from margin_reference import Step, ended, margin
from reasoning_reference import begun, random_cases, started
from spatial_margin_reference import least
from spatial_reference import OBJECTS
from test_spatial import NUMBERS, random_text

from dyknow_reasoning import FormulaGroup, ReasoningError, TrialFormula, check_types, parse_formula
from dyknow_reasoning.language.formula import Formula
from dyknow_reasoning.margins import building
from dyknow_reasoning.margins.standing_margin import StandingMargin

STATES = (
    'N[s] < 2',
    'M[s] >= 1',
    'not N[s] <= M[s]',
    'P[s]',
    '(N[s] < 1 or M[s] > 2)',
    '(P[s] -> N[s] = 1)',
    'N[a0] < 3',
    'true',
)
STATES_OF_FORMULA = 20


def columns(objects: tuple[str, ...]) -> tuple[list[str], list[str]]:
    """The fields with truths, and those with numbers."""
    pairs = [f'[{a}, {b}]' for a, b in product(objects, objects) if a != b]
    truths = [f'L{pair}' for pair in pairs] + [f'P[{name}]' for name in objects]
    numbers = [f'D{pair}' for pair in pairs] + [f'{e}[{name}]' for e in 'MN' for name in objects]
    return truths, numbers


@pytest.mark.timeout(14400)
def test_margins_at_each_state(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compare with the reference, and with the truth; most cases by far of all tests."""
    monkeypatch.setitem(OBJECTS, 'R', ())
    for case in range(random_cases(200) // STATES_OF_FORMULA):
        random = Random(case)  # noqa: S311 - no secrets
        objects = OBJECTS['R'] = tuple(f'a{number}' for number in range(random.choice((2, 3, 4))))
        truths, numbers = columns(objects)
        text = random_text(random.choice, 3, in_time=False, states=STATES)
        formula = parse_formula(text)
        trial = TrialFormula(text, OBJECTS)
        found = StandingMargin(formula, check_types(formula, text), OBJECTS, 10_000)
        found.keep_all()
        states: list[dict[str, Any]] = [
            {name: random.random() < 0.4 for name in truths}
            | {name: random.choice(NUMBERS) for name in numbers}
            for _ in range(STATES_OF_FORMULA)
        ]
        for time, state in enumerate(states):
            found.step(time, state)
        for time, (state, bounds) in enumerate(zip(states, found.of_each(), strict=True)):
            expected = margin(formula, [(0, 0, state)], 0)
            assert (bounds.lower, bounds.upper) == expected, (case, text, state)
            if bounds.lower != 0:
                assert trial.holds(time, state) == (bounds.lower > 0), (case, text, state)


@st.composite
def texts(draw: st.DrawFn) -> str:
    return random_text(lambda choices: draw(st.sampled_from(choices)), 3, states=STATES)


@st.composite
def traces(draw: st.DrawFn) -> list[Step]:
    """States, of which one may have a number that is none, and gaps between them."""
    truths, numbers = columns(OBJECTS['R'])
    values = dict.fromkeys(truths, st.booleans()) | dict.fromkeys(numbers, st.sampled_from(NUMBERS))
    steps = st.tuples(st.integers(1, 3), st.fixed_dictionaries(values), st.integers(0, 9))
    found: list[Step] = []
    now = 0
    for step, state, kind in draw(st.lists(steps, min_size=1, max_size=6)):
        if kind == 0 and found:
            found.append((now + 1, now + step, None))
            now += step
        if kind == 1:
            state[draw(st.sampled_from(numbers))] = nan
        now += step
        found.append((now, now, state))
    return found


@pytest.fixture(params=[1, 3])
def _objects(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(OBJECTS, 'R', tuple(f'a{number}' for number in range(request.param)))


def margins(text: str, trace: list[Step], **asked: bool) -> list[tuple[float, float]]:
    """The bounds after each state, by the margins of a group, without its verdicts."""
    group, number = begun(text, OBJECTS, margin=True, **asked)
    running = group._margins
    found = []
    for time, _, state in trace:
        if state is None:
            running.gap()
            continue
        running.progress(time, state)
        bounds = running.of(number)
        assert bounds is not None
        found.append((bounds.lower, bounds.upper))
    return found


def expected(formulas: list[Formula], trace: list[Step]) -> list[tuple[float, float]]:
    """The bounds of the least margin of some formulas, after each state."""
    return [
        least(margin(each, ended(trace[: index + 1]), 0) for each in formulas)
        for index, (_, _, state) in enumerate(trace)
        if state is not None
    ]


@pytest.mark.usefixtures('_objects')
@settings(max_examples=random_cases(40))
@given(texts(), traces())
def test_bounds_are_those_of_the_reference(text: str, trace: list[Step]) -> None:
    assert margins(text, trace) == expected([parse_formula(text)], trace)


@pytest.mark.usefixtures('_objects')
@settings(max_examples=random_cases(40))
@given(texts(), traces(), st.sampled_from([2, 100]))
def test_bounds_for_all_objects(text: str, trace: list[Step], fewest: int) -> None:
    """As arrays, or one by one."""
    formulas = [parse_formula(text.replace('from a0', f'from {each}')) for each in OBJECTS['R']]
    text = f'forall r in R: {text.replace("from a0", "from r")}'
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(building, '_LEAST_OBJECTS', fewest)
        assert margins(text, trace) == expected(formulas, trace)


@pytest.mark.usefixtures('_objects')
@settings(max_examples=random_cases(30))
@given(texts(), traces(), st.booleans())
def test_recorded_margins_are_those_of_single_states(
    text: str,
    trace: list[Step],
    every_state: bool,  # noqa: FBT001
) -> None:
    times, states = zip(*((time, state) for time, _, state in trace if state), strict=True)
    text = f'forall r in R: {text.replace("from a0", "from r")}'
    group, number = begun(text, OBJECTS, margin=True, every_state=every_state)
    for time, state in zip(times, states, strict=True):
        group.progress(time, state)
    recorded, _ = begun(text, OBJECTS, margin=True, every_state=every_state)
    columns = {name: [state[name] for state in states] for name in states[0]}
    recorded.progress_many(times, columns)
    assert recorded.margin(number) == group.margin(number)


STATE = {
    **{f'D[{a}, {b}]': 90.0 for a in ('r1', 'r2', 'r3') for b in ('r1', 'r2', 'r3') if a != b},
    'D[r3, r2]': 30.0,
    'D[r2, r1]': 49.0,
    'D[r3, r1]': 60.0,
    'N[r1]': 7.0,
    'N[r2]': 25.0,
    'N[r3]': 40.0,
}


@pytest.mark.parametrize(
    ('formula', 'margin'),
    [
        ('somewhere[0, 30] N[s] > 20', '20 (N[r3] > 20)'),
        ('somewhere[20, 40] N[s] > 20', '5 (N[r2] > 20)'),
        ('everywhere[0, 60] N[s] > 5', '20 (N[r2] > 5)'),
        # The length of the link of 49, which is hardly there, does not count.
        ('N[s] > 20 reach[60, 90] N[s] < 10', '3 (N[r1] < 10)'),
        ('N[s] > 20 reach[2 hops, 3 hops] N[s] < 20', '5 (N[r2] > 20)'),
        ('N[s] > 20 reach[1 hops, 3 hops] N[s] < 10', '3 (N[r1] < 10)'),
        ('escape[25, inf) N[s] > 20', '5 (N[r2] > 20)'),
        ('N[s] > 20 surround[0, 1 hops] N[s] < 30', '5 (N[r2] < 30)'),
        ('somewhere[1 hops, 1 hops] N[s] > N[r3]', '-15 (N[r2] > N[r3])'),
        ('somewhere[80, inf) N[s] > 20', '-inf'),
        ('everywhere[80, inf) N[s] > 20', 'inf'),
        ('somewhere[0, 30] N[s] > prev(N[s]) + 1', '-inf'),
    ],
)
def test_margins_by_hand(formula: str, margin: str) -> None:
    text = f'over (D[a, b] <= 50 for a, b in R) from r3 to s: ({formula})'
    group, number = begun(text, {'R': ['r1', 'r2', 'r3']}, margin=True)
    group.progress(0, STATE)
    assert str(group.margin(number)) == margin


def test_a_probability_in_space_has_no_margin() -> None:
    text = 'over (L[a, b] for a, b in R) from r1 to s: somewhere[0, 1 hops] P(N[s] > 2) > 0.5'
    with pytest.raises(ReasoningError, match='no margin is defined for'):
        FormulaGroup().add_formula('it', text, margin=True)


@pytest.mark.parametrize('objects', ['ab', 'abcd', 'abcdefgh'])
@pytest.mark.parametrize('quantifier', ['exists', 'forall', 'at least 2', 'exactly 1'])
@pytest.mark.parametrize('variable', ['v', 'a'])
def test_quantifiers_in_operands(objects: str, quantifier: str, variable: str) -> None:
    random = Random(5)  # noqa: S311 - no secrets
    names = [each for each in objects if each != variable]
    members = [f'N[{each}] < N[s]' for each in names]
    written = {
        'exists': ' or '.join(f'({each})' for each in members),
        'forall': ' and '.join(f'({each})' for each in members),
    }.get(quantifier, f'{quantifier} of ({", ".join(members)})')
    quantified = f'{quantifier} {variable} in T: (N[{variable}] < N[s])'
    over = 'always over (N[x] <= N[y] for x, y in S) from b to s: somewhere[0, 2 hops]'
    domains = {'S': objects, 'T': names}
    groups = [
        started(f'{over} ({body})', domains=domains, margin=True, every_state=True)
        for body in (quantified, written)
    ]
    for time in range(20):
        state = {f'N[{each}]': float(random.randint(0, 9)) for each in objects}
        found = []
        for group in groups:
            group.progress(time, state)
            bounds = group.margin(1)
            assert bounds is not None
            found.append((bounds.lower, bounds.upper))
        assert found[0] == found[1]
