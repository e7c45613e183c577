"""When `formula_monitor` monitors a formula again after an error."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import rclpy
from rclpy.task import Future

from dyknow_bringup.ros.formula_monitor import FormulaMonitor
from dyknow_common import SECOND_NS, ExitCode
from dyknow_configuration import RequestedFormula
from dyknow_coordinator import Answer, CoordinationError, Progress
from dyknow_coordinator.retries import MAX_RETRY_DELAY_NS, RETRY_DELAY_NS

RETRY_DELAY_S = RETRY_DELAY_NS / SECOND_NS
MAX_RETRY_DELAY_S = MAX_RETRY_DELAY_NS / SECOND_NS
FORMULA = RequestedFormula('always p')


class Retried(FormulaMonitor):
    """A monitor of one formula, and the times until it was monitored again."""

    def __init__(self) -> None:
        super().__init__([FORMULA], retries=True)
        self.delays: list[float] = []
        self.deadlines.after = self._note  # type: ignore[method-assign]

    def _note(self, delay_s: float) -> Future:
        self.delays.append(delay_s)
        return Future()

    def fail(self, code: ExitCode = ExitCode.CONSTRAINT_VIOLATION) -> None:
        self._on_verdict(0, Answer(error=CoordinationError('/a is silent', code)))

    def have_a_state(self) -> None:
        self._on_progress(0, Progress(1, 5, 'always p'))


@pytest.fixture
def node() -> Iterator[Retried]:
    rclpy.init()
    made = Retried()
    yield made
    made.destroy_node()
    rclpy.shutdown()


def test_attempts_without_a_state_are_further_and_further_apart(node: Retried) -> None:
    node.have_a_state()
    for _ in range(6):
        node.fail()
    assert node.delays == [RETRY_DELAY_S, 1.0, 2.0, 4.0, MAX_RETRY_DELAY_S, MAX_RETRY_DELAY_S]
    node.have_a_state()
    node.fail()
    assert node.delays[-1] == RETRY_DELAY_S


def test_an_invalid_request_is_sent_again_late(node: Retried) -> None:
    node.fail(ExitCode.INVALID_ARGUMENT)
    assert node.delays == [MAX_RETRY_DELAY_S]
