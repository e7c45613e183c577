"""Starts that move on at some age without a step, against single evaluations from each state."""

from __future__ import annotations

from itertools import accumulate
from math import inf
from random import Random
from typing import cast

import pytest
from reasoning_reference import random_cases
from test_standing_monitor import States, check, group_of

from dyknow_reasoning.execution.automata import automaton
from dyknow_reasoning.execution.automata.automaton import Guard, Move
from dyknow_reasoning.execution.standing.groups import OWN, DecidedStarts, answers
from dyknow_reasoning.execution.standing.open_starts import OpenStarts

pytestmark = pytest.mark.long

FORMULAS = [
    'p -> q until[0, 9 ns] always[0, 5 ns] not p',
    'p -> q until[3 ns, 9 ns] always[0, 5 ns] not p',
    'always[0, 9 ns] eventually[0, 5 ns] p',
    'always[2 ns, 9 ns] eventually[1 ns, 5 ns] p',
    'always[3 ns, 18 ns] p',
    'eventually[0, 12 ns] always[0, 4 ns] p',
    # In the other group, a second age matters.
    'always[0, 4 ns] p and eventually[0, 15 ns] q',
    'always[0, 4 ns] p and eventually[3 ns, 9 ns] always[0, 3 ns] q',
    'always[0, 3 ns] eventually[0, 4 ns] p and eventually[0, 20 ns] q',
    '(always[0, 5 ns] p or eventually[0, 9 ns] q) and eventually[0, 13 ns] always[0, 2 ns] q',
    # Windows without an end, and the age itself, which few states have.
    'always[0, 4 ns] p and eventually q',
    'eventually[6 ns, 6 ns] p or always[0, 9 ns] eventually[0, 3 ns] q',
]


def random_states(random: Random, *, gaps: bool) -> States:
    """Runs of states that are alike, each state later than the one before by a random time."""
    runs = [{'p': random.random() < 0.5, 'q': random.random() < 0.5} for _ in range(10)]
    values = [each for each in runs for _ in range(random.choice([1, 2, 5, 12]))][:40]
    most = random.choice([1, 2, 4, 9])
    times = accumulate(random.randint(1, most) for _ in values)
    return [
        (time, each, gaps and random.random() < 0.05)
        for time, each in zip(times, values, strict=True)
    ]


@pytest.mark.parametrize('gaps', [False, True])
@pytest.mark.parametrize('text', FORMULAS)
def test_the_verdicts_are_those_of_single_evaluations(text: str, gaps: bool) -> None:  # noqa: FBT001
    random = Random(text)  # noqa: S311
    for _ in range(random_cases(4)):
        check(text, {}, random_states(random, gaps=gaps))


@pytest.mark.parametrize('text', FORMULAS)
def test_automata_that_are_forgotten(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(automaton, '_MAX_NODES', 1)
    random = Random(text)  # noqa: S311
    for _ in range(random_cases(2)):
        check(text, {}, random_states(random, gaps=True))


@pytest.mark.parametrize(
    ('text', 'values', 'most'),
    [
        (
            'p -> q until[0, 5 s] always[0, 3 s] not p',
            [(False, True)] * 10 + [(True, True)] * 40 + [(False, True)] * 50,
            10,
        ),
        ('always[0, 1 s] eventually[0, 0.5 s] p', [(True, False)] * 6 + [(False, False)] * 3, 25),
        ('always[0, 1 s] p and eventually[0, 9 s] q', [(True, False)] * 60 + [(True, True)], 15),
        # Starts leave a group for one that others leave, too.
        ('always[1 s, 5 s] p', [(True, False)], 10),
    ],
)
def test_starts_need_no_step_to_move_on(
    text: str, values: list[tuple[bool, bool]], most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At irregular times, steps are necessary where the truth of the atoms changes."""
    steps = 0
    step = OpenStarts.step

    def counted(starts: OpenStarts, symbol: int) -> list[DecidedStarts]:
        nonlocal steps
        steps += 1
        return step(starts, symbol)

    monkeypatch.setattr(OpenStarts, 'step', counted)
    group, monitor = group_of(text, {})
    random = Random(1)  # noqa: S311
    now = 0
    for number in range(300):
        now += random.randint(50_000_000, 150_000_000)
        p, q = values[number % len(values)]
        group.progress(now, {'p': p, 'q': q})
        if number == 200:
            steps = 0
    assert not monitor.failure_count
    assert steps <= most


def test_a_guard_between_a_start_and_an_earlier_state() -> None:
    """Starts of one age may differ then, so the answer is good for no later state."""
    move = object()
    guard = Guard(1, 0, 10, yes=cast('Move', move))
    assert answers(guard, (OWN, 100), 80, 120) == (move, 120, inf, 90)
    assert answers(guard, (OWN, 100), 90, 120) == (None, 120, inf, inf)
