"""Processes of the executables for users."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from dyknow_bringup.resources import executable_path


def command(name: str, *arguments: str) -> list[str]:
    """Return the command line of `dyknow`, or of an executable of dyknow_bringup."""
    package = 'dyknow_command' if name == 'dyknow' else 'dyknow_bringup'
    return [str(executable_path(package, name)), *arguments]


@contextmanager
def running(line: list[str], environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """Run a process that SIGTERM ends with exit code 0."""
    process = subprocess.Popen(
        line,
        env={**os.environ, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        yield process
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0
    finally:
        # After a failure, the nodes that the process has started must end too.
        process.terminate()
        try:
            process.communicate(timeout=30)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()


def output_of(line: list[str], environment: dict[str, str], limit: float = 90.0) -> Any:
    """Run a process until it ends by itself."""
    return subprocess.run(
        line,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=limit,
        check=False,
    )
