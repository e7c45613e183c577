"""One goal of an action, with a server and a clock of the test."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.task import Future

from dyknow_common import DyKnowError, ExitCode
from dyknow_coordinator.ros.client import action_call
from dyknow_coordinator.ros.client.action_call import ActionCall, GoalTimeouts


class Situation:
    """A node, its action client, the server, and the handle of the goal."""

    name = 'server'
    accepted = alive = is_ready = True

    def __init__(self) -> None:
        self.node = self.wall_clock = self.deadlines = self
        self.executor = None
        self.nanoseconds = 0
        self.sending = threading.Lock()
        self.on_lost: list[Callable[[], None]] = []
        self.on_found: list[Callable[[], None]] = []
        self.polls: list[Future] = []
        self.answer, self.result = Future(), Future()
        self.cancelled = 0
        self.feedback: list[Any] = []
        self.ends: list[ExitCode | None] = []
        self.take_feedback: Callable[[Any], None] = lambda _: None
        itself: Any = self
        self.call = ActionCall(
            itself, itself, itself, lambda: 'goal', GoalTimeouts(1.0, None),
            on_end=lambda _, error: self.ends.append(error and error.code),
            on_feedback=self.feedback.append,
        )  # fmt: skip
        self.poll()

    def now(self) -> Situation:
        return self

    def after(self, _: float) -> Future:
        self.polls.append(Future())
        return self.polls[-1]

    def poll(self) -> None:
        polls, self.polls = self.polls, []
        for each in polls:
            if not each.done():
                each.set_result(None)

    def unavailable(self, reason: str) -> DyKnowError:
        return DyKnowError(reason, ExitCode.UNAVAILABLE)

    def server_is_ready(self) -> bool:
        return self.is_ready

    def send_goal_async(self, _: Any, take_feedback: Any, goal_id: Any) -> Future:
        assert goal_id == id(self), 'the identifier of a goal shows its client'
        self.take_feedback = take_feedback
        return self.answer

    def get_result_async(self) -> Future:
        return self.result

    def cancel_goal_async(self) -> Future:
        self.cancelled += 1
        return Future()

    def lose(self) -> None:
        self.alive = False
        for each in list(self.on_lost):
            each()

    def find(self) -> None:
        self.alive = True
        for each in list(self.on_found):
            each()


@pytest.fixture
def situation(monkeypatch: pytest.MonkeyPatch) -> Situation:
    """A goal that the server pursues."""
    monkeypatch.setattr(action_call, 'goal_id', id)
    pursued = Situation()
    pursued.answer.set_result(pursued)
    return pursued


def test_feedback_after_the_end_is_not_passed_on(situation: Situation) -> None:
    """A server that was only stopped goes on with the goal that its client has given up."""
    situation.take_feedback(SimpleNamespace(feedback='before'))
    situation.lose()
    situation.take_feedback(SimpleNamespace(feedback='after'))
    assert situation.feedback == ['before']
    assert situation.ends == [ExitCode.UNAVAILABLE]


def test_the_goal_is_cancelled_once_its_server_is_back(situation: Situation) -> None:
    situation.lose()
    assert situation.cancelled == 0
    situation.is_ready = False
    situation.find()
    situation.poll()
    assert situation.cancelled == 0
    situation.is_ready = True
    situation.poll()
    assert situation.cancelled == 1
    situation.lose()
    situation.find()
    assert (situation.cancelled, situation.polls, situation.on_found) == (1, [], [])


def test_the_goal_is_cancelled_once_if_its_server_is_lost_again(situation: Situation) -> None:
    situation.lose()
    situation.is_ready = False
    situation.find()
    situation.lose()
    situation.poll()
    assert situation.polls == []
    situation.find()
    situation.find()
    situation.is_ready = True
    situation.poll()
    assert situation.cancelled == 1


def test_who_cancels_again_and_again_waits_no_longer(situation: Situation) -> None:
    situation.call.cancel()
    waits = list(situation.polls)
    situation.call.cancel()
    assert (situation.cancelled, situation.polls) == (1, waits)
    situation.poll()
    assert situation.ends == [ExitCode.CANCELLED]


@pytest.mark.parametrize('loses', [False, True])
def test_a_goal_that_is_accepted_in_another_thread_while_the_call_ends(
    *, loses: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A multi-threaded executor may deliver the answer at any place."""
    monkeypatch.setattr(action_call, 'goal_id', id)
    situation = Situation()

    class InterruptedLock:
        def __enter__(self) -> None:
            if not situation.answer.done():
                situation.answer.set_result(situation)

        def __exit__(self, *_: object) -> None:
            pass

    situation.call._lock = InterruptedLock()  # type: ignore[assignment]
    if loses:
        situation.lose()
        situation.find()
    else:
        situation.call.fail(DyKnowError('it is closed', ExitCode.CANCELLED))
    assert situation.cancelled == 1
    assert len(situation.ends) == 1
