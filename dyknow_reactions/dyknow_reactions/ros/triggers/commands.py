"""The action of a trigger that runs a command."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
from contextlib import suppress
from typing import Final

from dyknow_common import DyKnowError
from dyknow_common.ros import NodeAdapter
from dyknow_configuration import Trigger, filled
from dyknow_reactions.ros.triggers.actions import End, GiveUp
from dyknow_reactions.triggers import TriggerReport

POLL_PERIOD_S: Final = 0.05
"""The period in which a command is looked at."""

SHOWN: Final = 300
"""The number of bytes of its error output that a message shows, from the end."""

MAX_ERRORS: Final = 1_000_000
"""The number of bytes of its error output that are kept in a file."""

KILL_TIMEOUT_S: Final = 1.0
"""The time in which a killed process ends, unless a device blocks it."""


class RunAction:
    """Runs a command as a child process, without a shell.

    Raises:
        ConfigurationError: if there is no such command.
    """

    def __init__(self, node: NodeAdapter, trigger: Trigger) -> None:
        self._node = node
        self._arguments = tuple(trigger.content)
        self._command = command_of(trigger)

    def begin(self, report: TriggerReport, end: End) -> GiveUp:
        """Start the process."""
        line = [self._command, *(filled(each, report.texts) for each in self._arguments)]
        try:
            process = _Process(self._node, line, end)
        except (OSError, ValueError) as error:
            raise DyKnowError(f'{self._command} cannot be run: {error}') from None
        return process.give_up

    def close(self) -> None:
        """Do nothing: there is nothing to release."""


def command_of(trigger: Trigger) -> str:
    """Return the path of the command of a trigger.

    Raises:
        ConfigurationError: if there is none.
    """
    found = shutil.which(trigger.target)
    if found is None:
        text = f"there is no command '{trigger.target}'; install it, or give its path"
        raise trigger.error(text, ('run', 0))
    return found


class _Process:
    """A child process with its own children, which end with it."""

    def __init__(self, node: NodeAdapter, line: list[str], end: End) -> None:
        self._node = node
        self._end = end
        self._is_over = False
        # A pipe that is not read would stop the process.
        self._errors = tempfile.TemporaryFile('a+b', buffering=0)  # noqa: SIM115 - it is closed at the end
        self._last_errors = b''
        try:
            self._process = subprocess.Popen(
                line,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=self._errors,
                start_new_session=True,
            )
        except BaseException:
            self._errors.close()
            raise
        self._poll_later()

    def give_up(self) -> str:
        """Kill the process with its children, and return the reason."""
        self._is_over = True
        self._errors.close()
        try:
            os.killpg(self._process.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        except PermissionError:
            return 'the command has not ended, and runs as another user who alone may kill it'
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(KILL_TIMEOUT_S)
        return 'the command has not ended: it was killed'

    def _poll_later(self) -> None:
        later = self._node.deadlines.after(POLL_PERIOD_S)
        later.add_done_callback(lambda _: self._poll())

    def _poll(self) -> None:
        if self._is_over:
            return
        code = self._process.poll()
        if code is None:
            self._limit_errors()
            self._poll_later()
            return
        self._is_over = True
        last = ' '.join(self._end_of_errors().decode(errors='replace').split())
        self._errors.close()
        self._end(f'exit code {code}{f": {last}" if last else ""}' if code else '')

    def _limit_errors(self) -> None:
        """Empty the file of the error output if it is long, but for its end."""
        if os.fstat(self._errors.fileno()).st_size > MAX_ERRORS:
            self._last_errors = self._end_of_errors()
            # The process appends, so it continues at the new end.
            self._errors.truncate(0)

    def _end_of_errors(self) -> bytes:
        self._errors.seek(max(0, self._errors.seek(0, os.SEEK_END) - SHOWN))
        return (self._last_errors + self._errors.read(SHOWN))[-SHOWN:]
