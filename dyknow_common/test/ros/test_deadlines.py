"""Waits that end by the wall clock: their order, and the ticks of a node that waits for nothing."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from dyknow_common import SECOND_NS, DyKnowError
from dyknow_common.ros import REST_PERIOD_S, TICK_PERIOD_S
from dyknow_common.ros.deadlines import Deadlines


class FakeTimer:
    """A timer whose clock is moved by hand."""

    def __init__(self, period_s: float, tick: Callable[[], None]) -> None:
        self.timer_period_ns = round(period_s * SECOND_NS)
        self._tick = tick
        self._due = self.timer_period_ns
        self.now = 0
        self.ticks = 0

    def reset(self) -> None:
        self._due = self.now + self.timer_period_ns

    def run(self, seconds: float) -> None:
        """Tick whenever that is due."""
        end = self.now + round(seconds * SECOND_NS)
        while self._due <= end:
            self.now = self._due
            self._due += self.timer_period_ns
            self.ticks += 1
            self._tick()
        self.now = end


class FakeNode:
    """A node with one timer, and its clock."""

    timer: FakeTimer

    def create_timer(self, period_s: float, tick: Callable[[], None], **_: Any) -> FakeTimer:
        self.timer = FakeTimer(period_s, tick)
        return self.timer

    def now(self) -> SimpleNamespace:
        return SimpleNamespace(nanoseconds=self.timer.now)


@pytest.fixture
def made() -> tuple[Deadlines, FakeTimer]:
    node: Any = FakeNode()
    return Deadlines(node, node), node.timer


def test_an_idle_node_ticks_seldom(made: tuple[Deadlines, FakeTimer]) -> None:
    deadlines, timer = made
    deadlines.after(3600.0)
    timer.run(10.0)
    assert timer.ticks == 10.0 / REST_PERIOD_S


@pytest.mark.parametrize('delay_s', [0.0, 0.04, 0.1, REST_PERIOD_S, 0.3, 0.77, 5.02])
@pytest.mark.parametrize('begin_s', [0.0, 0.13, 0.24])
def test_a_wait_ends_within_a_tick(
    made: tuple[Deadlines, FakeTimer], delay_s: float, begin_s: float
) -> None:
    deadlines, timer = made
    timer.run(begin_s)
    future = deadlines.after(delay_s)
    timer.run(delay_s - 0.001)
    assert not future.done()
    timer.run(0.002 + TICK_PERIOD_S)
    assert future.done()
    before = timer.ticks
    timer.run(1.0)
    assert timer.ticks - before <= 1.0 / REST_PERIOD_S + 1


def test_waits_end_in_their_order(made: tuple[Deadlines, FakeTimer]) -> None:
    deadlines, timer = made
    ended: list[float] = []
    for delay_s in (0.6, 0.1, 2.0, 0.3):
        deadlines.after(delay_s).add_done_callback(lambda _, delay_s=delay_s: ended.append(delay_s))
    timer.run(3.0)
    assert ended == [0.1, 0.3, 0.6, 2.0]


def test_a_failure_after_a_timeout(made: tuple[Deadlines, FakeTimer]) -> None:
    deadlines, timer = made
    done, late = deadlines.after(9.0), deadlines.after(9.0)
    for future in (done, late):
        deadlines.fail(future, 1.0, DyKnowError('too late'))
    done.set_result(None)
    timer.run(1.0 + TICK_PERIOD_S)
    assert done.exception() is None
    with pytest.raises(DyKnowError, match='too late'):
        late.result()


def test_the_end_of_all_waits(made: tuple[Deadlines, FakeTimer]) -> None:
    deadlines, _ = made
    future = deadlines.after(9.0)
    deadlines.end_all()
    assert future.done()
    assert deadlines.after(0.1).done()


def test_a_wait_that_the_end_of_another_one_cancels_does_not_end(
    made: tuple[Deadlines, FakeTimer],
) -> None:
    deadlines, timer = made
    first, second = deadlines.after(0.1), deadlines.after(0.1)
    first.add_done_callback(lambda _: second.cancel())
    timer.run(1.0)
    assert first.done()
    assert second.cancelled()
    assert not second.done()
