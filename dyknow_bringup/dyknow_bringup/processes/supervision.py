"""Restarts of processes that end by themselves.

Example, with a process that is killed again and again, and then has a fault at its start:

     0 s  killed by SIGKILL; started again at once
     1 s  killed by SIGKILL; started again after 2 s
     4 s  killed by SIGKILL; started again after 4 s
    50 s  it has run for 30 s, and ends with exit code 70; started again at once
    51 s  it ends with exit code 70, 1 s after its start: the first fault; started again after 2 s
    54 s  the same: the second fault; started again after 4 s
    59 s  the same: the third fault ends the system
"""

from __future__ import annotations

import signal
from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Final

from dyknow_bringup.errors import BringupError
from dyknow_bringup.processes.launcher import EndedProcess, Launcher
from dyknow_bringup.processes.processes import Process
from dyknow_common import SECOND_NS, ExitCode, format_duration
from dyknow_common.executables import CANNOT_START

RESTART_DELAY_NS: Final = 2 * SECOND_NS
"""After the second end in a row, which each further end doubles; the first one needs no wait.

A guard stays closed meanwhile. The other nodes tell by the times of start that a node is a new one.
"""

MAX_DELAY_NS: Final = 30 * SECOND_NS
STABLE_NS: Final = 30 * SECOND_NS
"""After a process has run for so long, earlier ends do not matter."""

MAX_FAULTS: Final = 3
AT_ONCE_NS: Final = 10 * SECOND_NS
"""A process that ends MAX_FAULTS times so soon after its start, and is not killed, does not run."""

_KILLED: Final = (-signal.SIGKILL, -signal.SIGTERM)
"""The exit codes of processes that others end, such as the kernel that lacks memory."""


class Supervisor:
    """Starts the processes of a launcher, and restarts processes that end by themselves.

    Args:
        launcher: has started no process yet.
        processes: the processes.
        report: called with a text about each end and each restart.
        restarts: False if the first process that ends is to end the system.
    """

    def __init__(
        self,
        launcher: Launcher,
        processes: Iterable[Process],
        report: Callable[[str], None],
        *,
        restarts: bool,
    ) -> None:
        self._launcher = launcher
        self._processes = {process.name: process for process in processes}
        self._report = report
        self._restarts = restarts
        self._started_at: dict[str, int] = {}
        self._restart_at: dict[str, int] = {}
        # The ends since a process last ran for long, and the faults in a row.
        self._ends: defaultdict[str, int] = defaultdict(int)
        self._faults: defaultdict[str, int] = defaultdict(int)
        launcher.start_all(self._processes.values())

    def update(self, now: int) -> None:
        """Note the processes that have ended, and restart the ones that are due.

        Raises:
            BringupError: UNAVAILABLE, if a process cannot start, or must not be started again.
        """
        for name in self._processes:
            self._started_at.setdefault(name, now)
        for ended in self._launcher.ended():
            name = ended.name
            if name not in self._restart_at:
                delay = self._delay(ended, now - self._started_at[name])
                self._restart_at[name] = now + delay
                when = f'in {format_duration(delay)}' if delay else 'at once'
                self._report(f'{ended}; it will be started again {when}')
            if now >= self._restart_at[name]:
                del self._restart_at[name]
                self._launcher.start(self._processes[name])
                self._started_at[name] = now
                self._report(f'{name} was started again')

    def _delay(self, ended: EndedProcess, ran: int) -> int:
        """Return the time until a process is started again, which ran for some time."""
        name = ended.name
        if ended.code == CANNOT_START:
            raise BringupError(f'{name} cannot start:\n{ended.last_lines}', ExitCode.UNAVAILABLE)
        is_fault = ran < AT_ONCE_NS and ended.code not in _KILLED
        faults = self._faults[name] = self._faults[name] + 1 if is_fault else 0
        if not self._restarts or faults == MAX_FAULTS:
            within = f', each time within {format_duration(AT_ONCE_NS)} of its start'
            often = f' ({faults} times{within})' if faults == MAX_FAULTS else ''
            raise BringupError(f'{ended}{often}:\n{ended.last_lines}', ExitCode.UNAVAILABLE)
        before = self._ends[name] if ran < STABLE_NS else 0
        self._ends[name] = before + 1
        return min(RESTART_DELAY_NS << before - 1, MAX_DELAY_NS) if before else 0
