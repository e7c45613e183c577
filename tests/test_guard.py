"""Guards of a real system: each way of closing, and of refusing a command."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from dyknow_interfaces.msg import GuardStatus

from guards import GuardedBase, guarded_base, is_zero
from system import System

LIMIT_S = 0.6
POWER = "['Power[uav1] < 150']"


@pytest.fixture
def base(system: System, tmp_path: Path) -> Iterator[GuardedBase]:
    system.batteries.reset()
    with guarded_base(system, tmp_path, POWER) as running:
        running.wait_until_open()
        yield running


def test_a_formula_that_is_false(system: System, base: GuardedBase) -> None:
    system.batteries.power['uav1'] = 200.0
    event = time.monotonic()
    base.wait_for(GuardStatus.CLOSED, 'Power[uav1] = 200.0')
    base.assert_safe_after(event, 0.2)
    system.batteries.power['uav1'] = 100.0
    base.wait_until_open()
