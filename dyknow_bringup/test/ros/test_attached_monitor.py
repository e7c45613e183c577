"""What `dyknow monitor` shows of formulas that another monitor evaluates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

import pytest
import rclpy

from dyknow_bringup.monitored_formula import HOLDS, UNDECIDED, VIOLATED, WAITING, MonitoredFormula
from dyknow_bringup.ros.formula_monitor import MonitorNode
from dyknow_bringup.ros.monitor import _progress
from dyknow_common import Margin, ProbabilityInterval
from dyknow_configuration import RequestedFormula
from dyknow_coordinator import EvaluationPhase, EvaluationStatus, Progress, StandingVerdicts


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
