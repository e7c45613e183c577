"""Checks that run as processes, and recordings that keep them busy."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

from small_bags import channel, chunk, mcap, schema, stored

from dyknow_recordings.check import main

LIMIT_S = 180
CODE = 'import sys; from dyknow_recordings.check import main; sys.exit(main(sys.argv[1:]))'
FORMULAS = ('always "/odom".pose.pose.position.z < 58', 'always x.y = 1', 'always "/armed".data')
OPTIONS = [word for each in FORMULAS for word in ('--formula', each)]


class CheckOutput(NamedTuple):
    """The exit code of a check, and what it printed."""

    code: int
    out: str
    err: str

    @property
    def document(self) -> Any:
        """The only line of JSON."""
        (line,) = self.out.splitlines()
        return json.loads(line)

    @property
    def formulas(self) -> list[Any]:
        found: list[Any] = self.document['formulas']
        return found

    @property
    def by_name(self) -> dict[str, Any]:
        """The results of formulas by their names."""
        return {each['name']: each for each in self.formulas}


def run_check(*arguments: object) -> CheckOutput:
    """Run a check in this process."""
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main(list(map(str, arguments)))
    return CheckOutput(code, out.getvalue(), err.getvalue())


class EndlessRecording:
    """A small file with so many messages that a process reads it until it is killed."""

    def __init__(self, path: Path) -> None:
        messages = [stored(1, 1, b'\0\1\0\0\1')] * 50_000
        part = chunk(messages, (1, 1), 'zstd')
        definition = schema(1, 'std_msgs/msg/Bool', 'bool data') + channel(1, 1, '/armed')
        path.write_bytes(mcap(definition, *[part] * 20_000))
        self.path = path

    def wait_for_reader(self) -> None:
        self.reader()

    def reader(self) -> int:
        """Return the process that reads it."""
        return wait_for(self._reader, f'process that reads {self.path}')

    def _reader(self) -> int | None:
        for maps in Path('/proc').glob('[0-9]*/maps'):
            with suppress(OSError):
                if str(self.path) in maps.read_text():
                    return int(maps.parts[2])
        return None


def wait_for(condition: Callable[[], Any], description: str) -> Any:
    deadline = time.monotonic() + LIMIT_S
    while not (found := condition()):
        assert time.monotonic() < deadline, f'no {description}'
        time.sleep(0.05)
    return found


@contextmanager
def checking(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A running check; it has left no process when the block ends."""
    process = subprocess.Popen(
        [sys.executable, '-c', CODE, *arguments, *OPTIONS],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
        process.wait(LIMIT_S)
        wait_for(lambda: not workers_of(process.pid), 'end of the processes')
    finally:
        for worker in workers_of(process.pid):
            os.kill(worker, signal.SIGKILL)
        process.kill()
        process.communicate()


def workers_of(parent: int) -> list[int]:
    """The running processes that have a parent."""
    found = []
    for stat in Path('/proc').glob('[0-9]*/stat'):
        with suppress(OSError):
            state, ppid = stat.read_text().rpartition(')')[2].split()[:2]
            if int(ppid) == parent and state != 'Z':
                found.append(int(stat.parts[2]))
    return found


def names(lines: str) -> list[tuple[str, str | None]]:
    """The recordings of JSON lines, with the codes of their errors."""
    documents = [json.loads(line) for line in lines.splitlines()]
    return [(each['recording'], each['error'] and each['error']['code']) for each in documents]
