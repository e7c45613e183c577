"""Margins of spatial operators against routes that are listed one by one."""

from __future__ import annotations

from itertools import product
from math import nan
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from margin_reference import Step, ended, margin
from reasoning_reference import begun, random_cases
from spatial_margin_reference import least
from spatial_reference import OBJECTS
from test_spatial import NUMBERS, random_text

from dyknow_common import Verdict
from dyknow_reasoning import parse_formula
from dyknow_reasoning.language.formula import Formula
from dyknow_reasoning.margins import building

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


def columns(objects: tuple[str, ...]) -> tuple[list[str], list[str]]:
    """The fields with truths, and those with numbers."""
    pairs = [f'[{a}, {b}]' for a, b in product(objects, objects) if a != b]
    truths = [f'L{pair}' for pair in pairs] + [f'P[{name}]' for name in objects]
    numbers = [f'D{pair}' for pair in pairs] + [f'{e}[{name}]' for e in 'MN' for name in objects]
    return truths, numbers


@pytest.mark.timeout(14400)
def test_margins_at_one_state(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compare with the reference, and with the verdict; most cases by far of all tests."""
    monkeypatch.setitem(OBJECTS, 'R', ())
    for case in range(random_cases(200)):
        random = Random(case)  # noqa: S311 - no secrets
        objects = OBJECTS['R'] = tuple(f'a{number}' for number in range(random.choice((2, 3, 4))))
        truths, numbers = columns(objects)
        state: dict[str, Any] = {name: random.random() < 0.4 for name in truths}
        state |= {name: random.choice(NUMBERS) for name in numbers}
        text = random_text(random.choice, 3, in_time=False, states=STATES)
        group, number = begun(text, OBJECTS, margin=True)
        (result,) = group.progress(0, state)
        found = group.margin(number)
        assert found is not None
        expected = margin(parse_formula(text), [(0, 0, state)], 0)
        assert (found.lower, found.upper) == expected, (case, text, state)
        if found.lower != 0:
            assert (result.verdict is Verdict.TRUE) == (found.lower > 0), (case, text, state)


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
@given(texts(), traces())
def test_bounds_are_those_of_the_reference(text: str, trace: list[Step]) -> None:
    assert margins(text, trace) == expected([parse_formula(text)], trace)


@pytest.mark.usefixtures('_objects')
@given(texts(), traces(), st.sampled_from([2, 100]))
def test_bounds_for_all_objects(text: str, trace: list[Step], least_objects: int) -> None:
    formulas = [parse_formula(text.replace('from a0', f'from {each}')) for each in OBJECTS['R']]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(building, '_LEAST_OBJECTS', least_objects)
        text = f'forall r in R: {text.replace("from a0", "from r")}'
        assert margins(text, trace) == expected(formulas, trace)
