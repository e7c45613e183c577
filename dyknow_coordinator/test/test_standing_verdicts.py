"""Verdicts on a formula that is asked at every state, for people."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import Verdict
from dyknow_coordinator import (
    EvaluationPhase,
    EvaluationStatus,
    Level,
    Progress,
    StandingVerdicts,
    ViolationEpisode,
    diagnose,
)
from dyknow_coordinator.reporting.evaluation_status import details, outcome
from dyknow_coordinator.reporting.evaluation_table import as_json

SECOND = 1_000_000_000
CALM = StandingVerdicts(holds=3)
FIRST = ViolationEpisode(4 * SECOND, 4 * SECOND, 5 * SECOND, 1, has_ended=False, explanation='31 m')
VIOLATED = StandingVerdicts(3, 1, 2, 0, True, 1, (FIRST,))
CLEARED = StandingVerdicts(6, 1, 0, 0, False, 1, (replace(FIRST, has_ended=True),))
AGAIN = replace(
    VIOLATED,
    fails=3,
    episode_count=3,
    latest_episodes=(FIRST, FIRST, replace(FIRST, begin=9 * SECOND, explanation='32 m')),
)
STATUS = EvaluationStatus(
    'ceiling',
    'Altitude[uav1] < 30',
    EvaluationPhase.RUNNING,
    started=0,
    latest_valid_time=9 * SECOND,
    episodes=CALM,
)


@pytest.mark.parametrize(
    ('verdicts', 'verdict', 'text'),
    [
        (StandingVerdicts(), Verdict.UNDECIDED, 'holds from 0 of 0 states'),
        (StandingVerdicts(holds=1), Verdict.TRUE, 'holds from 1 of 1 state'),
        (
            StandingVerdicts(1, undecided=1),
            Verdict.UNDECIDED,
            'holds from 1 of 2 states, undecided from 1',
        ),
        (
            StandingVerdicts(1, unknown=2),
            Verdict.UNDECIDED,
            'holds from 1 of 3 states, unknown from 2',
        ),
        (
            VIOLATED,
            Verdict.FALSE,
            'holds from 3 of 6 states, fails from 1 in 1 episode, undecided from 2',
        ),
    ],
)
def test_the_verdict_and_the_counts(
    verdicts: StandingVerdicts, verdict: Verdict, text: str
) -> None:
    assert (verdicts.verdict, verdicts.text) == (verdict, text)


@pytest.mark.parametrize(
    ('before', 'after', 'text'),
    [
        (CALM, replace(CALM, holds=9), ''),
        (CALM, VIOLATED, 'violated from 4.000 s on: 31 m'),
        (VIOLATED, replace(VIOLATED, fails=2), ''),
        (VIOLATED, CLEARED, 'holds again, after it was false from 4.000 s to 4.000 s: 31 m'),
        # It began and ended between two reports.
        (CALM, CLEARED, 'holds again, after it was false from 4.000 s to 4.000 s: 31 m'),
        (CLEARED, AGAIN, 'violated from 9.000 s on (2 episodes since the last report): 32 m'),
        # The state between two episodes turned out to be false, too.
        (AGAIN, replace(AGAIN, episode_count=2), ''),
    ],
)
def test_what_has_happened(before: StandingVerdicts, after: StandingVerdicts, text: str) -> None:
    assert after.change(before) == text


def test_diagnosis() -> None:
    def found(verdicts: StandingVerdicts) -> tuple[Level, str]:
        diagnosis = diagnose(replace(STATUS, episodes=verdicts), 9 * SECOND, 5 * SECOND)
        return diagnosis.level, diagnosis.text

    assert found(CALM) == (Level.OK, 'holds from 3 of 3 states')
    assert found(VIOLATED) == (Level.ERROR, 'violated: 31 m')
    # No more states come.
    waiting = replace(
        STATUS, phase=EvaluationPhase.WAITING, episodes=VIOLATED, waits_for='nobody publishes /a'
    )
    silent = diagnose(waiting, 9 * SECOND, 5 * SECOND)
    assert (silent.level, silent.text) == (Level.ERROR, 'violated: 31 m; nobody publishes /a')
    assert outcome(waiting) == 'violated'
    assert outcome(replace(waiting, episodes=CALM)) == 'waiting'
    assert found(CLEARED) == (Level.OK, 'holds from 6 of 7 states, fails from 1 in 1 episode')


def test_no_state_is_known_before_its_verdict() -> None:
    """The engine reports both in two messages."""
    progress = Progress(3, 5, 'p')
    assert progress.with_episodes(None) == progress
    assert progress.with_episodes(StandingVerdicts()) == Progress(episodes=StandingVerdicts())
    assert progress.with_episodes(CALM) == replace(progress, episodes=CALM)


@pytest.mark.parametrize('states', [0, 1])
def test_what_peers_leave_of_a_formula_is_not_false_before_they_tell(states: int) -> None:
    found = Progress(states, presumably_false=True).of_remainder()
    assert found.presumably_false is (states > 0)


def test_the_status() -> None:
    assert outcome(STATUS) == 'running'
    assert outcome(replace(STATUS, episodes=VIOLATED)) == 'violated'
    assert dict(details(STATUS))['every state'] == 'holds from 3 of 3 states'
    assert 'every state' not in dict(details(replace(STATUS, episodes=None)))
    document = json.loads(json.dumps(as_json(replace(STATUS, episodes=VIOLATED))))
    assert document['episodes']['latest_episodes'][0]['states'] == 1


@given(st.lists(st.lists(st.booleans(), max_size=4), max_size=6))
def test_the_changes_are_all_begins_and_ends(reports: list[list[bool]]) -> None:
    """Each report adds states from which the formula fails (True) or holds."""
    before, states, found = StandingVerdicts(), list[bool](), list[tuple[int, bool]]()
    for report in reports:
        states += report
        after = verdicts_of(states)
        found += [(each.begin, has_ended) for each, has_ended in after.changes(before)]
        before = after
    assert found == [
        (max(n for n in range(time + 1) if is_begin(states, n)), not fails)
        for time, fails in enumerate(states)
        if fails != (time > 0 and states[time - 1])
    ]


def is_begin(states: list[bool], time: int) -> bool:
    return states[time] and not (time and states[time - 1])


def verdicts_of(states: list[bool]) -> StandingVerdicts:
    begins = [time for time in range(len(states)) if is_begin(states, time)]
    episodes = tuple(
        ViolationEpisode(begin, begin, begin, 1, has_ended=False in states[begin:], explanation='')
        for begin in begins
    )
    fails = sum(states)
    is_violated = bool(states) and states[-1]
    return StandingVerdicts(
        len(states) - fails, fails, 0, 0, is_violated, len(episodes), episodes[-10:]
    )


def test_a_restarted_formula_counts_its_episodes_anew() -> None:
    ((episode, has_ended),) = VIOLATED.changes(AGAIN)
    assert (episode, has_ended) == (FIRST, False)


def test_a_first_episode_after_a_restart_is_a_new_one() -> None:
    """No report may have come in between."""
    later = replace(FIRST, begin=20 * SECOND, end=20 * SECOND)
    restarted = replace(VIOLATED, latest_episodes=(later,))
    assert list(restarted.changes(VIOLATED)) == [(later, False)]
    assert list(restarted.changes(restarted)) == []


def test_an_episode_ends_when_the_restarted_formula_holds() -> None:
    assert list(StandingVerdicts(undecided=1).changes(VIOLATED)) == []
    assert list(CALM.changes(VIOLATED)) == [(VIOLATED.latest_episodes[-1], True)]
    assert list(CALM.changes(CLEARED)) == []
