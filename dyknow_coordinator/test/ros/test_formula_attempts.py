"""The attempts to monitor a formula, with a clock that the test sets."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import Any

import pytest

from dyknow_common import SECOND_NS, ExitCode, Verdict
from dyknow_coordinator import Answer
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.ros.client.formula_attempts import RETRY_DELAY_S, FormulaAttempts

FALSE = Answer(verdict=Verdict.FALSE)


def failed(code: ExitCode) -> Answer:
    return Answer(error=CoordinationError('a fault', code))


class Situation:
    """A client whose coordinator answers as the test says."""

    def __init__(self, *, retries: bool = True) -> None:
        self.time = 100.0
        self.wall_clock = self.deadlines = self
        self.timers: list[Callable[[Any], None]] = []
        self.sent: list[float] = []
        self.answer: Callable[[Answer], None] = lambda _: None
        self.interruptions: list[Answer] = []
        self.answers: list[Answer] = []
        self.cancelled = 0
        self.on_send: Callable[[], None] = lambda: None
        told = self.interruptions.append if retries else None
        node: Any = self
        send: Any = self.send
        self.attempts = FormulaAttempts(node, 10.0, send, self.answers.append, told)

    def now(self) -> Situation:
        return self

    @property
    def nanoseconds(self) -> int:
        return round(self.time * SECOND_NS)

    def after(self, _: float) -> Situation:
        return self

    def add_done_callback(self, callback: Callable[[Any], None]) -> None:
        self.timers.append(callback)

    def send(
        self, wait: float, timeout: Callable[[], float], on_end: Callable[[Answer], None]
    ) -> Situation:
        self.sent.append(timeout())
        self.longest_wait, self.timeout, self.answer = wait, timeout, on_end
        self.on_send()
        return self

    def cancel(self) -> None:
        self.cancelled += 1

    def wait(self) -> None:
        self.time += RETRY_DELAY_S
        for callback in self.timers:
            callback(None)
        self.timers.clear()


def test_an_interruption_is_told_and_the_formula_sent_again() -> None:
    situation = Situation()
    for code in (ExitCode.CONSTRAINT_VIOLATION, ExitCode.UNAVAILABLE, ExitCode.NOT_FOUND):
        situation.answer(failed(code))
        situation.wait()
    assert situation.sent == [10.0, 9.5, 9.0, 8.5]
    situation.answer(FALSE)
    assert situation.answers == [FALSE]
    assert len(situation.interruptions) == 3


@pytest.mark.parametrize('code', [ExitCode.NOT_FOUND, ExitCode.INVALID_ARGUMENT, ExitCode.TIMEOUT])
def test_other_errors_are_the_end(code: ExitCode) -> None:
    situation = Situation()
    situation.answer(failed(code))
    assert (len(situation.answers), situation.timers, situation.interruptions) == (1, [], [])


def test_without_a_listener_the_first_answer_is_the_last() -> None:
    situation = Situation(retries=False)
    situation.answer(failed(ExitCode.CONSTRAINT_VIOLATION))
    assert len(situation.answers) == 1


def test_the_timeout_counts_for_all_attempts() -> None:
    situation = Situation()
    situation.time += 9.6
    situation.answer(failed(ExitCode.CONSTRAINT_VIOLATION))
    assert len(situation.answers) == 1


def test_the_timeout_counts_while_a_retry_waits_for_the_coordinator() -> None:
    situation = Situation()
    assert situation.longest_wait == inf
    situation.time += 2
    assert situation.timeout() == 10.0
    situation.time += 5
    situation.answer(failed(ExitCode.UNAVAILABLE))
    situation.wait()
    assert situation.longest_wait == 2.5
    situation.time += 2
    assert situation.timeout() == 0.5
    situation.time += 2
    assert 0 < situation.timeout() < 0.1


def test_a_retry_is_cancelled_that_another_thread_sends_meanwhile() -> None:
    situation = Situation()
    situation.answer(failed(ExitCode.UNAVAILABLE))
    situation.on_send = situation.attempts.cancel
    situation.wait()
    assert (len(situation.sent), situation.cancelled) == (2, 2)


def test_attempts_are_cancelled_while_they_wait() -> None:
    situation = Situation()
    situation.answer(failed(ExitCode.CONSTRAINT_VIOLATION))
    situation.attempts.cancel()
    situation.wait()
    (answer,) = situation.answers
    assert answer.error is not None
    assert (answer.error.code, situation.sent) == (ExitCode.CANCELLED, [10.0])


def test_what_is_cancelled_is_not_sent_again() -> None:
    situation = Situation()
    situation.attempts.cancel()
    situation.answer(failed(ExitCode.UNAVAILABLE))
    assert (situation.cancelled, len(situation.answers), situation.timers) == (1, 1, [])
