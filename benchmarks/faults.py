"""Random faults of topics and nodes, by a seeded generator."""

from __future__ import annotations

import os
import random
import signal
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from processes import ENGINE, MANAGER
from running_system import FAR_ENGINE, REASONER, RunningSystem

NODES = (ENGINE, FAR_ENGINE, REASONER, MANAGER, 'semantic_matching_engine')
"""The nodes that evaluate formulas; the others hold data without a copy elsewhere."""

HIGH = 500.0
"""A level that makes formulas false."""

CALM = 1.0


@dataclass
class Faults:
    """Generator of faults at random times, which repairs them later.

    Args:
        nodes: the nodes to kill and to stop.
        topics: False if no topic fails; then levels become high, and nodes fail.
    """

    system: RunningSystem
    chance: random.Random
    nodes: Sequence[str]
    topics: bool = True
    injected: Counter[str] = field(default_factory=Counter)
    _due: list[tuple[float, Callable[[], None]]] = field(default_factory=list)
    _next: float = 0.0
    _failed: set[str] = field(default_factory=set)

    def step(self) -> None:
        """Inject and repair the faults that are due."""
        now = time.monotonic()
        for each in [each for each in self._due if each[0] <= now]:
            self._due.remove(each)
            each[1]()
        if now >= self._next:
            self._next = now + self.chance.uniform(0.5, 2.5)
            topics = (self._pause, self._delay, self._confuse) if self.topics else ()
            nodes = (self._stop, self._kill)
            fault = self.chance.choice((*topics, *nodes, self._raise, self._raise))
            fault()

    def repair_all(self) -> None:
        """Repair all faults at once, and inject no more."""
        self._next = float('inf')
        for _, repair in sorted(self._due, key=lambda each: each[0]):
            repair()
        self._due.clear()

    def _repair_after(self, seconds: float, repair: Callable[[], None]) -> None:
        self._due.append((time.monotonic() + seconds, repair))

    def _pause(self) -> None:
        name = self.chance.choice(self.system.batteries)
        self.injected['topic silent'] += 1
        self.system.command('pause', name)
        self._repair_after(
            self.chance.uniform(0.2, 3.0), lambda: self.system.command('resume', name) and None
        )

    def _delay(self) -> None:
        name = self.chance.choice(self.system.batteries)
        self.injected['topic late'] += 1
        self.system.command('late', name, self.chance.uniform(50, 600))
        self._repair_after(
            self.chance.uniform(0.5, 2.0), lambda: self.system.command('late', name, 0) and None
        )

    def _confuse(self) -> None:
        name, how = self.chance.choice(self.system.batteries), self.chance.choice(('twice', 'swap'))
        self.injected[f'topic {how}'] += 1
        self.system.command(how, name)

    def _raise(self) -> None:
        """Raise the level of all batteries of a vehicle for a while, which is no fault."""
        names = self.chance.choice(list(self.system.sources.values()))
        self.injected['level high'] += 1
        self._set(names, HIGH)
        self._repair_after(self.chance.uniform(0.05, 1.5), lambda: self._set(names, CALM))

    def _set(self, names: tuple[str, ...], level: float) -> None:
        for name in names:
            self.system.command('set', name, level)

    def _stop(self) -> None:
        node = self._choose_node()
        if node:
            self.injected[f'{node} stopped'] += 1
            pid = self.system.pids[node]
            os.killpg(pid, signal.SIGSTOP)

            def resume() -> None:
                os.killpg(pid, signal.SIGCONT)
                self._failed.discard(node)

            # Another engine takes over the streams of one that is stopped for long.
            longest = 30.0 if node in {ENGINE, FAR_ENGINE} else 4.0
            self._repair_after(0.2 * (longest / 0.2) ** self.chance.random(), resume)

    def _kill(self) -> None:
        node = self._choose_node()
        if node:
            self.injected[f'{node} killed'] += 1
            self.system.kill(node)

            def restart() -> None:
                self.system.start(node)
                self._repair_after(3.0, lambda: self._failed.discard(node))

            self._repair_after(self.chance.uniform(0.0, 3.0), restart)

    def _choose_node(self) -> str:
        """Return a node to fail; empty if a node has failed already or none may fail."""
        if self._failed or not self.nodes:
            return ''
        node = self.chance.choice(self.nodes)
        self._failed.add(node)
        return node
