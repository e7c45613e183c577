"""Open starts that rest until a failure, against starts that are progressed at each state."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from reasoning_reference import begun, formulas
from test_standing_monitor import NAMES, OBJECTS, can_be_asked, check, recordings

from dyknow_reasoning import FormulaGroup
from dyknow_reasoning.execution import StandingMonitor
from dyknow_reasoning.execution.automata import automaton, configurations
from dyknow_reasoning.execution.standing import quiet_starts, standing_monitor
from dyknow_reasoning.execution.standing.quiet_starts import QuietStarts
from dyknow_reasoning.explanation.remainders import text_of
from dyknow_reasoning.language.formula import Formula, walk
from dyknow_reasoning.progression.unknown_features import ANY_NUMBER, UnknownFeatures

SECOND = 10**9
NESTED = 'forall u in UAV: always[0 s, 2 s] eventually[0 s, 1 s] p[u]'
UAVS = [f'u{number}' for number in range(40)]


def is_bounded(formula: Formula) -> bool:
    intervals = (getattr(each, 'interval', None) for each in walk(formula))
    return all(interval is None or interval.end is not None for interval in intervals)


BOUNDED = formulas(3).filter(is_bounded)


@contextmanager
def resting(trial: int = 1000, steps: int = 16) -> Iterator[None]:
    """Let starts rest from the second state on, also of few objects."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ('_MIN_OBJECTS', '_PERIOD'):
            patch.setattr(quiet_starts, name, 1)
        for name in ('_VECTORS', '_CLOCKED_VECTORS'):
            patch.setattr(quiet_starts, name, 0)
        patch.setattr(quiet_starts, '_TRIAL', trial)
        patch.setattr(configurations, '_MAX_STEPS', steps)
        yield


@contextmanager
def never_resting() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(quiet_starts, '_MIN_OBJECTS', 1000)
        yield


@pytest.mark.parametrize('gaps', [False, True])
@given(BOUNDED, st.data())
def test_the_verdicts_are_those_of_single_evaluations(
    gaps: bool,  # noqa: FBT001
    formula: Formula,
    data: st.DataObject,
) -> None:
    states = data.draw(recordings(NAMES, data.draw(st.sampled_from([1, 3])), gaps=gaps))
    body = re.sub(r'\b([pq])\b', r'\1[x]', str(formula))
    if can_be_asked(formula, states):
        with resting(steps=data.draw(st.sampled_from([1, 16]))):
            check(f'forall x in S: {body}', {'S': OBJECTS}, states)


def seen(group: FormulaGroup, monitor: StandingMonitor, *, ask: bool) -> list[Any]:
    """All that can be known of a formula; counts and remainders only if they are asked for."""
    found: list[Any] = [monitor.failure_count, monitor.is_violated, group.standing.changed()]
    found += [(each.run, each.decided_at, each.values, each.has_ended) for each in monitor.failures]
    if ask:
        [number] = group.standing.formulas
        runs = monitor.undecided()
        ends = {end for run in runs[:2] for end in (run.first, run.last)}
        texts = [text_of(monitor.remainders(end), monitor._times.latest or 0) for end in ends]
        found += [group.standing.summary(number), group.margin(number), runs, texts]
    return found


@given(BOUNDED, st.data())
def test_rest_changes_nothing_that_is_seen(formula: Formula, data: st.DataObject) -> None:
    objects = [f'o{number}' for number in range(data.draw(st.sampled_from([1, 3, 30])))]
    states = data.draw(recordings([f'{name}[{each}]' for name in 'pq' for each in objects], 3))
    body = re.sub(r'\b([pq])\b', r'\1[x]', str(formula))
    margin = data.draw(st.booleans()) and not data.draw(st.integers(0, 3))
    asked = {'every_state': True, 'margin': margin}
    unknown = UnknownFeatures({'p': ANY_NUMBER} if data.draw(st.integers(0, 5)) == 0 else {})
    domains = {'S': objects}
    with never_resting():
        usual, number = begun(f'forall x in S: {body}', domains, unknown=unknown, **asked)
    with resting(data.draw(st.sampled_from([1, 4, 1000])), data.draw(st.sampled_from([1, 16]))):
        other, _ = begun(f'forall x in S: {body}', domains, unknown=unknown, **asked)
        monitors = [each.standing.formulas[number].monitor for each in (usual, other)]
        for index, (time, values, _) in enumerate(states):
            given_values: dict[str, Any] = dict(values)
            if unknown and index > 4:
                given_values['p[o0]'] = None
            ask = data.draw(st.integers(0, 3)) == 0
            found = []
            for group, monitor in zip((usual, other), monitors, strict=True):
                results = [str(each.error) for each in group.progress(time, given_values)]
                found.append((results, not results and seen(group, monitor, ask=ask)))
            assert found[0] == found[1]
            if found[0][0]:
                return


def quiet_of(group: FormulaGroup) -> QuietStarts:
    [formula] = group.standing.formulas.values()
    assert formula.monitor._quiet
    return formula.monitor._quiet


def pulses(states: int, late: Sequence[tuple[int, int]] = ()) -> Iterator[dict[str, bool]]:
    """States at which each object is true at every other one, but not at some."""
    for state in range(states):
        yield {
            f'p[u{each}]': (state + each) % 2 == 0 and (state, each) not in late
            for each in range(len(UAVS))
        }


