"""The life of an evaluation: its first end is the one that counts."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from dyknow_common import BlackBoxOptions, ExitCode, Verdict
from dyknow_coordinator import Answer, CoordinationError, EvaluationPhase
from dyknow_coordinator.evaluation import Evaluation, EvaluationRequest, is_superseded


@pytest.fixture
def answers() -> list[Answer]:
    return []


@pytest.fixture
def evaluation(answers: list[Answer]) -> Evaluation:
    return Evaluation(answers.append)


def test_a_verdict_ends_it(evaluation: Evaluation, answers: list[Answer]) -> None:
    evaluation.set_phase(EvaluationPhase.RUNNING)
    evaluation.decide(Verdict.FALSE, 7, 'p = false')
    assert answers == [Answer(Verdict.FALSE, 7, explanation='p = false')]
    assert evaluation.phase is EvaluationPhase.ENDED


LATE = CoordinationError("stream 's' late", ExitCode.CONSTRAINT_VIOLATION)

ENDS: list[tuple[Callable[[Evaluation], None], ExitCode, str]] = [
    (lambda e: e.fail(LATE), ExitCode.CONSTRAINT_VIOLATION, "stream 's' late"),
    (
        lambda e: e.fail_unavailable('node x'),
        ExitCode.UNAVAILABLE,
        'node x is gone; the formula was',
    ),
    (lambda e: e.expire(2.5), ExitCode.TIMEOUT, 'no verdict within 2.5 s'),
    (lambda e: e.cancel(), ExitCode.CANCELLED, 'cancelled by the caller'),
]


@pytest.mark.parametrize(('end', 'code', 'message'), ENDS)
def test_other_ends_have_a_code_and_no_verdict(
    evaluation: Evaluation,
    answers: list[Answer],
    end: Callable[[Evaluation], None],
    code: ExitCode,
    message: str,
) -> None:
    end(evaluation)
    (answer,) = answers
    assert answer.verdict is Verdict.UNDECIDED
    assert answer.decided_at is None
    assert answer.error is not None
    assert answer.error.code is code
    assert message in str(answer.error)


def test_what_comes_after_the_end_changes_nothing(
    evaluation: Evaluation, answers: list[Answer]
) -> None:
    evaluation.set_phase(EvaluationPhase.RUNNING)
    evaluation.decide(Verdict.TRUE, 7, '')
    evaluation.fail_unavailable('node x')
    evaluation.set_phase(EvaluationPhase.RUNNING)
    assert [answer.verdict for answer in answers] == [Verdict.TRUE]
    assert evaluation.phase is EvaluationPhase.ENDED


def test_a_timeout_says_what_was_going_on(evaluation: Evaluation, answers: list[Answer]) -> None:
    evaluation.set_phase(EvaluationPhase.RUNNING)
    evaluation.expire(1.0)
    assert 'being evaluated' in str(answers[0].error)


def test_a_timeout_without_states_says_why(answers: list[Answer]) -> None:
    class Waiting(Evaluation):
        """An evaluation whose states do not come."""

        def missing_states(self) -> str:
            return 'no state has come: nobody publishes /odm'

    Waiting(answers.append).expire(5.0)
    assert str(answers[0].error) == (
        'no verdict within 5 s (no state has come: nobody publishes /odm)'
    )


def test_retries_supersede_each_other_but_no_verdict() -> None:
    """Each of them may have been reported for a day: 200 of them hid the verdicts of others."""
    verdict, error = Answer(Verdict.FALSE), Answer(error=LATE)
    assert is_superseded(error, None)
    assert is_superseded(error, error)
    assert is_superseded(verdict, Answer(Verdict.TRUE))
    assert not is_superseded(verdict, None)
    assert not is_superseded(verdict, error)
    assert not any(is_superseded(None, later) for later in (None, verdict, error))


def test_a_retry_repeats_the_request_for_the_rest_of_its_time() -> None:
    request = EvaluationRequest('always p', name='calm', timeout_s=60.0, record=BlackBoxOptions())
    assert replace(request, timeout_s=49.5, delay_s=1.0).repeats(request)
    assert replace(request, since=5).repeats(request)
    assert not replace(request, name='other').repeats(request)
    assert not replace(request, action='land').repeats(request)
