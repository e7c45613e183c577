"""What `dyknow monitor` shows of formulas that another monitor evaluates."""

from __future__ import annotations

from dataclasses import fields

from dyknow_bringup.ros.monitor import _progress
from dyknow_common import Margin, ProbabilityInterval
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
