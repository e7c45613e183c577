"""The lives of nodes in a soak: their deaths, memory, open files, and the faults they log."""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from processes import growth_per_minute, memory_of_group, open_files
from running_system import RunningSystem

SAMPLE_PERIOD_S = 1.0
"""Time between two measurements of memory and files."""

MAX_MEMORY_MB = 3000.0
"""A node that has more is killed, to protect the machine, which counts as its death."""

MIN_LIFE_S = 300.0
"""Minimum life of a node for its growth to count: it warms up for minutes."""

WARM_UP = 0.4
MAX_EXAMPLES = 5
_FAULT = re.compile(
    r'fault in |Traceback|MemoryError|Segmentation fault|terminate called|Fatal Python'
)


@dataclass
class Lives:
    """The lives of the nodes of a system: their deaths, memory and open files."""

    system: RunningSystem
    logs: Path | None
    deaths: list[str] = field(default_factory=list)
    _samples: dict[tuple[str, int], list[tuple[float, float, int]]] = field(default_factory=dict)
    _next: float = 0.0

    def step(self) -> None:
        """Measure, and start the nodes again that have ended."""
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + SAMPLE_PERIOD_S
        for ended in self.system.launcher.ended():
            self.deaths.append(f'{ended}: {ended.last_lines[-600:]}')
            self.system.start(ended.name)
        for name, pid in self.system.pids.items():
            with suppress(OSError):
                memory, files = memory_of_group(pid), open_files(pid)
                self._samples.setdefault((name, pid), []).append((now, memory, files))
                if memory > MAX_MEMORY_MB:
                    self.deaths.append(f'{name} was killed: it had {memory:.0f} MB')
                    self.system.launcher.kill(name)
                    self.system.start(name)

    def report(self) -> dict[str, dict[str, Any]]:
        """Return memory and files of each node, over the longest of its lives."""
        lives: dict[str, list[tuple[float, float, int]]] = {}
        for (name, _), found in self._samples.items():
            lives[name] = max(lives.get(name, []), found, key=len)
        return {
            name: {
                'memory_mb': [round(found[0][1]), round(found[-1][1])],
                'most_mb': round(max(each[1] for each in found)),
                'growth_mb_per_minute': growth_per_minute([each[:2] for each in found], WARM_UP)
                if found[-1][0] - found[0][0] > MIN_LIFE_S
                else None,
                'files': [found[0][2], found[-1][2]],
                'most_files': max(each[2] for each in found),
            }
            for name, found in lives.items()
        }

    def faults(self) -> dict[str, list[str]]:
        """Return the faults that the nodes logged, and what follows each."""
        found = {}
        for path in sorted(self.logs.glob('*.log')) if self.logs else ():
            lines = path.read_text(encoding='utf-8', errors='replace').splitlines()
            places = [place for place, line in enumerate(lines) if _FAULT.search(line)]
            texts = {_last_line(lines[place : place + 60]): None for place in places}
            if texts:
                found[path.stem] = [f'{len(places)} lines', *list(texts)[:MAX_EXAMPLES]]
        return found


def _last_line(lines: Sequence[str]) -> str:
    """Return the first line of a fault, and the last one of its traceback."""
    end = next((line for line in lines[1:] if re.match(r'\w+(\.\w+)*(Error|Exception)', line)), '')
    return f'{lines[0][:200]} … {end[:200]}'
