"""A node ends when it is told to, even one that does not come back from what it does."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from commands import started
from system import private_environment

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
