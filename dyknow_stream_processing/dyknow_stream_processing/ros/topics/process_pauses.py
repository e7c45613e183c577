"""Pauses of a process: times in which none of its threads ran.

After a pause, by SIGSTOP or for want of a processor, callbacks may run before the threads of the
middleware have read what was sent meanwhile. To take a topic for silent then would be wrong:

     0.00 s  the process is stopped; a message is sent to it
     5.00 s  it continues; a timer is due
     5.00 s  the callback of the timer runs: no message seems to have come
     5.01 s  the middleware receives the message
     5.25 s  the pause is over: all messages of the time before have been received
"""

from __future__ import annotations

import threading
import time
from typing import Final

from dyknow_common import NANOSECONDS

_PERIOD_S: Final = 0.05
"""The time between two signs of life."""

PAUSE_NS: Final = 200 * NANOSECONDS['ms']
"""The least time without a sign of life that counts as a pause."""

SETTLING_NS: Final = 250 * NANOSECONDS['ms']
"""The time after a pause until the middleware has received what was sent meanwhile."""


class ProcessPauses:
    """Detector of pauses, by a thread that gives signs of life; a long callback is no pause."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last = time.monotonic_ns()
        self._began: int | None = None
        self._settled_at = 0
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start the thread, if it does not run."""
        if self._thread is None:
            self._last = time.monotonic_ns()
            self._thread = threading.Thread(target=self._run, daemon=True)
            self._thread.start()

    def unsettled_for(self) -> int | None:
        """Return the nanoseconds since the begin of a pause that is not over; `None` without one."""
        now = time.monotonic_ns()
        with self._lock:
            # The thread may not have run since the pause.
            self.note(now, is_alive=False)
            return None if self._began is None else now - self._began

    def note(self, now: int, *, is_alive: bool = True) -> None:
        """Process a sign of life, or the lack of one, at a time of the monotonic clock."""
        if now - self._last > PAUSE_NS:
            # Of several pauses, the first one began before all messages that still wait.
            self._began = self._last if self._began is None else self._began
            self._settled_at = now + SETTLING_NS
        elif now >= self._settled_at:
            self._began = None
        if is_alive or self._began is not None:
            self._last = now

    def _run(self) -> None:
        while True:
            time.sleep(_PERIOD_S)
            with self._lock:
                self.note(time.monotonic_ns())


PAUSES: Final = ProcessPauses()
"""The pauses of this process."""
