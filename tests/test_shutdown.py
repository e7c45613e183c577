"""A node ends when it is told to, even one that does not come back from what it does."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

from system import private_environment

STUCK = """
import threading
from dyknow_stream_processing.ros import DyKnowNode, run

class Stuck(DyKnowNode):
    def __init__(self):
        super().__init__('stuck')
        self.create_timer(0.01, self._wait)

    def _wait(self):
        print('stuck', flush=True)
        threading.Event().wait()

raise SystemExit(run(Stuck))
"""


def test_a_node_that_is_stuck_in_a_callback_ends_all_the_same() -> None:
    with subprocess.Popen(
        [sys.executable, '-c', STUCK],
        env={**os.environ, **private_environment()},
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == 'stuck\n'
        process.send_signal(signal.SIGTERM)
        try:
            assert process.wait(30) == 0
        finally:
            process.kill()
