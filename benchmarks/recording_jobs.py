"""Checks of several recordings at a time, compared with those one after the other."""

from __future__ import annotations

import resource
import subprocess
import sys
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


def many(folder: Path, count: int) -> dict[str, Any]:
    """Compare the check of equal recordings with `--jobs 2` to that one by one.

    The speedup is that of a user who waits for the command: two processors must be free. The
    processor time shows what the second process costs, on a busy machine as well.
    """
    path = recording(folder, count)
    command = [sys.executable, '-c', CHECK, 'check', *[str(path)] * RECORDINGS, '--json']
    command += [word for each in FORMULAS for word in ('--formula', each)]
    times: dict[str, list[float]] = {'1': [], '2': []}
    processor: dict[str, list[float]] = {'1': [], '2': []}
    outputs = set()
    for _ in range(REPETITIONS):
        for jobs, found in times.items():
            start, used = perf_counter(), time_of_children()
            done = subprocess.run([*command, '--jobs', jobs], stdout=subprocess.PIPE, check=False)
            found.append(perf_counter() - start)
            processor[jobs].append(time_of_children() - used)
            outputs.add((done.stdout, done.returncode))
    ((_, code),) = outputs
    assert code in {0, 1}
    one, two = (min(found) for found in times.values())
    return {
        'recordings': RECORDINGS,
        'messages_each': count,
        'jobs_1_s': one,
        'jobs_2_s': two,
        'jobs_1_processor_s': min(processor['1']),
        'jobs_2_processor_s': min(processor['2']),
        'speedup': one / two,
        'goal': SPEEDUP_GOAL,
    }
