"""Start and stop processes without the launch package."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from dyknow_bringup.errors import BringupError
from dyknow_bringup.processes.logs import LOG_ENVIRONMENT, last_lines
from dyknow_bringup.processes.processes import Process, ros_arguments
from dyknow_bringup.resources import executable_path
from dyknow_common import ExitCode
from dyknow_common.executables import LAUNCHER


@dataclass(frozen=True, slots=True)
class EndedProcess:
    """A process that has ended by itself.

    Args:
        name: the name of the process.
        code: its exit code; the negative number of a signal that killed it.
        last_lines: the end of its log.
    """

    name: str
    code: int
    last_lines: str

    def __str__(self) -> str:
        if self.code < 0:
            return f'{self.name} was killed by {signal.Signals(-self.code).name}'
        return f'{self.name} ended with exit code {self.code}'


class Launcher:
    """Processes that are stopped at the end of a `with` block, or with the process of the launcher.

    Args:
        logs: a folder for the output of each process.
        environment: variables that differ from this process's.
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
        self._environment = {
            **os.environ,
            **LOG_ENVIRONMENT,
            **(environment or {}),
            LAUNCHER: str(os.getpid()),
        }
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop_all()

    def start_all(self, processes: Iterable[Process]) -> None:
        """Start processes.

        Raises:
            BringupError: NOT_FOUND, if an executable is not installed.
        """
        for process in processes:
            self.start(process)

    def start(self, process: Process) -> subprocess.Popen[bytes]:
        """Start a process in a session of its own, so that only the launcher stops it.

        Raises:
            BringupError: NOT_FOUND, if the executable is not installed.
        """
        arguments = ros_arguments(
            process, self._namespace, self._log_level, use_sim_time=self._use_sim_time
        )
        executable = executable_path(process.package, process.executable)
        with self.log(process.name).open('ab') as log:
            running = subprocess.Popen(
                [str(executable), *arguments],
                stdout=log,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                start_new_session=True,
                env=self._environment,
            )
        self._running[process.name] = running
        return running

    def log(self, name: str) -> Path:
        """Return the file with the output of a process."""
        return self._logs / f'{name.replace("/", ".")}.log'

    def ended(self) -> tuple[EndedProcess, ...]:
        """Return the processes that have ended by themselves and were not started again."""
        return tuple(
            EndedProcess(name, code, last_lines(self.log(name).read_text(errors='replace')))
            for name, running in self._running.items()
            if (code := running.poll()) is not None
        )

    def check_running(self) -> None:
        """Check that no process has ended by itself.

        Raises:
            BringupError: UNAVAILABLE, with the end of the log of a process that has ended.
        """
        for ended in self.ended():
            raise BringupError(f'{ended}:\n{ended.last_lines}', ExitCode.UNAVAILABLE)

    def kill(self, name: str) -> None:
        """Kill a process, by the name of its node."""
        running = self._running.pop(name)
        _signal_group(running, signal.SIGKILL)
        running.wait()

    def stop(self, name: str, timeout_s: float = 10.0) -> int:
        """Stop a process, by the name of its node, and return its exit code."""
        running = self._running.pop(name)
        _signal_group(running, signal.SIGTERM)
        return _wait(running, timeout_s)

    def stop_all(self, timeout_s: float = 10.0) -> dict[str, int]:
        """Stop all processes, kill them after the timeout, and return their exit codes."""
        for running in self._running.values():
            _signal_group(running, signal.SIGTERM)
        codes = {name: _wait(running, timeout_s) for name, running in self._running.items()}
        self._running.clear()
        return codes


def _wait(running: subprocess.Popen[Any], timeout_s: float) -> int:
    try:
        return running.wait(timeout_s)
    except subprocess.TimeoutExpired:
        _signal_group(running, signal.SIGKILL)
        return running.wait()


def _signal_group(running: subprocess.Popen[Any], number: signal.Signals) -> None:
    with suppress(ProcessLookupError):
        os.killpg(running.pid, number)
