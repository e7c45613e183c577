"""Processes of hostile clients, which are killed and started again."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import hostile_client

FAULTS = ('fault', 'INTERNAL_ERROR')
"""Beginnings of outcomes that must not be: of faults of a client, and of a node."""

MAY_WAIT = 'random_requests'
"""The row whose formulas may have a long timeout; the requests of others end in 10 s."""

KILL_PERIOD_S = 12.0
"""Time between two hostile clients that are killed."""


class HostileProcesses:
    """Processes of hostile clients.

    Args:
        number: of processes.
        rows: the names of the rows.
        chance: decides who is killed, and when.
        folder: for their files; the nodes may read it.
    """

    def __init__(
        self, number: int, rows: Sequence[str], chance: random.Random, folder: Path
    ) -> None:
        self._environment = {**os.environ, 'TMPDIR': str(folder)}
        self._rows = rows
        self._chance = chance
        self._outcomes: defaultdict[str, Counter[str]] = defaultdict(Counter)
        self._slowest: Counter[str] = Counter()
        self._running = [self._start() for _ in range(number)]
        self._next_kill = time.monotonic() + KILL_PERIOD_S

    def step(self) -> None:
        """Kill a client if one is due, and start the clients again that have ended."""
        now = time.monotonic()
        if self._running and now > self._next_kill:
            self._next_kill = now + self._chance.uniform(0.5, 1.5) * KILL_PERIOD_S
            self._chance.choice(self._running).kill()
        for place, each in enumerate(self._running):
            if each.poll() is not None:
                how = 'killed' if each.returncode < 0 else f'fault: exit code {each.returncode}'
                self._outcomes['clients'][how] += 1
                self._running[place] = self._start()

    def stop(self) -> None:
        """Kill all clients."""
        for each in self._running:
            each.kill()
            each.wait()

    def report(self) -> dict[str, dict[str, float]]:
        """Return the outcomes of each row, with the seconds of its slowest answer."""
        return {
            name: {**self._outcomes[name], 'slowest_s': self._slowest[name]}
            for name in sorted(self._outcomes)
        }

    def faults(self) -> list[str]:
        """Return the outcomes that must not be."""
        return [
            f'{row}: {outcome}'
            for row, found in self._outcomes.items()
            for outcome in found
            if outcome.startswith(FAULTS) or (outcome == 'unanswered' and row != MAY_WAIT)
        ]

    def _start(self) -> subprocess.Popen[str]:
        seed = self._chance.randrange(10**6)
        started = subprocess.Popen(
            [sys.executable, hostile_client.__file__, str(seed), *self._rows],
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
            env=self._environment,
        )
        threading.Thread(target=self._read, args=(started,), daemon=True).start()
        return started

    def _read(self, client: subprocess.Popen[str]) -> None:
        for line in client.stdout or ():
            with suppress(ValueError):  # A line of a killed client may be cut.
                self._note(json.loads(line))

    def _note(self, found: dict[str, Any]) -> None:
        name = found['row']
        self._outcomes[name][found['outcome']] += found['number']
        self._slowest[name] = max(self._slowest[name], round(found['seconds'], 2))
