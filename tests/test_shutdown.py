"""A node ends when it is told to, even one that does not come back from what it does."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from dyknow_interfaces.action import MonitorFormula
from rclpy.action import ActionClient

from commands import started
from dyknow_common.ros import SERVICE
from system import ALWAYS, LIMIT, System, private_environment

NODE = """
import ctypes
import threading
from dyknow_common.ros import DyKnowNode, run

class Stuck(DyKnowNode):
    def __init__(self):
        super().__init__('stuck')
        self.create_timer(0.01, self.{stuck_in})

    def wait(self):
        print('running', flush=True)
        threading.Event().wait()

    def go_on(self):
        print('running', flush=True)

    def destroy_node(self):
        # A call of C by `PyDLL` lets no other thread of Python run meanwhile.
        ctypes.PyDLL(None).sleep(60)

raise SystemExit(run(Stuck))
"""


@pytest.mark.parametrize(
    ('callback', 'code', 'printed'),
    # It was asked to stop, and nothing is lost: its answers have been sent.
    [('wait', 0, ''), ('go_on', 0, 'in destroy_node')],
)
def test_a_node_that_is_stuck_ends_all_the_same(callback: str, code: int, printed: str) -> None:
    line = [sys.executable, '-c', NODE.replace('{stuck_in}', callback)]
    with started(line, private_environment(), stderr=subprocess.PIPE) as process:
        assert process.stdout.readline() == 'running\n'
        process.send_signal(signal.SIGTERM)
        try:
            assert process.wait(30) == code
            assert printed in process.stderr.read()
        finally:
            process.kill()


def test_nodes_stop_while_formulas_are_grounded(tmp_path: Path) -> None:
    with System(tmp_path, composition=False) as system:
        actions = ActionClient(
            system.client.node,
            MonitorFormula,
            'stream_reasoning_coordinator/monitor_formula',
            goal_service_qos_profile=SERVICE,
        )
        system.client.spin_until(actions.server_is_ready, 'the action')
        goals = []
        for _ in range(20):
            system.ask(ALWAYS, timeout=60.0)
            goals.append(actions.send_goal_async(MonitorFormula.Goal(formula=ALWAYS)))
        system.client.spin_until(lambda: any(goal.done() for goal in goals), 'a goal is accepted')
        for number in (signal.SIGINT, signal.SIGTERM):
            for process in system.running.values():
                process.send_signal(number)
        codes = {name: process.wait(LIMIT) for name, process in system.running.items()}
    assert set(codes.values()) == {0}, codes
    for log in tmp_path.glob('*.log'):
        text = log.read_text(encoding='utf-8')
        assert 'Traceback' not in text, text
        assert 'fault in DyKnow' not in text, text
