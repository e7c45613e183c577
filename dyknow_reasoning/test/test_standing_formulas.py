"""Formulas of a group that are asked at every state."""

from __future__ import annotations

from random import Random

import pytest
from reasoning_reference import begun as begun_over

from dyknow_reasoning import FormulaGroup, FormulaLimits
from dyknow_reasoning.execution.standing import standing_monitor

SECOND = 1_000_000_000
RESPONSE = 'alarm -> eventually[0 s, 2 s] stopped'


def begun(text: str, **domains: list[str]) -> tuple[FormulaGroup, int]:
    group, formula_id = begun_over(text, domains, every_state=True)
    assert bool(group.decided_at_once()) != bool(group.symbols())
    return group, formula_id


def test_an_invariant_is_violated_twice() -> None:
    group, formula_id = begun('forall u in UAV: Power[u] < 200', UAV=['a', 'b'])
    changes = []
    for second, power in enumerate([150.0, 210.0, 220.0, 150.0, 150.0, 201.5, 150.0]):
        assert not group.progress(second * SECOND, {'Power[a]': 100.0, 'Power[b]': power})
        if group.standing.changed():
            changes.append((second, group.presumably_false(formula_id)))
    assert changes == [(1, True), (3, False), (5, True), (6, False)]
    summary = group.standing.summary(formula_id)
    assert (summary.holds, summary.fails, summary.undecided) == (4, 3, 0)
    assert (summary.episode_count, summary.is_violated) == (2, False)
    first, second = summary.latest_episodes
    assert (first.begin, first.end, first.states) == (1 * SECOND, 2 * SECOND, 2)
    assert (second.begin, second.decided_at, second.has_ended) == (5 * SECOND, 5 * SECOND, True)
    assert second.explanation == 'for u = b: Power[b] = 201.5 at 5.000 s is not < 200'
    assert second.objects == 'u = b'


def test_a_response_that_comes_too_late() -> None:
    group, formula_id = begun(RESPONSE)
    for second in range(10):
        values = {'alarm': second in {1, 2, 7}, 'stopped': second in {4, 9}}
        assert not group.progress(second * SECOND, values)
        if second == 3:
            summary = group.standing.summary(formula_id)
            assert summary.undecided == 1
    summary = group.standing.summary(formula_id)
    assert (summary.holds, summary.fails, summary.undecided) == (9, 1, 0)
    assert group.residual(formula_id) == 'alarm -> (eventually[0 s, 2 s] stopped)'
    (episode,) = summary.latest_episodes
    assert (episode.begin, episode.decided_at) == (1 * SECOND, 3 * SECOND)
    assert episode.explanation == (
        "'stopped' held at no state in [1.000 s, 3.000 s]; stopped is false at 3.000 s"
    )


def test_an_unusable_value_fails_the_formula_as_a_whole() -> None:
    group, formula_id = begun('x < 5')
    assert not group.progress(1, {'x': 1.0})
    (result,) = group.progress(2, {'x': float('nan')})
    assert str(result.error).startswith("at 0.000 s: the field 'x' holds nan, not a number; ")
    assert not group.undecided
    assert not group.progress(3, {'x': 1.0})
    assert group.standing.summary(formula_id).holds == 0


def test_states_must_come_in_order() -> None:
    group, _ = begun('x < 5')
    assert not group.progress(2, {'x': 1.0})
    (result,) = group.progress(2, {'x': 1.0})
    assert 'not later' in str(result.error)


def test_formulas_of_both_kinds_share_a_group() -> None:
    group, formula_id = begun('p')
    once = group.add_formula('once', 'always p')
    for time in range(1, 30):
        assert not group.progress(time, {'p': True})
    (result,) = group.progress(30, {'p': False})
    assert result.formula_id == once
    for time in range(31, 60):
        assert not group.progress(time, {'p': True})
    counts = group.standing.summary(formula_id)
    assert (counts.holds, counts.fails) == (58, 1)
    group.remove_formula(formula_id)
    assert not group.standing.formulas


def test_an_episode_that_grows_is_not_reported_again() -> None:
    """The last state decides itself for a, and the state before for b."""
    group, formula_id = begun('forall u in UAV: q[u] and eventually[0, 2 ns] p[u]', UAV=['a', 'b'])
    reported = []
    for time, q in ((0, False), (1, True), (5, False)):
        assert not group.progress(time, {'p[a]': True, 'q[a]': q, 'p[b]': False, 'q[b]': True})
        reported.append(group.standing.changed())
    assert reported == [[formula_id], [], []]
    (episode,) = group.standing.summary(formula_id).latest_episodes
    assert (episode.begin, episode.end, episode.decided_at) == (0, 5, 0)


