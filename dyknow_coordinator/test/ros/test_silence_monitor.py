"""Looks at the streams of groups, and warnings; times in seconds."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.logging import get_logger

from dyknow_common import SECOND_NS
from dyknow_coordinator.ros.evaluation.silence_monitor import SilenceMonitor

LIMIT = 5
BORN = 100


class Bench:
    """A coordinator with one group, whose topic was heard of when the group began."""

    def __init__(self) -> None:
        self.now = BORN
        self.simulated: int | None = None
        self.limits: list[int] = []
        self.warnings: list[str] = []
        self.streams = SimpleNamespace(known_until=0, heard_at=0)
        node = SimpleNamespace(
            now=self._ros_now,
            wall_clock=None,
            create_timer=self._set_timer,
            get_logger=lambda: SimpleNamespace(warning=self.warnings.append),
        )
        context: Any = SimpleNamespace(
            node=node,
            streams=self.streams,
            wall_time=self._now_ns,
            wall_time_s=lambda: float(self.now),
        )
        states = SimpleNamespace(
            stream=SimpleNamespace(name='states', created_at_s=BORN, arrived_at_s=BORN),
            chosen=('source',),
            waits_for='',
            look=self.limits.append,
        )
        self.infos: list[str] = []
        self.reasons: list[str] = []
        self.group = SimpleNamespace(
            states=states,
            waits_for='',
            titles='formula',
            logger=SimpleNamespace(warning=self.warnings.append, info=self.infos.append),
            set_waiting=self.reasons.append,
        )
        groups: Any = SimpleNamespace(running=lambda: [self.group])
        SilenceMonitor(context, groups, lambda: LIMIT)
        self.report(BORN)

    def report(self, known_until: int) -> None:
        """Receive a report, and check at once."""
        self.streams.known_until = known_until * SECOND_NS
        self.streams.heard_at = self._now_ns()
        self._check()

    def check(self, now: int) -> None:
        self.now = now
        self._check()

    def _now_ns(self) -> int:
        return self.now * SECOND_NS

    def _ros_now(self) -> int:
        return self._now_ns() if self.simulated is None else self.simulated * SECOND_NS

    def _set_timer(self, _period: float, check: Any, **_: Any) -> None:
        self._check = check


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_the_streams_of_groups_are_looked_at(bench: Bench) -> None:
    bench.check(BORN + 4)
    assert set(bench.limits) == {LIMIT * SECOND_NS}
    assert bench.warnings == []


def test_nodes_that_do_not_run_are_blamed_instead_of_a_topic(bench: Bench) -> None:
    for now in range(BORN, BORN + 30):
        bench.check(now)
    (warning,) = bench.warnings
    assert 'nothing was reported about topics for 5 s, so none of them is taken for' in warning


def test_a_formula_without_states_waits_while_nothing_is_reported(bench: Bench) -> None:
    """It was taken for running: the last report said that its states come."""
    bench.check(BORN + 4)
    assert bench.reasons[-1] == ''
    bench.check(BORN + 6)
    assert 'nothing was reported about topics for 5 s' in bench.reasons[-1]
    bench.group.states.stream.arrived_at_s = BORN + 6
    bench.check(BORN + 7)
    assert bench.reasons[-1] == ''
    bench.check(BORN + 12)
    assert 'the stream manager or an engine was stopped' in bench.reasons[-1]
    bench.report(BORN + 12)
    assert bench.reasons[-1] == ''


def test_simulated_time_that_begins_late_or_goes_on(bench: Bench) -> None:
    bench.simulated = 0
    bench.streams.known_until = bench.streams.heard_at = 0
    bench.check(BORN + 60)
    bench.simulated = 1_700_000_000
    bench.check(BORN + 61)
    bench.report(1_700_000_000)
    bench.check(BORN + 100)
    bench.simulated += 1
    bench.check(BORN + 101)
    assert bench.warnings == []
    bench.check(BORN + 106)
    assert len(bench.warnings) == 1


def test_the_first_window_of_a_rate_is_no_fault(bench: Bench) -> None:
    """The log had a warning for each formula with a rate whose window is longer than 3 s."""
    bench.group.waits_for = 'the rate of /a has its first value 10 s after the first message'
    bench.check(BORN + 4)
    assert bench.warnings == []
    assert bench.infos == [f'no state comes for formula: {bench.group.waits_for}']
    bench.group.waits_for += '; nobody publishes /b'
    bench.check(BORN + 5)
    assert bench.warnings == [f'no state comes for formula: {bench.group.waits_for}']


def test_a_fault_is_logged_after_a_first_window_by_the_same_logger(bench: Bench) -> None:
    """The logger of ROS refuses another severity at the same line: no topic was looked at."""
    bench.group.logger = get_logger('waits')
    bench.group.waits_for = 'the rate of /a has its first value 10 s after the first message'
    bench.check(BORN + 4)
    bench.group.waits_for = 'nobody publishes /b'
    before = len(bench.limits)
    bench.check(BORN + 5)
    assert len(bench.limits) == before + 1
