"""Checks of several recordings at a time, compared with those one after the other."""

from __future__ import annotations

import resource
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from os import getloadavg
from pathlib import Path
from time import perf_counter
from typing import Any

from recording_files import recording

REPETITIONS = 3
SPEEDUP_GOAL = 1.8
RECORDINGS = 8
CHECK = 'import sys; from dyknow_command import main; sys.exit(main())'
FORMULAS = [
    formula
    for number in range(2)
    for formula in (
        f'always "/robot{number}/odometry".pose.pose.position.z < 100',
        f'always "/robot{number}/batterystate".voltage > -100',
        f'eventually(0 s, 1 s] "/robot{number}/imu".angular_velocity.z > 100',
    )
]


def time_of_children() -> float:
    """Return the processor time of all processes that have ended, in seconds."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def command(count: int, path: Path, jobs: int) -> list[str]:
    """Return the command that checks a number of equal recordings."""
    words = [sys.executable, '-c', CHECK, 'check', *[str(path)] * count, '--json']
    return [*words, '--jobs', str(jobs), *(w for each in FORMULAS for w in ('--formula', each))]


def run(commands: Sequence[Sequence[str]]) -> tuple[float, float, set[tuple[str, int]]]:
    """Run commands at the same time; return elapsed and processor seconds, and the outputs."""
    start, used = perf_counter(), time_of_children()
    running = [subprocess.Popen(each, stdout=subprocess.PIPE, text=True) for each in commands]
    with ThreadPoolExecutor(len(running)) as threads:
        outputs = list(threads.map(lambda each: each.communicate()[0], running))
    seconds, processor = perf_counter() - start, time_of_children() - used
    ended = zip(running, outputs, strict=True)
    found = {(line, each.returncode) for each, output in ended for line in output.splitlines()}
    return seconds, processor, found


def many(folder: Path, count: int) -> dict[str, Any]:
    """Compare the check of equal recordings with `--jobs 2` to that one by one.

    The speedup is what a user sees who waits for the command: two processors must be free. Two
    commands at the same time, each for half of the recordings, show what the machine allows. The
    processor time shows what the second process costs, on a busy machine as well.
    """
    path = recording(folder, count)
    ways = {
        'jobs_1': [command(RECORDINGS, path, 1)],
        'jobs_2': [command(RECORDINGS, path, 2)],
        'two_commands': [command(RECORDINGS // 2, path, 1)] * 2,
    }
    times: dict[str, list[tuple[float, float]]] = {way: [] for way in ways}
    outputs = set()
    for _ in range(REPETITIONS):
        for way, commands in ways.items():
            seconds, processor, lines = run(commands)
            times[way].append((seconds, processor))
            outputs |= lines
    ((_, code),) = outputs
    assert code in {0, 1}
    least = {way: min(seconds for seconds, _ in found) for way, found in times.items()}
    return {
        'recordings': RECORDINGS,
        'messages_each': count,
        **{f'{way}_s': seconds for way, seconds in least.items()},
        **{f'{way}_processor_s': min(used for _, used in found) for way, found in times.items()},
        'speedup': least['jobs_1'] / least['jobs_2'],
        'speedup_of_two_commands': least['jobs_1'] / least['two_commands'],
        'ratio_to_two_commands': least['two_commands'] / least['jobs_2'],
        'goal': SPEEDUP_GOAL,
        'load': getloadavg()[0],
    }
