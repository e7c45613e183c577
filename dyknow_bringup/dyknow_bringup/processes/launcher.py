"""Starts and stops processes without the launch package."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from dyknow_bringup.processes.processes import Process, ros_arguments
from dyknow_bringup.resources import executable_path


class Launcher:
    """Processes that end with the block that they were started in.

    Args:
        logs: a folder for what each process prints.
        environment: variables that differ from those of this process.
    """

    def __init__(
        self,
        logs: Path,
        *,
        namespace: str = '',
        use_sim_time: bool = False,
        log_level: str = 'info',
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._logs = logs
        self._namespace = namespace
        self._use_sim_time = use_sim_time
        self._log_level = log_level
        self._environment = {**os.environ, **(environment or {})}
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop_all()

    def start_all(self, processes: Iterable[Process]) -> None:
        """Starts processes."""
        for process in processes:
            self.start(process)

    def start(self, process: Process) -> subprocess.Popen[bytes]:
        """Starts a process, in a session of its own so that it is stopped by us alone.

        Raises:
            BringupError: NOT_FOUND, when the executable is not installed.
        """
        arguments = ros_arguments(
            process, self._namespace, self._log_level, use_sim_time=self._use_sim_time
        )
        executable = executable_path(process.package, process.executable)
        with self.log(process.executable).open('ab') as log:
            running = subprocess.Popen(
                [str(executable), *arguments],
                stdout=log,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                start_new_session=True,
                env=self._environment,
            )
        self._running[process.executable] = running
        return running

    def log(self, executable: str) -> Path:
        """The file with what a process printed."""
        return self._logs / f'{executable}.log'

    def ended(self) -> dict[str, int]:
        """The exit codes of the processes that have ended by themselves."""
        codes = {name: running.poll() for name, running in self._running.items()}
        return {name: code for name, code in codes.items() if code is not None}

    def kill(self, executable: str) -> None:
        """Ends a process without warning."""
        running = self._running.pop(executable)
        _signal_group(running, signal.SIGKILL)
        running.wait()

    def stop_all(self, patience: float = 10.0) -> dict[str, int]:
        """Stops all processes and returns their exit codes.

        Args:
            patience: seconds to wait for a process before it is killed.
        """
        for running in self._running.values():
            _signal_group(running, signal.SIGTERM)
        codes = {name: _wait(running, patience) for name, running in self._running.items()}
        self._running.clear()
        return codes


def _wait(running: subprocess.Popen[Any], patience: float) -> int:
    try:
        return running.wait(patience)
    except subprocess.TimeoutExpired:
        _signal_group(running, signal.SIGKILL)
        return running.wait()


def _signal_group(running: subprocess.Popen[Any], number: signal.Signals) -> None:
    with suppress(ProcessLookupError):
        os.killpg(running.pid, number)
