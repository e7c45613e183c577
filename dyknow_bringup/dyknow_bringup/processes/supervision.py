"""Restarts of processes that end by themselves."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Final

from dyknow_bringup.errors import BringupError
from dyknow_bringup.processes.launcher import EndedProcess, Launcher
from dyknow_bringup.processes.processes import Process
from dyknow_common import SECOND_NS, ExitCode, format_duration
from dyknow_common.executables import CANNOT_START

RESTART_DELAY_NS: Final = 2 * SECOND_NS
"""By then, the other nodes have noticed the end in most cases."""

MAX_ENDS: Final = 3
PERIOD_NS: Final = 30 * SECOND_NS
"""A process that ends MAX_ENDS times in this period ends the system."""


class Supervisor:
    """Starts the processes of a launcher, and starts those again that end by themselves.

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
        self._restart_at: dict[str, int] = {}
        self._ends: defaultdict[str, list[int]] = defaultdict(list)
        launcher.start_all(self._processes.values())

    def update(self, now: int) -> None:
        """Note the processes that have ended, and start those again that are due.

        Raises:
            BringupError: UNAVAILABLE, if a process cannot start, or must not be started again.
        """
        for ended in self._launcher.ended():
            name = ended.name
            if name not in self._restart_at:
                self._check(ended, now)
                self._restart_at[name] = now + RESTART_DELAY_NS
                self._report(f'{ended}; it will be started again')
            elif now >= self._restart_at[name]:
                del self._restart_at[name]
                self._launcher.start(self._processes[name])
                self._report(f'{name} was started again')

    def _check(self, ended: EndedProcess, now: int) -> None:
        if ended.code == CANNOT_START:
            raise BringupError(
                f'{ended.name} cannot start:\n{ended.last_lines}', ExitCode.UNAVAILABLE
            )
        ends = self._ends[ended.name]
        ends[:] = [*(each for each in ends if now - each < PERIOD_NS), now]
        if not self._restarts or len(ends) == MAX_ENDS:
            often = f' (end {len(ends)} within {format_duration(PERIOD_NS)})' if ends[1:] else ''
            raise BringupError(f'{ended}{often}:\n{ended.last_lines}', ExitCode.UNAVAILABLE)
