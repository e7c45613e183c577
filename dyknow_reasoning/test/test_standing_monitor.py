"""Formulas asked at every state, against single evaluations that begin at each state."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reasoning_reference import begun, formulas, progressed, started, with_history

from dyknow_common import Verdict
from dyknow_reasoning import FormulaGroup
from dyknow_reasoning.execution import StandingMonitor
from dyknow_reasoning.language.formula import Formula, PastFormula, walk
from dyknow_reasoning.language.parsing import parse_formula
from dyknow_reasoning.progression.atoms import MAX_GENERATED

Domains = Mapping[str, Sequence[str]]
OBJECTS = ('a', 'b', 'c')

States = Sequence[tuple[int, dict[str, bool], bool]]
"""Valid time, values, and True for a gap before the state."""


def group_of(text: str, domains: Domains) -> tuple[FormulaGroup, StandingMonitor]:
    group, formula_id = begun(text, domains, every_state=True)
    return group, group.standing.formulas[formula_id].monitor


def looks_back(formula: Formula) -> bool:
    return any(isinstance(each, PastFormula) for each in walk(formula))


def can_be_asked(formula: Formula, states: States) -> bool:
    """False for what ends with an error: the past of missing states."""
    return not (looks_back(formula) and any(is_gap for _, _, is_gap in states))


Outcome = tuple[Verdict | None, int] | None
"""The verdict, None if it depends on missing states, and when that was known."""


def outcomes(text: str, domains: Domains, states: States) -> list[Outcome]:
    """Evaluate from each state on; operators of the past look back to all states."""
    found: list[Outcome] = []
    is_past = looks_back(parse_formula(text))
    for start, (begin, _, _) in enumerate(states):
        group = with_history(text, domains) if is_past else started(domains=domains)
        if is_past:
            progressed(group, [(time, values) for time, values, _ in states[:start]])
        group.add_formula('it', text)
        outcome: Outcome = None
        for time, values, is_gap in states[start:]:
            if is_gap and time != begin:
                group.gap()
            for result in group.progress(time, values):
                outcome = None if result.error else result.verdict, result.decided_at or time
            if outcome:
                break
        found.append(outcome)
    return found


def check(text: str, domains: Domains, states: States) -> None:
    """After each state, the verdicts agree with single evaluations."""
    group, monitor = group_of(text, domains)
    final = outcomes(text, domains, states)
    for number, (time, values, is_gap) in enumerate(states):
        if is_gap:
            group.gap()
        assert not group.progress(time, values)
        known = [each if each and each[1] <= time else None for each in final[: number + 1]]
        verdicts = [each and (each[0] or Verdict.UNDECIDED) for each in known]
        case = (text, states[: number + 1], known)
        fails = [index for index, each in enumerate(verdicts) if each is Verdict.FALSE]
        runs = [(each.run.first, each.run.last) for each in monitor.failures]
        assert runs == runs_of(fails), case
        for each in monitor.failures:
            first, last = each.run.first, each.run.last
            outcome = known[first]
            assert outcome, case
            assert each.decided_at == outcome[1], case
            assert (each.run.begin, each.run.end) == (states[first][0], states[last][0]), case
            after = [
                verdict for verdict in verdicts[last + 1 :] if verdict is not Verdict.UNDECIDED
            ]
            after = [verdict for verdict in after if verdict is not Verdict.FALSE]
            assert each.has_ended == (after[:1] == [Verdict.TRUE]), case
        counts = monitor.counts()
        assert counts.fails == len(fails), case
        if len(domains.get('S', OBJECTS)) == len(OBJECTS) and len(domains):
            continue  # Of many objects, one that is unknown may be told before the others.
        assert counts.undecided == verdicts.count(None), case
        assert counts.unknown == verdicts.count(Verdict.UNDECIDED), case
        assert counts.holds == verdicts.count(Verdict.TRUE), case


def runs_of(numbers: Sequence[int]) -> list[tuple[int, int]]:
    found: list[tuple[int, int]] = []
    for each in numbers:
        if found and found[-1][1] == each - 1:
            found[-1] = found[-1][0], each
        else:
            found.append((each, each))
    return found


@st.composite
def recordings(
    draw: st.DrawFn, names: Sequence[str], most_step: int, *, gaps: bool = False
) -> States:
    """States that often repeat the one before, so that they join without a step."""
    found = []
    values = {name: draw(st.booleans()) for name in names}
    time = 0
    for _ in range(draw(st.integers(1, 16))):
        if draw(st.integers(0, 2)) == 0:
            values = values | {draw(st.sampled_from(names)): draw(st.booleans())}
        time += draw(st.integers(1, most_step))
        found.append((time, values, gaps and draw(st.integers(0, 5)) == 0))
    return found


@pytest.mark.parametrize('most_step', [1, 4])
@pytest.mark.parametrize('gaps', [False, True])
@given(formulas(3), st.data())
def test_the_verdicts_are_those_of_single_evaluations(
    most_step: int,
    gaps: bool,  # noqa: FBT001
    formula: Formula,
    data: st.DataObject,
) -> None:
    states = data.draw(recordings('pq', most_step, gaps=gaps))
    if can_be_asked(formula, states):
        check(str(formula), {}, states)


NAMES = [f'{name}[{each}]' for name in 'pq' for each in OBJECTS]


@pytest.mark.parametrize('gaps', [False, True])
@given(formulas(3), st.data())
def test_many_objects(gaps: bool, formula: Formula, data: st.DataObject) -> None:  # noqa: FBT001
    states = data.draw(recordings(NAMES, 3, gaps=gaps))
    body = re.sub(r'\b([pq])\b', r'\1[x]', str(formula))
    if can_be_asked(formula, states):
        check(f'forall x in S: {body}', {'S': OBJECTS}, states)


@pytest.mark.parametrize(
    ('text', 'steps'),
    [
        # It becomes true from the first state on while others move to the same group.
        ('always[2 ns, 4 ns] p', [1, 2, 3, 5]),
        ('always[0, 4 ns] p', [1, 2, 3, 5, 6, 7, 8, 9, 10]),
        # The age at which the verdict changes is reached exactly, and passed.
        ('eventually[0, 4 ns] q', [0, 1, 4, 5, 9, 10]),
        ('eventually[0, 4 ns] q', [0, 3, 5, 6, 11]),
    ],
)
def test_states_that_are_all_alike(text: str, steps: Sequence[int]) -> None:
    check(text, {}, [(time, {'p': True, 'q': False}, False) for time in steps])


def test_a_false_state_does_not_end_the_episode_before_it() -> None:
    """Between two episodes there may be unknown states only."""
    values = {f'{name}[{each}]': False for name in 'pq' for each in OBJECTS}
    states = [(time, values, True) for time in (1, 2, 3, 4, 5, 7, 8)]
    check('forall x in S: p[x] until p[x]', {'S': OBJECTS}, states)


@pytest.mark.parametrize('count', [1, 3, MAX_GENERATED // 2 + 1])
@given(st.data())
def test_values_of_several_types(count: int, data: st.DataObject) -> None:
    """All objects are read at once; a value that is no number ends the formula."""
    numbers = st.sampled_from([1, 3, 1.5, 3.5, np.float64(2.5), 10**400, inf])
    unusable = st.sampled_from(['3', nan, None, True, np.int8(3)])
    names = [f'x{number}' for number in range(count)]
    text = 'forall x in S: A[x] > 2 -> eventually[0, 1 ns] A[x] < 3'
    group, monitor = group_of(text, {'S': names})
    single, fails = FormulaGroup(), 0
    single.begin({'S': names})
    for time in range(3):
        values = dict.fromkeys((f'A[{name}]' for name in names), 1)
        values[f'A[{names[-1]}]'] = data.draw(st.one_of(numbers, numbers, unusable))
        single.add_formula('it', text)
        expected, found = single.progress(time, values), group.progress(time, values)
        if any(each.error for each in expected):
            assert [str(each.error) for each in found] == [str(expected[0].error)]
            return
        fails += [each.verdict for each in expected].count(Verdict.FALSE)
        assert not found
        assert monitor.counts().fails == fails
