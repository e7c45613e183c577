"""Formulas asked at every state by look-ups: as step by step, and as single evaluations."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import accumulate
from random import Random
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from reasoning_reference import formulas, random_cases
from test_standing_monitor import (
    NAMES,
    OBJECTS,
    States,
    can_be_asked,
    check,
    check_random,
    recordings,
)

from dyknow_reasoning import FormulaGroup, FormulaLimits
from dyknow_reasoning.execution import fast_path
from dyknow_reasoning.execution.standing import joint_table, standing_monitor, tabulated_starts
from dyknow_reasoning.language.formula import Formula

CASES = random_cases(50)
FORMULAS = [
    'p[x] -> eventually[0, 5 ns] q[x]',
    'p[x] -> eventually[2 ns, 5 ns] always[0, 1 ns] q[x]',
    'always[0, 6 ns] eventually[0, 3 ns] (p[x] or q[x])',
    'p[x] or q[x] until[1 ns, 8 ns] always[0, 3 ns] not p[x]',
    'p[x] -> eventually q[x]',
    'always[0, 20 ns] (p[x] or q[x] or r)',
    'r -> p[x] until q[x]',
    'eventually[4 ns, 4 ns] p[x] <-> q[x]',
    'p[x] -> once[0, 3 ns] q[x]',
    'always (p[x] -> eventually[0, 9 ns] q[x])',
]


@pytest.fixture(autouse=True)
def try_always(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tabulated_starts, '_FEWEST_STATES', 1)
    monkeypatch.setattr(tabulated_starts, '_LOOK_UPS', 1 << 20)


def never(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tabulated_starts, '_FEWEST_STATES', 1 << 40)


@pytest.mark.parametrize('gaps', [False, True])
@pytest.mark.parametrize('most_step', [1, 2])
@pytest.mark.timeout(3600)
def test_the_verdicts_are_those_of_single_evaluations(most_step: int, gaps: bool) -> None:  # noqa: FBT001
    check_random(most_step, gaps=gaps)


@pytest.mark.timeout(3600)
def test_many_objects() -> None:
    def run(formula: Formula, states: States) -> None:
        body = re.sub(r'\b([pq])\b', r'\1[x]', str(formula))
        if can_be_asked(formula, states):
            check(f'forall x in S: {body}', {'S': OBJECTS}, states)

    settings(
        max_examples=random_cases(100), deadline=None, suppress_health_check=list(HealthCheck)
    )(given(formulas(3), recordings(NAMES, 1))(run))()


def random_states(random: Random, objects: Sequence[str]) -> list[tuple[int, dict[str, bool]]]:
    """States at a period, but for some; signals that repeat, but for some states."""
    count, period = random.randint(10, 150), random.randint(1, 2)
    noise = random.choice([0, 0.01, 0.1])
    names = [f'{feature}[{each}]' for feature in 'pq' for each in objects] + ['r']
    bias = random.choice([0.2, 0.5, 0.9])
    waves = {n: [random.random() < bias for _ in range(random.randint(1, 9))] for n in names}
    other = random.choice([0, 0, 0.02])
    steps = (period + (random.random() < other) for _ in range(count))
    return [
        (
            time,
            {n: wave[i % len(wave)] ^ (random.random() < noise) for n, wave in waves.items()},
        )
        for i, time in enumerate(accumulate(steps))
    ]


def told(
    text: str,
    states: Sequence[tuple[int, Mapping[str, bool]]],
    calls: set[int],
    recorded: range = range(0),
) -> Any:
    """All that can be known, at the end and at some states, before gaps; True with look-ups.

    The states in `recorded` are progressed together.
    """
    group = FormulaGroup()
    number = group.add_formula('it', f'forall x in S: {text}', every_state=True)
    group.begin({'S': OBJECTS})
    found: list[Any] = []
    used = False
    for index, (time, values) in enumerate(states):
        if index == recorded.start and recorded:
            times, rows = zip(*(states[each] for each in recorded), strict=True)
            assert not group.progress_many(times, {n: [row[n] for row in rows] for n in values})
        if index not in recorded:
            assert not group.progress(time, values)
        used |= group.standing.formulas[number].monitor._tabulated.is_active
        if index in calls:
            found.append(group.standing.summary(number))
        if index - 1 in calls:
            group.gap()
        if index not in recorded:
            found.append(group.presumably_false(number))
    formula = group.standing.formulas[number]
    monitor = formula.monitor
    found += [group.standing.summary(number), monitor.undecided(), formula.episodes(10)]
    found += [(each.run, each.values) for each in monitor.failures[-10:]]
    for start in (n for run in monitor.undecided() for n in range(run.first, run.last + 1)):
        rests = monitor.remainders(start)
        found.append([(rest.location.node.size, rest.times, rest.instance.order) for rest in rests])
    return found, used


@pytest.mark.timeout(7200)
def test_look_ups_have_no_effect_on_results(monkeypatch: pytest.MonkeyPatch) -> None:
    random = Random(3)  # noqa: S311 - no secret
    used = 0
    for _ in range(CASES):
        text = random.choice(FORMULAS)
        states = random_states(random, OBJECTS)
        few = random.sample(range(len(states)), 3)
        calls = set(few) if random.random() < 0.3 and 'once' not in text else set()
        part = sorted(random.sample(range(len(states)), 2))
        recorded = range(*part) if not calls and random.random() < 0.4 else range(0)
        with monkeypatch.context() as patch:
            patch.setattr(standing_monitor, '_CLEANUP_STATES', random.choice([7, 4096]))
            patch.setattr(tabulated_starts, '_LEARNED', random.choice([0, 5, 256]))
            patch.setattr(joint_table, '_MAX_ROWS', random.choice([3, 1000]))
            patch.setattr(joint_table, '_MAX_STEPS', random.choice([9, 1000]))
            patch.setattr(fast_path, '_MAX_INSTANCES', random.choice([1, 256, 256]))
            most_age = random.choice([9, 2048])
            patch.setattr(joint_table, 'MAX_AGE', most_age)
            patch.setattr(tabulated_starts, 'MAX_AGE', most_age)
            tabulated = told(text, states, calls, recorded)
            never(patch)
            one_by_one = told(text, states, calls)
        assert not one_by_one[-1]
        asked = [n for n in range(len(states)) if n not in recorded]
        if recorded:
            one_by_one[0][: len(states)] = [one_by_one[0][each] for each in asked]
        assert tabulated[0] == one_by_one[0], (text, states, calls, recorded)
        used += tabulated[-1]
    # In about half of the cases, tables are used.
    assert used > CASES // 4


@pytest.mark.parametrize('look_ups', [True, False])
def test_the_node_limit_is_that_of_single_steps(
    look_ups: bool,  # noqa: FBT001
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if not look_ups:
        never(monkeypatch)
    group = FormulaGroup(FormulaLimits(node_limit=56))
    text = 'always[0, 9 ns] (p -> eventually[0, 5 ns] (q and always[0, 2 ns] (r or p)))'
    group.add_formula('it', text, every_state=True)
    group.begin({})
    random = Random(1)  # noqa: S311 - no secret
    for time in range(100):
        values = {name: random.random() < 0.7 for name in 'pqr'}
        if results := group.progress(time, values):
            break
    [result] = results
    assert time == 9
    assert "59 nodes, more than 56 (the limit 'node_limit'): " in str(result.error)


def test_look_ups_stop_for_the_cleanup(monkeypatch: pytest.MonkeyPatch) -> None:
    """Times are forgotten although most states are look-ups."""
    monkeypatch.setattr(standing_monitor, '_CLEANUP_STATES', 300)
    group = FormulaGroup()
    formula_id = group.add_formula('it', 'p -> eventually[0, 5 ns] q', every_state=True)
    group.begin({})
    monitor = group.standing.formulas[formula_id].monitor
    looked_up = 0
    for time in range(5000):
        assert not group.progress(time, {'p': time % 4 == 0, 'q': time % 4 == 2})
        looked_up += monitor._tabulated.is_active
        assert len(monitor._times.kept) < 400
    assert looked_up > 4000
    assert group.standing.summary(formula_id).counts.holds == 5000


def group_of(text: str, objects: Sequence[str] = ()) -> tuple[FormulaGroup, Any]:
    group = FormulaGroup()
    formula_id = group.add_formula('it', text, every_state=True)
    group.begin({'S': objects})
    return group, group.standing.formulas[formula_id].monitor


def test_invariants_are_looked_up() -> None:
    """States of a formula that no state leaves open need generated code alone."""
    group, monitor = group_of('p')
    for time in range(100):
        assert not group.progress(time, {'p': True})
        assert not group.standing.changed()
    assert monitor._tabulated.quick_step
    assert not group.progress(100, {'p': False})
    assert group.standing.changed() == [1]
    assert not group.progress(101, {'p': True})
    summary = group.standing.summary(1)
    assert (summary.counts.holds, summary.counts.fails) == (101, 1)
    [episode] = summary.latest_episodes
    assert (episode.begin, episode.end, episode.has_ended) == (100, 100, True)


def test_states_that_generated_code_took_are_dropped_but_counted() -> None:
    group, monitor = group_of('p -> eventually[0, 5 ns] q')
    states = 10 * joint_table.MAX_AGE
    for time in range(states):
        assert not group.progress(time, {'p': time % 4 == 0, 'q': time % 4 == 2})
    assert monitor._tabulated.quick_step
    assert monitor.states == states
    assert len(monitor._times.kept) <= joint_table.MAX_AGE + 1
    assert not group.progress(states, {'p': True, 'q': False})
    assert group.standing.summary(1).counts.undecided == 1
    for time in range(states + 1, states + 10):
        group.progress(time, {'p': False, 'q': False})
    [episode] = group.standing.summary(1).latest_episodes
    assert (episode.begin, episode.decided_at) == (states, states + 5)


def test_attempts_become_rare_if_look_ups_are_new(monkeypatch: pytest.MonkeyPatch) -> None:
    new = 0
    extend = joint_table.JointTable.extend

    def counted(table: Any, row: Any, symbol: int) -> Any:
        nonlocal new
        new += 1
        return extend(table, row, symbol)

    monkeypatch.setattr(joint_table.JointTable, 'extend', counted)
    monkeypatch.setattr(tabulated_starts, '_FEWEST_STATES', 64)
    monkeypatch.setattr(tabulated_starts, '_LOOK_UPS', 128)
    random = Random(5)  # noqa: S311 - no secret
    group, _ = group_of('p -> eventually[0, 50 ns] q')
    for time in range(30_000):
        assert not group.progress(time, {'p': random.random() < 0.5, 'q': time % 40 == 0})
    # Each of the attempts, four times as far apart as the one before, may learn 256.
    assert 256 <= new < 3000
