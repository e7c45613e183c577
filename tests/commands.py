"""Processes of the installed executables."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import distribution
from typing import TYPE_CHECKING, Any

from dyknow_bringup.resources import executable_path
from dyknow_configuration import PACKAGES

if TYPE_CHECKING:
    from system import Client

EXECUTABLES = {
    script.name: package
    for package in (
        *dict.fromkeys(PACKAGES.values()), 'dyknow_bringup', 'dyknow_dashboard', 'dyknow_command'
    )
    for script in distribution(package).entry_points.select(group='console_scripts')
}  # fmt: skip
"""The executables, each with its package."""


def command(name: str, *arguments: str) -> list[str]:
    """Return the command line of an executable."""
    return [str(executable_path(EXECUTABLES[name], name)), *arguments]


def interruptible(line: Sequence[str]) -> list[str]:
    """Return a command line that SIGINT ends: a shell's background processes ignore it."""
    return ['env', '--default-signal=INT', *line]


def started(line: Sequence[str], environment: Mapping[str, str], **options: Any) -> Any:
    """Start a process, and read what it prints, on `stderr` too if no option says otherwise."""
    options = {'stdout': subprocess.PIPE, 'stderr': subprocess.STDOUT, 'text': True, **options}
    return subprocess.Popen(line, env={**os.environ, **environment}, **options)


@contextmanager
def running(line: list[str], environment: Mapping[str, str]) -> Iterator[subprocess.Popen[str]]:
    """Run a process that SIGTERM ends with exit code 0."""
    process = started(line, environment, start_new_session=True)
    try:
        yield process
        process.send_signal(signal.SIGTERM)
        code = process.wait(60)
        assert code == 0, f'{" ".join(line)} ended with {code}'
    finally:
        # After a failure, the nodes that the process has started must end too.
        process.terminate()
        try:
            process.communicate(timeout=30)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()


@contextmanager
def dyknow_up(environment: Mapping[str, str], *options: str, says: str = '') -> Iterator[None]:
    """Run `dyknow up` from when it says that DyKnow runs, and what it has loaded, on."""
    with running(command('dyknow', 'up', *options), environment) as process:
        assert process.stdout is not None
        assert any(f'DyKnow runs in /: {says}' in line for line in process.stdout)
        yield


def output_of(line: list[str], environment: Mapping[str, str], limit: float = 90.0) -> Any:
    """Run a process until it ends by itself."""
    return subprocess.run(
        line,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=limit,
        check=False,
    )


def output_beside(
    client: Client, line: Sequence[str], environment: Mapping[str, str], **options: Any
) -> subprocess.CompletedProcess[str]:
    """Run a process until it ends by itself, and the callbacks of a client meanwhile."""
    process = started(line, environment, **options)
    client.spin_until(lambda: process.poll() is not None, ' '.join(line), 90.0)
    out, err = process.communicate()
    return subprocess.CompletedProcess(list(line), process.returncode, out, err)
