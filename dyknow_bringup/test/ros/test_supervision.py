"""Restarts of processes that end."""

import pytest

from dyknow_bringup.errors import BringupError
from dyknow_bringup.processes.launcher import EndedProcess
from dyknow_bringup.processes.processes import Process
from dyknow_bringup.processes.supervision import (
    AT_ONCE_NS,
    MAX_DELAY_NS,
    RESTART_DELAY_NS,
    STABLE_NS,
    Supervisor,
)
from dyknow_common.executables import CANNOT_START

NODE = Process('package', 'node')


class Processes:
    """Stands for the launcher."""

    def __init__(self) -> None:
        self.starts = 0
        self.code: int | None = None

    def start(self, process: Process) -> None:
        assert process == NODE
        self.starts += 1
        self.code = None

    def start_all(self, processes: object) -> None:
        for process in processes:
            self.start(process)

    def ended(self) -> tuple[EndedProcess, ...]:
        return () if self.code is None else (EndedProcess('node', self.code, 'its last words'),)


class Restarts:
    def __init__(self, *, restarts: bool = True) -> None:
        self.processes = Processes()
        self.said: list[str] = []
        self.supervisor = Supervisor(self.processes, [NODE], self.said.append, restarts=restarts)
        self.now = 0

    def end(self, code: int) -> None:
        self.processes.code = code
        self.supervisor.update(self.now)

    def wait(self, duration: int) -> None:
        self.now += duration
        self.supervisor.update(self.now)


def test_a_process_that_ends_is_started_again_at_once_and_then_after_a_delay() -> None:
    node = Restarts()
    node.end(-9)
    assert node.processes.starts == 2
    node.end(-9)
    node.wait(RESTART_DELAY_NS - 1)
    assert node.processes.starts == 2
    node.wait(1)
    assert node.processes.starts == 3
    node.wait(RESTART_DELAY_NS)
    assert node.processes.starts == 3
    assert node.said == [
        'node was killed by SIGKILL; it will be started again at once',
        'node was started again',
        'node was killed by SIGKILL; it will be started again in 2 s',
        'node was started again',
    ]


def test_a_process_that_cannot_start_ends_the_system() -> None:
    with pytest.raises(BringupError, match='node cannot start:\nits last words'):
        Restarts().end(CANNOT_START)


def test_a_process_that_ends_again_at_once_ends_the_system() -> None:
    node = Restarts()
    for delay in (0, RESTART_DELAY_NS):
        node.end(70)
        node.wait(delay)
        node.wait(AT_ONCE_NS - 1)
    message = r'node ended with exit code 70 \(3 times, each time within 10 s of its start\)'
    with pytest.raises(BringupError, match=message):
        node.end(70)


def test_a_process_that_is_killed_again_and_again_is_started_later_and_later() -> None:
    """Whatever kills it, the other nodes, such as guards, go on."""
    node = Restarts()
    delays = []
    for code in (-9, -15, -9, -9, -9, -9):
        began, starts = node.now, node.processes.starts
        node.end(code)
        while node.processes.starts == starts:
            node.wait(RESTART_DELAY_NS // 2)
        delays.append(node.now - began)
    assert delays == [0, *(RESTART_DELAY_NS << n for n in range(4)), MAX_DELAY_NS]


def test_a_process_that_has_run_for_long_is_started_again_soon() -> None:
    node = Restarts()
    for _ in range(5):
        node.end(-6)
        node.wait(RESTART_DELAY_NS)
        node.wait(STABLE_NS)
    assert node.processes.starts == 6


def test_faults_after_some_time_end_no_system() -> None:
    node = Restarts()
    for number in range(1, 6):
        node.end(70)
        node.wait(MAX_DELAY_NS)
        node.wait(AT_ONCE_NS)
        assert node.processes.starts == 1 + number


def test_without_restarts_the_first_end_is_that_of_the_system() -> None:
    with pytest.raises(BringupError, match='node was killed by SIGSEGV:\nits last words'):
        Restarts(restarts=False).end(-11)
