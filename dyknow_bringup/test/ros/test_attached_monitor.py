"""What `dyknow monitor` shows of formulas that another monitor evaluates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace

import pytest
import rclpy

from dyknow_bringup.monitored_formula import (
    HOLDS,
    NOT_CONNECTED,
    UNDECIDED,
    VIOLATED,
    WAITING,
    MonitoredFormula,
)
from dyknow_bringup.ros.formula_monitor import MonitorNode
from dyknow_bringup.ros.monitor import AttachedMonitor, _progress
from dyknow_common import SECOND_NS, Margin, ProbabilityInterval, Verdict
from dyknow_configuration import RequestedFormula
from dyknow_coordinator import (
    Answer,
    EvaluationPhase,
    EvaluationStatus,
    Progress,
    StandingVerdicts,
    ViolationEpisode,
)


def test_all_that_is_reported_of_the_progress_is_shown() -> None:
    reported = {
        'states_progressed': 3,
        'latest_valid_time': 5,
        'residual_formula': 'always p',
        'presumably_false': True,
        'waits_for': 'the topic /x is silent',
        'margin': Margin(1.0, 2.0),
        'probability': ProbabilityInterval(0.25, 0.5, ''),
        'episodes': StandingVerdicts(holds=3),
    }
    known = {each.name for each in fields(EvaluationStatus)}
    assert known & {each.name for each in fields(Progress)} == {*reported, 'events'}
    status = EvaluationStatus('it', 'always p', EvaluationPhase.RUNNING, started=1, **reported)
    assert _progress(status) == Progress(**reported)


@pytest.fixture
def node() -> Iterator[MonitorNode]:
    rclpy.init()
    made = MonitorNode('dyknow_monitor', lambda _: None)
    yield made
    made.destroy_node()
    rclpy.shutdown()


@pytest.mark.parametrize(
    ('verdicts', 'outcome', 'silent'),
    [
        (None, UNDECIDED, WAITING),
        (StandingVerdicts(holds=3), HOLDS, WAITING),
        (StandingVerdicts(), UNDECIDED, WAITING),
        # An alarm stays until a state shows that the formula holds again.
        (StandingVerdicts(holds=2, fails=1, is_violated=True), VIOLATED, VIOLATED),
    ],
)
def test_what_held_at_the_last_state_is_not_said_of_a_silence(
    node: MonitorNode, verdicts: StandingVerdicts | None, outcome: str, silent: str
) -> None:
    calm = MonitoredFormula(RequestedFormula('p', every_state=verdicts is not None))
    reason = 'nobody publishes /a any more'
    outcomes = []
    for waits_for in ('', reason, ''):
        node.note_progress(calm, Progress(3, 5, 'p', waits_for=waits_for, episodes=verdicts))
        outcomes.append((calm.outcome, calm.waits_for))
    assert outcomes == [(outcome, ''), (silent, reason), (outcome, '')]


@pytest.mark.parametrize(
    ('verdicts', 'phase', 'states', 'expected'),
    [
        (StandingVerdicts(holds=3), EvaluationPhase.RUNNING, 3, NOT_CONNECTED),
        (StandingVerdicts(holds=4), EvaluationPhase.RUNNING, 4, HOLDS),
        (StandingVerdicts(holds=3), EvaluationPhase.WAITING, 3, WAITING),
        (StandingVerdicts(2, 1, is_violated=True), EvaluationPhase.RUNNING, 3, VIOLATED),
        (None, EvaluationPhase.RUNNING, 3, NOT_CONNECTED),
        (None, EvaluationPhase.RUNNING, 4, UNDECIDED),
    ],
)
def test_a_stopped_system_that_continues_has_no_verdict_before_its_next_state(
    verdicts: StandingVerdicts | None, phase: EvaluationPhase, states: int, expected: str
) -> None:
    rclpy.init()
    requested = RequestedFormula('p', every_state=verdicts is not None)
    node = AttachedMonitor([requested], lambda _: None, name='dyknow_monitor')
    (formula,) = node.formulas
    before = None if verdicts is None else StandingVerdicts(holds=3)
    status = EvaluationStatus(
        'p', 'p', EvaluationPhase.RUNNING, started=1, states_progressed=2, episodes=before
    )
    later = replace(
        status,
        phase=phase,
        states_progressed=states,
        episodes=verdicts,
        waits_for='/a' if phase is EvaluationPhase.WAITING else '',
    )
    node._follow_evaluation(formula, status)
    node._on_lost()
    assert formula.outcome == NOT_CONNECTED
    # A few states had come since the report before the loss.
    for each in (replace(status, states_progressed=3), later, later):
        node._follow_evaluation(formula, each)
    node.destroy_node()
    rclpy.shutdown()
    assert formula.outcome == expected


S = SECOND_NS
EPISODES = (
    ViolationEpisode(7 * S, 8 * S, 9 * S, 3, has_ended=True, explanation='a'),
    ViolationEpisode(20 * S, 30 * S, 21 * S, 11, has_ended=False, explanation='b'),
)


@pytest.mark.parametrize('has_ended', [False, True])
def test_episodes_of_before_have_the_times_at_which_they_were(has_ended: bool) -> None:  # noqa: FBT001
    verdicts = StandingVerdicts(3, 14, is_violated=True, episode_count=2, latest_episodes=EPISODES)
    seen: list[tuple[str, int | None]] = []
    rclpy.init()
    node = MonitorNode('dyknow_monitor', lambda each: seen.append((each.outcome, each.known_at)))
    formula = MonitoredFormula(RequestedFormula('p', every_state=True), WAITING)
    if has_ended:
        answer = Answer(Verdict.FALSE, 31 * S, 'p', 'c', episodes=verdicts)
        node.note_answer(formula, answer, is_past=True)
    else:
        node.note_progress(formula, Progress(17, 30 * S, 'p', episodes=verdicts), is_past=True)
    begin = node.now()
    later = StandingVerdicts(
        3, 14, episode_count=2, latest_episodes=(EPISODES[0], replace(EPISODES[1], has_ended=True))
    )
    if not has_ended:
        node.note_progress(formula, Progress(18, 31 * S, 'p', episodes=later))
        outcome, known_at = seen.pop()
        assert (outcome, (known_at or 0) // S) == (HOLDS, begin // S)
    node.destroy_node()
    rclpy.shutdown()
    expected = [(VIOLATED, 9 * S), (HOLDS, 9 * S), (VIOLATED, 21 * S)]
    assert seen == ([*expected, ('false', 31 * S)] if has_ended else expected)
