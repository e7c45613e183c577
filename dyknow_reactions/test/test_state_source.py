"""Which states a guard reads, according to the reports of the coordinator."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dyknow_common import DyKnowError
from dyknow_coordinator import EvaluationPhase, EvaluationStatus
from dyknow_reactions.guard.state_source import StateSource, latest_source, why_unusable

FORMULA = 'Power[uav1] < 150.0'
FORMER = EvaluationStatus('/guard: power', FORMULA, EvaluationPhase.RUNNING, 1, state_stream='s1')
OWN = replace(FORMER, phase=EvaluationPhase.GROUNDING, started=2, state_stream='')
USED = StateSource(1, 0, 's1', FORMULA)


def test_the_latest_evaluation_with_states_is_used() -> None:
    assert latest_source([]) is None
    assert latest_source([OWN]) is None
    assert latest_source([FORMER, OWN]) == USED
    running = replace(OWN, phase=EvaluationPhase.WAITING, state_stream='s2')
    assert latest_source([running, FORMER]) == StateSource(2, 0, 's2', FORMULA)
    assert latest_source([replace(FORMER, phase=EvaluationPhase.INTERRUPTED)]) is None


@pytest.mark.parametrize('phase', ['RUNNING', 'WAITING', 'GROUNDING'])
def test_states_are_used_while_their_evaluation_goes_on(phase: str) -> None:
    """Also while it continues with a better stream."""
    reported = replace(FORMER, phase=EvaluationPhase[phase], state_stream='s3')
    assert not why_unusable(USED, [reported, OWN])


def test_states_are_not_used_after_a_fault_that_only_the_coordinator_has_told() -> None:
    """Their violation was published on a topic that is gone."""
    error = DyKnowError('sample_period is 200 ms')
    ended = replace(FORMER, phase=EvaluationPhase.ENDED, error=error)
    running = replace(OWN, phase=EvaluationPhase.RUNNING, state_stream='s2')
    assert 'sample_period is 200 ms' in why_unusable(USED, [ended, running])
    assert 'true' in why_unusable(USED, [replace(ended, error=None, explanation='it is true')])
    assert 'have failed' in why_unusable(USED, [replace(FORMER, phase=EvaluationPhase.INTERRUPTED)])
    assert 'no more' in why_unusable(USED, [running])


@pytest.mark.parametrize('phase', ['RUNNING', 'WAITING', 'GROUNDING'])
def test_states_are_not_used_once_their_evaluation_begins_again_with_other_objects(
    phase: str,
) -> None:
    restarted = replace(FORMER, phase=EvaluationPhase[phase], formula_group_id=7, state_stream='s2')
    assert why_unusable(USED, [restarted]) == 'its objects have changed'


def test_evaluations_that_have_begun_at_the_same_time_are_told_apart() -> None:
    """Simulated time may stand still; an evaluation that has ended is in no group any more."""
    used, other = StateSource(5, 1, 's1', FORMULA), StateSource(5, 2, 's2', FORMULA)
    first = replace(FORMER, started=5, formula_group_id=1)
    second = replace(first, formula_group_id=2, state_stream='s2')
    assert latest_source([first, second]) == other
    interrupted = replace(second, phase=EvaluationPhase.INTERRUPTED)
    assert 'have failed' in why_unusable(other, [first, interrupted])
    assert not why_unusable(used, [interrupted, first])
    ended = replace(
        second, phase=EvaluationPhase.ENDED, formula_group_id=0, explanation='it is true'
    )
    assert not why_unusable(used, [ended, first])
    assert 'it is true' in why_unusable(other, [ended])
