"""Silence of topics, as the reports of engines tell; times in seconds."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from dyknow_common import SECOND_NS
from dyknow_coordinator.ros.evaluation.silence_monitor import SilenceMonitor

LIMIT = 5
BORN = 100


class Bench:
    """A coordinator with one group, whose topic was heard of when the group began."""

    def __init__(self) -> None:
        self.now = BORN
        self.replaced: list[str] = []
        self.warnings: list[str] = []
        known = SimpleNamespace(
            get=lambda _: SimpleNamespace(name='states', received={'/a': BORN * SECOND_NS}),
            affected=lambda *_: ('source',),
            is_overdue=lambda *_: False,
        )
        self.streams = SimpleNamespace(known=known, known_until=0, heard_at=0)
        node = SimpleNamespace(
            now=self._now_ns,
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
            stream=SimpleNamespace(name='states', created_at_s=BORN),
            chosen=('source',),
            used_since=BORN * SECOND_NS,
            improve=lambda: None,
            waits_for='',
            replace_silent=lambda _, reason, **__: self.replaced.append(reason),
        )
        group = SimpleNamespace(states=states, waits_for='', set_waiting=lambda _: None)
        groups: Any = SimpleNamespace(running=lambda: [group])
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

    def _set_timer(self, _period: float, check: Any, **_: Any) -> None:
        self._check = check


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_topic_is_silent_by_the_time_that_its_engine_knows(bench: Bench) -> None:
    bench.now = BORN + 7
    bench.report(BORN + 5)
    assert bench.replaced == []
    bench.report(BORN + 6)
    assert bench.replaced == ["topic '/a' has been silent for 5 s"]
    assert bench.warnings == []


def test_nodes_that_do_not_run_are_blamed_instead_of_a_topic(bench: Bench) -> None:
    for now in range(BORN, BORN + 30):
        bench.check(now)
    assert bench.replaced == []
    (warning,) = bench.warnings
    assert 'nothing was reported about topics for 5 s, so none of them is taken for' in warning