@pytest.mark.parametrize('jitter', [0, 1000])
def test_only_an_object_that_fails_is_progressed(jitter: int) -> None:
    random = Random(1)  # noqa: S311 - no secret
    group, number = begun(NESTED, {'UAV': UAVS}, every_state=True)
    active = []
    for state, values in enumerate(pulses(300, late=[(200, 0)])):
        time = (state * SECOND) // 2 + random.randrange(jitter + 1)
        assert not group.progress(time, values)
        quiet = quiet_of(group)
        active.append(quiet.is_active)
        if 180 <= state < 198:
            assert not quiet._awake
        if state == 202:
            assert list(quiet._awake) == [0]
    assert all(active[20:])
    assert not quiet._awake
    assert quiet._template.uses_configurations == (jitter == 0)
    counts = group.standing.summary(number)
    [episode] = counts.latest_episodes
    assert (counts.fails, episode.objects) == (5, 'u = u0')


def test_memory_stays_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(standing_monitor, '_CLEANUP_STATES', 64)
    group, number = begun(NESTED, {'UAV': UAVS}, every_state=True)
    for state, values in enumerate(pulses(3000)):
        assert not group.progress(state * SECOND // 2, values)
    quiet = quiet_of(group)
    assert quiet.is_active
    assert len(quiet._symbols) < 100
    assert len(quiet._times.kept) < 200
    assert group.standing.summary(number).undecided == 5


def test_starts_do_not_rest_while_all_is_alike_or_fails() -> None:
    group, number = begun(NESTED, {'UAV': UAVS}, every_state=True)
    for state, values in enumerate(pulses(200)):
        group.progress(state * SECOND // 2, values)
    assert quiet_of(group).is_active
    for state in range(200, 400):
        group.progress(state * SECOND // 2, {f'p[{each}]': True for each in UAVS})
    assert not quiet_of(group).is_active
    random = Random(2)  # noqa: S311 - no secret
    rested = 0
    for state in range(400, 1000):
        group.progress(state * SECOND // 2, {f'p[{each}]': random.random() < 0.3 for each in UAVS})
        rested += quiet_of(group).is_active
    assert rested < 150
    assert group.standing.summary(number).fails > 500


@pytest.mark.parametrize(
    'body',
    [
        'always p[u]',
        'p[u] -> once[0 s, 1 s] eventually[0 s, 1 s] p[u]',
        'let v = a[u] in eventually[0 s, 1 s] a[u] < v',
        'always[0 s, 1 s] (' + ' or '.join(f'a[u] > {number}' for number in range(9)) + ' or p[u])',
    ],
)
def test_some_formulas_do_not_rest(body: str) -> None:
    """Those without a horizon, with memories, with kept values, or with many atoms."""
    group, number = begun(f'forall u in UAV: {body}', {'UAV': UAVS}, every_state=True)
    assert group.standing.formulas[number].monitor._quiet is None


def test_an_automaton_that_is_full_begins_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(automaton, '_MAX_NODES', 16)
    group, number = begun(NESTED, {'UAV': UAVS}, every_state=True)
    for state, values in enumerate(pulses(300, late=[(200, 0)])):
        assert not group.progress(state * SECOND // 2, values)
    assert group.standing.summary(number).fails == 5


@pytest.mark.parametrize('limit', ['_MAX_STATES', '_MAX_NODES'])
def test_starts_that_would_need_too_much_do_not_rest(
    limit: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(quiet_starts, limit, 3)
    group, _ = begun(NESTED, {'UAV': UAVS}, every_state=True)
    for state, values in enumerate(pulses(100)):
        assert not group.progress(state * SECOND // 2, values)
    assert not quiet_of(group).is_active


def test_times_that_fit_into_no_vector_end_the_rest() -> None:
    group, number = begun(NESTED, {'UAV': UAVS}, every_state=True)
    for state, values in enumerate(pulses(100)):
        assert not group.progress(state * SECOND // 2, values)
    assert quiet_of(group).is_active
    for state, values in enumerate(pulses(100)):
        group.progress(2**63 + state * SECOND // 2, values)
    assert not quiet_of(group).is_active
    assert group.standing.summary(number).fails == 5


def test_a_window_that_ends_between_two_states() -> None:
    """A replay takes the states up to one horizon before the latest state but one."""
    text = 'forall u in UAV: p[u] -> eventually[0 s, 1 s] q[u]'
    group, number = begun(text, {'UAV': UAVS}, every_state=True)
    for state in range(120):
        values = {}
        for index, each in enumerate(UAVS):
            is_late = index == 7 and state > 100
            values[f'p[{each}]'] = (index + state) % 2 == 0 and (not is_late or state == 101)
            values[f'q[{each}]'] = (index + state) % 2 == 1 and not is_late
        assert not group.progress(state * SECOND * 7 // 10, values)
        assert quiet_of(group).is_active == (state > 15)
    [episode] = group.standing.summary(number).latest_episodes
    assert (episode.states, episode.objects) == (1, 'u = u7')
    assert (episode.begin, episode.decided_at) == (101 * SECOND * 7 // 10, 103 * SECOND * 7 // 10)


def test_a_gap_ends_the_rest() -> None:
    found = []
    for objects in (1, 1000):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(quiet_starts, '_MIN_OBJECTS', objects)
            group, number = begun(NESTED, {'UAV': UAVS}, every_state=True)
        for state, values in enumerate(pulses(120, late=[(98, 0), (101, 3)])):
            if state == 100:
                group.gap()
            missing = 20 if state >= 100 else 0
            assert not group.progress((state + missing) * SECOND // 2, values)
        found.append(group.standing.summary(number))
    assert found[0] == found[1]
    assert found[0].unknown
