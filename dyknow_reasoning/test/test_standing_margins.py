"""Margins of formulas that are asked at every state, against their definition."""

from __future__ import annotations

from itertools import accumulate
from math import inf
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from margin_reference import Step, ended, least, margin
from reasoning_reference import COMPARISONS, begun, formulas

from dyknow_common import Margin
from dyknow_reasoning import FormulaGroup, standing
from dyknow_reasoning.language.formula import Comparison, Formula, PastFormula, walk
from dyknow_reasoning.language.terms import Feature, Number

S = 1_000_000_000

values = st.integers(-2, 2).map(float)
leaves = st.builds(
    Comparison, st.sampled_from(sorted(COMPARISONS)), st.just(Feature('x')), values.map(Number)
)
traces = st.lists(st.tuples(st.integers(1, 3), values), min_size=1, max_size=14)


def asked(text: str, domains: Any = None) -> tuple[FormulaGroup, int]:
    return begun(text, domains, margin=True, every_state=True)


def can_be_asked(formula: Formula, gaps: set[int]) -> bool:
    return not (gaps and any(isinstance(each, PastFormula) for each in walk(formula)))


def bounds(found: Margin | None) -> tuple[float, float]:
    assert found is not None
    return found.lower, found.upper


def check(formula: Formula, trace: list[tuple[int, float]], gaps: set[int]) -> None:
    """After each state, the margins are the least ones of evaluations from each state on."""
    group, formula_id = asked(str(formula))
    monitor = group.standing.formulas[formula_id].monitor
    steps: list[Step] = []
    starts: list[int] = []
    for number, (time, (_, x)) in enumerate(
        zip(accumulate(step for step, _ in trace), trace, strict=True)
    ):
        if number in gaps:
            group.gap()
            if steps and time - steps[-1][1] > 1:
                steps.append((int(steps[-1][1]) + 1, time - 1, None))
        starts.append(len(steps))
        steps.append((time, time, {'x': x}))
        assert not group.progress(time, {'x': x})
        known = [margin(formula, ended(steps), start) for start in starts]
        assert bounds(group.margin(formula_id)) == least(known)
        episodes = group.standing.summary(formula_id).latest_episodes
        failures = monitor.failures[-len(episodes) :] if episodes else []
        assert [bounds(each.worst) for each in episodes] == [
            least(known[each.run.first : each.run.last + 1]) for each in failures
        ]


@given(formulas(3, leaves), traces, st.sets(st.integers(1, 8), max_size=2))
def test_the_worst_margin_is_the_least_of_single_evaluations(
    formula: Formula, trace: list, gaps: set[int]
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(standing, '_CLEANUP_STATES', 2)
        gaps = gaps if can_be_asked(formula, gaps) else set()
        if can_be_asked(formula, gaps):
            check(formula, trace, gaps)


def test_the_worst_margin_of_an_episode_names_its_atom() -> None:
    group, formula_id = asked('forall u in UAV: Power[u] < 200', {'UAV': ['a', 'b']})
    for second, (first, other) in enumerate([(150, 190), (210, 230), (205, 190), (150, 190)]):
        group.progress(second * S, {'Power[a]': float(first), 'Power[b]': float(other)})
    [episode] = group.standing.summary(formula_id).latest_episodes
    assert (episode.states, episode.has_ended) == (2, True)
    assert episode.worst == Margin(-30.0, -30.0, atom='Power[b] < 200')
    assert group.margin(formula_id) == episode.worst


def test_the_worst_margin_is_known_after_the_verdict() -> None:
    group, formula_id = asked('always[0 s, 2 s] x < 5')
    worst = []
    for second, x in enumerate([6.0, 9.0, 4.0, 4.0]):
        group.progress(second * S, {'x': x})
        worst += [each.worst for each in group.standing.summary(formula_id).latest_episodes]
    assert worst == [
        Margin(-inf, -1.0, atom='x < 5'),
        Margin(-inf, -4.0, atom='x < 5'),
        Margin(-inf, -4.0, atom='x < 5'),
        Margin(-4.0, -4.0, atom='x < 5'),
    ]


def test_a_long_episode_takes_little_memory() -> None:
    group, formula_id = asked('x < 5')
    for number in range(20_000):
        group.progress(number, {'x': 6.0 + number % 7})
    margins: Any = group._margins.standing(formula_id)
    assert len(margins._runs) == 1
    [episode] = group.standing.summary(formula_id).latest_episodes
    assert episode.worst == Margin(-7.0, -7.0, atom='x < 5')
    for number in range(20_000, 40_000):
        group.progress(number, {'x': 5.0 - number % 2})
    assert len(margins._runs) < 5000


def test_without_a_request_there_are_no_margins() -> None:
    group, formula_id = begun('x < 5', every_state=True)
    group.progress(0, {'x': 6.0})
    assert group.margin(formula_id) is None
    assert group.standing.summary(formula_id).latest_episodes[0].worst is None
