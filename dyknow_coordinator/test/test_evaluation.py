"""The life of an evaluation: its first end is the one that counts."""

from collections.abc import Callable

import pytest

from dyknow_common import ExitCode, Verdict
from dyknow_coordinator import CoordinationError, Evaluation, EvaluationOutcome, EvaluationPhase


@pytest.fixture
def outcomes() -> list[EvaluationOutcome]:
    return []


@pytest.fixture
def evaluation(outcomes: list[EvaluationOutcome]) -> Evaluation:
    return Evaluation(outcomes.append)


def test_a_verdict_ends_it(evaluation: Evaluation, outcomes: list[EvaluationOutcome]) -> None:
    evaluation.enter(EvaluationPhase.RUNNING)
    evaluation.decide(Verdict.FALSE, 7, 'p = false')
    assert outcomes == [EvaluationOutcome(Verdict.FALSE, 7, 'p = false')]
    assert evaluation.phase is EvaluationPhase.ENDED


LATE = CoordinationError("stream 's' late", ExitCode.CONSTRAINT_VIOLATION)

ENDS: list[tuple[Callable[[Evaluation], None], ExitCode, str]] = [
    (lambda e: e.fail(LATE), ExitCode.CONSTRAINT_VIOLATION, "stream 's' late"),
    (lambda e: e.lose('node x'), ExitCode.UNAVAILABLE, 'node x is gone; the formula was'),
    (lambda e: e.expire(2.5), ExitCode.TIMEOUT, 'no verdict within 2.5 s'),
    (lambda e: e.cancel(), ExitCode.CANCELLED, 'cancelled by the caller'),
]


@pytest.mark.parametrize(('end', 'code', 'message'), ENDS)
def test_other_ends_have_a_code_and_no_verdict(
    evaluation: Evaluation,
    outcomes: list[EvaluationOutcome],
    end: Callable[[Evaluation], None],
    code: ExitCode,
    message: str,
) -> None:
    end(evaluation)
    (outcome,) = outcomes
    assert outcome.verdict is Verdict.UNDECIDED
    assert outcome.decided_at is None
    assert outcome.error is not None
    assert outcome.error.code is code
    assert message in str(outcome.error)


def test_what_comes_after_the_end_changes_nothing(
    evaluation: Evaluation, outcomes: list[EvaluationOutcome]
) -> None:
    evaluation.enter(EvaluationPhase.RUNNING)
    evaluation.decide(Verdict.TRUE, 7, '')
    evaluation.lose('node x')
    evaluation.enter(EvaluationPhase.RUNNING)
    assert [outcome.verdict for outcome in outcomes] == [Verdict.TRUE]
    assert evaluation.phase is EvaluationPhase.ENDED


def test_a_timeout_says_what_was_going_on(
    evaluation: Evaluation, outcomes: list[EvaluationOutcome]
) -> None:
    evaluation.enter(EvaluationPhase.RUNNING)
    evaluation.expire(1.0)
    assert 'being evaluated' in str(outcomes[0].error)
