"""Random faults of topics and nodes, by a generator that is seeded."""

from __future__ import annotations

import os
import random
import signal
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from processes import ENGINE, MANAGER
from whole import FAR_ENGINE, REASONER, Whole

NODES = (ENGINE, FAR_ENGINE, REASONER, MANAGER, 'semantic_matching_engine')
"""Those that formulas are evaluated by; the others hold what is known, and are asked."""

HIGH = 500.0
"""A level that makes formulas false."""

CALM = 1.0


@dataclass
class Faults:
    """Makes something go wrong now and then, and right again later.

    Args:
        nodes: those that are killed and stopped.
    """

    whole: Whole
    chance: random.Random
    nodes: Sequence[str]
    happened: Counter[str] = field(default_factory=Counter)
    _due: list[tuple[float, Callable[[], None]]] = field(default_factory=list)
    _next: float = 0.0
    _ill: set[str] = field(default_factory=set)

    def turn(self) -> None:
        """Does what is due."""
        now = time.monotonic()
        for each in [each for each in self._due if each[0] <= now]:
            self._due.remove(each)
            each[1]()
        if now >= self._next:
            self._next = now + self.chance.uniform(0.5, 2.5)
            topics = (self._pause, self._delay, self._confuse)
            nodes = (self._stop, self._kill)
            fault = self.chance.choice((*topics, *nodes, self._raise, self._raise))
            fault()

    def heal(self) -> None:
        """Makes all go right again, at once."""
        self._next = float('inf')
        for _, mend in sorted(self._due, key=lambda each: each[0]):
            mend()
        self._due.clear()

    def _for(self, seconds: float, mend: Callable[[], None]) -> None:
        self._due.append((time.monotonic() + seconds, mend))

    def _pause(self) -> None:
        name = self.chance.choice(self.whole.batteries)
        self.happened['topic silent'] += 1
        self.whole.order('pause', name)
        self._for(self.chance.uniform(0.2, 3.0), lambda: self.whole.order('resume', name) and None)

    def _delay(self) -> None:
        name = self.chance.choice(self.whole.batteries)
        self.happened['topic late'] += 1
        self.whole.order('late', name, self.chance.uniform(50, 600))
        self._for(self.chance.uniform(0.5, 2.0), lambda: self.whole.order('late', name, 0) and None)

    def _confuse(self) -> None:
        name, how = self.chance.choice(self.whole.batteries), self.chance.choice(('twice', 'swap'))
        self.happened[f'topic {how}'] += 1
        self.whole.order(how, name)

    def _raise(self) -> None:
        """No fault: a level goes high for a while, on all batteries of a vehicle."""
        names = self.chance.choice(list(self.whole.sources.values()))
        self.happened['level high'] += 1
        self._set(names, HIGH)
        self._for(self.chance.uniform(0.05, 1.5), lambda: self._set(names, CALM))

    def _set(self, names: tuple[str, ...], level: float) -> None:
        for name in names:
            self.whole.order('set', name, level)

    def _stop(self) -> None:
        node = self._well()
        if node:
            self.happened[f'{node} stopped'] += 1
            pid = self.whole.pids[node]
            os.killpg(pid, signal.SIGSTOP)

            def go_on() -> None:
                os.killpg(pid, signal.SIGCONT)
                self._ill.discard(node)

            self._for(self.chance.uniform(0.2, 4.0), go_on)

    def _kill(self) -> None:
        node = self._well()
        if node:
            self.happened[f'{node} killed'] += 1
            self.whole.kill(node)

            def restart() -> None:
                self.whole.start(node)
                self._for(3.0, lambda: self._ill.discard(node))

            self._for(self.chance.uniform(0.0, 3.0), restart)

    def _well(self) -> str:
        """A node to fail; none where one is ill already, or none is to."""
        if self._ill or not self.nodes:
            return ''
        node = self.chance.choice(self.nodes)
        self._ill.add(node)
        return node
