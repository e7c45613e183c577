"""Random faults of topics and nodes, by a seeded generator."""

from __future__ import annotations

import os
import random
import signal
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from processes import ENGINE, MANAGER
from running_system import REASONER, SECOND_ENGINE, RunningSystem

NODES = (ENGINE, SECOND_ENGINE, REASONER, MANAGER, 'semantic_matching_engine')
"""The nodes that evaluate formulas; the others hold data without a copy elsewhere."""

HIGH = 500.0
"""A level that makes formulas false."""

CALM = 1.0


@dataclass
class Faults:
    """Generator of faults at random times, which repairs them later.

    High levels, which are no faults, end formulas that would else hold until their timeouts.

    Args:
        topics: True if topics fail.
        nodes: True if nodes fail.
    """

    system: RunningSystem
    chance: random.Random
    topics: bool = True
    nodes: bool = True
    injected: Counter[str] = field(default_factory=Counter)
    _due: list[tuple[float, Callable[[], object]]] = field(default_factory=list)
    _next: float = 0.0
    _failed: str = ''

    def step(self) -> None:
        """Inject and repair the faults that are due."""
        now = time.monotonic()
        for each in [each for each in self._due if each[0] <= now]:
            self._due.remove(each)
            each[1]()
        if now >= self._next:
            self._next = now + self.chance.uniform(0.5, 2.5)
            self.chance.choice(
                (
                    *((self._silence, self._delay, self._confuse) if self.topics else ()),
                    *((self._stop, self._kill) if self.nodes else ()),
                    *[self._raise] * 2,
                )
            )()

    def repair_all(self) -> None:
        """Repair all faults at once, and inject no more."""
        self._next = float('inf')
        while self._due:
            self._due.sort(key=lambda each: each[0])
            self._due.pop(0)[1]()

    def _repair_after(self, seconds: float, repair: Callable[[], object]) -> None:
        self._due.append((time.monotonic() + seconds, repair))

    def _silence(self) -> None:
        name = self.chance.choice(self.system.batteries)
        self.injected['topic silent'] += 1
        self.system.command('pause', name)
        seconds = self.chance.uniform(0.2, 3.0)
        self._repair_after(seconds, lambda: self.system.command('resume', name))

    def _delay(self) -> None:
        name = self.chance.choice(self.system.batteries)
        self.injected['topic late'] += 1
        self.system.command('late', name, self.chance.uniform(50, 600))
        seconds = self.chance.uniform(0.5, 2.0)
        self._repair_after(seconds, lambda: self.system.command('late', name, 0))

    def _confuse(self) -> None:
        name, how = self.chance.choice(self.system.batteries), self.chance.choice(('twice', 'swap'))
        self.injected[f'topic {how}'] += 1
        self.system.command(how, name)

    def _raise(self) -> None:
        """Raise the level of all batteries of a vehicle for a while."""
        names = self.chance.choice(list(self.system.sources.values()))
        self.injected['level high'] += 1
        self._set(names, HIGH)
        self._repair_after(self.chance.uniform(0.05, 1.5), lambda: self._set(names, CALM))

    def _set(self, names: tuple[str, ...], level: float) -> None:
        for name in names:
            self.system.command('set', name, level)

    def _stop(self) -> None:
        node = self._fail('stopped')
        if node:
            pid = self.system.pids[node]
            os.killpg(pid, signal.SIGSTOP)

            def resume() -> None:
                os.killpg(pid, signal.SIGCONT)
                self._failed = ''

            # Another engine takes over the streams of one that is stopped for long.
            longest = 30.0 if node in {ENGINE, SECOND_ENGINE} else 4.0
            self._repair_after(0.2 * (longest / 0.2) ** self.chance.random(), resume)

    def _kill(self) -> None:
        node = self._fail('killed')
        if node:
            self.system.launcher.kill(node)

            def restart() -> None:
                self.system.start(node)
                self._repair_after(3.0, lambda: setattr(self, '_failed', ''))

            self._repair_after(self.chance.uniform(0.0, 3.0), restart)

    def _fail(self, how: str) -> str:
        """Return a node to fail; empty if another one has failed and was not repaired."""
        if self._failed:
            return ''
        # The nodes of one process do not fail alone.
        self._failed = self.chance.choice([each for each in NODES if each in self.system.pids])
        self.injected[f'{self._failed} {how}'] += 1
        return self._failed