def test_what_needs_no_state_has_a_verdict_at_each() -> None:
    group, formula_id = begun('forall u in UAV: p[u]', UAV=[])
    for time in range(3):
        assert not group.progress(time, {})
    assert group.standing.summary(formula_id).holds == 3
    group, formula_id = begun('1 > 2')
    for time in range(3):
        assert not group.progress(time, {})
    summary = group.standing.summary(formula_id)
    assert summary.fails == 3
    assert summary.latest_episodes[0].explanation == 'it is false, whatever the states are'


def test_unknown_starts_are_counted_and_not_violated() -> None:
    group, formula_id = begun('always[0 s, 2 s] p')
    for second in range(3):
        assert not group.progress(second * SECOND, {'p': True})
    group.gap()
    for second in range(10, 15):
        assert not group.progress(second * SECOND, {'p': True})
    counts = group.standing.summary(formula_id)
    assert (counts.holds, counts.unknown, counts.undecided, counts.fails) == (4, 2, 2, 0)


def test_memory_stays_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Over many states, what is kept does not grow, and the counts stay exact."""
    monkeypatch.setattr(standing_monitor, '_CLEANUP_STATES', 64)
    group, formula_id = begun('p -> eventually[0 s, 3 s] q')
    monitor = group.standing.formulas[formula_id].monitor
    for second in range(5000):
        group.progress(second * SECOND, {'p': second % 3 == 0, 'q': second % 7 == 0})
        assert len(monitor.failures) < 100
        assert len(monitor._times.kept) < 200
    counts = group.standing.summary(formula_id)
    assert counts.holds + counts.fails + counts.undecided == 5000
    fails = [s for s in range(0, 4996, 3) if not any(t % 7 == 0 for t in range(s, s + 4))]
    assert counts.fails == len(fails) == monitor.failure_count


@pytest.mark.parametrize('objects', [1, 20])
@pytest.mark.parametrize('truth', [True, False])
@pytest.mark.parametrize('step', [1, 2])
def test_memory_stays_bounded_while_states_are_alike(
    objects: int,
    truth: bool,  # noqa: FBT001
    step: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(standing_monitor, '_CLEANUP_STATES', 64)
    group, formula_id = begun('forall u in UAV: p[u]', UAV=[f'u{i}' for i in range(objects)])
    monitor = group.standing.formulas[formula_id].monitor
    values = {f'p[u{i}]': truth for i in range(objects)}
    for number in range(1000):
        assert not group.progress(step * number + number % step, values)
    assert len(monitor._times.kept) < 100
    counts = group.standing.summary(formula_id)
    assert (counts.holds, counts.fails) == ((1000, 0) if truth else (0, 1000))


def test_unusable_values_after_states_that_are_alike() -> None:
    group, _ = begun('always[0 s, 2 s] p')
    for second in (0, 1, 3, 4, 7):
        assert not group.progress(second * SECOND, {'p': True})
    (result,) = group.progress(8 * SECOND, {'p': 'text'})
    assert result.error
    assert not group.standing.formulas


def test_too_many_runs_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(standing_monitor, '_CLEANUP_STATES', 64)
    monkeypatch.setattr(standing_monitor, 'MAX_RUNS', 100)
    group, _ = begun('p -> eventually q')
    for time in range(2000):
        results = group.progress(time, {'p': time % 2 == 0, 'q': False})
        if results:
            break
    (result,) = results
    assert 'more than 100' in str(result.error)
    assert 'give its operators shorter intervals' in str(result.error)


def test_the_node_limit_is_that_of_single_evaluations() -> None:
    text = 'always[0, 9 ns] (p -> eventually[0, 5 ns] (q and always[0, 2 ns] (r or p)))'
    group, _ = begun_over(text, limits=FormulaLimits(node_limit=56), every_state=True)
    random = Random(1)  # noqa: S311 - no secret
    for time in range(100):
        values = {name: random.random() < 0.7 for name in 'pqr'}
        if results := group.progress(time, values):
            break
    [result] = results
    assert time == 9
    assert "59 nodes, more than 56 (the limit 'node_limit'): " in str(result.error)


def test_operators_of_the_past_look_back_to_all_states() -> None:
    group, formula_id = begun('alarm -> once[0 s, 2 s] armed')
    for second in range(8):
        values = {'alarm': second in {3, 6}, 'armed': second == 2}
        assert not group.progress(second * SECOND, values)
    (episode,) = group.standing.summary(formula_id).latest_episodes
    assert (episode.begin, episode.states) == (6 * SECOND, 1)


@pytest.mark.parametrize('past', ['armed', 'eventually[0 s, 1 s] armed'])
def test_the_past_of_missing_states_ends_a_standing_monitor(past: str) -> None:
    group, _ = begun(f'alarm -> once[0 s, 2 s] {past}')
    group.progress(0, {'alarm': False, 'armed': True})
    group.gap()
    (result,) = group.progress(SECOND, {'alarm': True, 'armed': False})
    assert 'operators of the past look back on states that are missing' in str(result.error)
    assert not group.undecided
