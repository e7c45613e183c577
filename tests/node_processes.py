"""Processes of single nodes for tests, whose output and exit codes count."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from commands import started

PRELUDE = """
import ctypes
import threading
import time

from dyknow_common.ros import DyKnowNode, run

class Node(DyKnowNode):
    def __init__(self):
        super().__init__('node')
        self.create_timer(0.1, self.work)
        print('running', flush=True)

    def work(self):
        {work}

raise SystemExit(run(Node))
"""


@contextmanager
def process_of(*command: str, environment: Mapping[str, str]) -> Iterator[subprocess.Popen[str]]:
    """A process, which is killed at the end of the block."""
    with started(command, environment, stderr=subprocess.PIPE) as process:
        try:
            yield process
        finally:
            process.kill()


@contextmanager
def node_that(
    work: str, *arguments: str, environment: Mapping[str, str], setting: str = ''
) -> Iterator[subprocess.Popen[str]]:
    """A node `node` that executes a statement ten times a second, and has started.

    Args:
        arguments: of ROS.
        setting: a statement executed before the start.
    """
    program = PRELUDE.replace('{work}', work)
    if setting:
        program = program.replace('raise', f'{setting}\nraise')
    command = (sys.executable, '-c', program, '--ros-args', *arguments)
    with process_of(*command, environment=environment) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == 'running\n'
        yield process


def end_of(process: subprocess.Popen[str], limit: float) -> tuple[int, str]:
    """The exit code of a process that ends by itself, and what it has written to stderr."""
    _, errors = process.communicate(timeout=limit)
    return process.returncode, errors
