"""The output of `dyknow up`, as a terminal shows it, and the rover that it may be started for."""

from __future__ import annotations

import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from commands import command, running
from system import LIMIT
from test_rover import EXAMPLES

ROVER = [
    '--ontology', str(EXAMPLES / 'rover.owl'), '--annotations', str(EXAMPLES / 'rover.ssl'),
    '--streams', str(EXAMPLES / 'rover.streams'),
]  # fmt: skip

COMMAND_LENGTH = 15
"""The characters of the name of a process; Linux cuts longer ones."""


class Terminal:
    """The output of a running process."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self._lines: list[str] = []
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    @property
    def text(self) -> str:
        return ''.join(self._lines)

    def send_signal(self, number: signal.Signals) -> None:
        """Signal the process."""
        self._process.send_signal(number)

    def child(self, executable: str) -> int:
        """Return a process that the process has started, by its executable."""
        name = executable[:COMMAND_LENGTH]
        for tasks in Path(f'/proc/{self._process.pid}/task').glob('*/children'):
            for child in tasks.read_text(encoding='utf-8').split():
                if Path(f'/proc/{child}/comm').read_text(encoding='utf-8').strip() == name:
                    return int(child)
        raise AssertionError(f'{executable} does not run')

    def join(self) -> None:
        """Wait for the end of the output."""
        self._thread.join(LIMIT)

    def wait_for(self, text: str) -> None:
        end = time.monotonic() + LIMIT
        while text not in self.text:
            assert time.monotonic() < end, f'no {text!r} in: {self.text}'
            time.sleep(0.05)

    def _read(self) -> None:
        assert self._process.stdout is not None
        self._lines.extend(self._process.stdout)


@contextmanager
def up(environment: dict[str, str], *options: str) -> Iterator[Terminal]:
    """Run `dyknow up` with a terminal."""
    with running(command('dyknow', 'up', *options), environment) as process:
        yield Terminal(process)


def faulty(folder: Path, name: str, text: str) -> list[str]:
    """Return the option for a file of the rover with some text added."""
    file = folder / f'faulty.{name}'
    file.write_text((EXAMPLES / f'rover.{name}').read_text(encoding='utf-8') + text)
    return ['--annotations' if name == 'ssl' else '--streams', str(file)]
