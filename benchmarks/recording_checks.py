"""Cost of checking recordings; `recordings.py` runs it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import cycle, islice
from multiprocessing import get_context
from pathlib import Path
from time import monotonic, process_time
from typing import Any
from unittest import mock

from recording_files import TOPICS, recording
from rosbags.rosbag2 import Reader

from dyknow_recordings import RecordingReport, RequestedFormula, evaluate_recording, open_recording
from dyknow_recordings.evaluation.evaluation import ColumnStates

CHECKED_MESSAGES = 20_000
FORMULAS, MANY_FORMULAS = 20, 200
REPETITIONS = 3
GOAL, GOAL_OF_MANY = 1.3, 1.5
MEMORY_GOAL_MB = 300
FIRST_LINE_GOAL_S = 0.5
IMAGES = 300
USED_MESSAGES = 100_000

TEMPLATES = (
    'always "/robot0/odometry".pose.pose.position.z < {n}',
    'always "/robot1/odometry".pose.pose.position.x < {n}',
    (
        'always ("/robot0/odometry".pose.pose.position.z > {n} -> '
        'eventually[0 s, 1 s] "/robot0/odometry".twist.twist.linear.x < 2)'
    ),
    (
        'always ("/robot2/odometry".pose.pose.position.z < {n} or '
        '"/robot2/odometry".pose.covariance[35] > 90)'
    ),
    'always "/robot0/imu".angular_velocity.z < {n}',
    'always "/robot1/imu".linear_acceleration.x > -{n}',
    (
        'always ("/robot2/imu".angular_velocity.z > {n} -> '
        'always[0 s, 500 ms] "/robot2/imu".linear_acceleration.x < 2)'
    ),
    'always "/robot0/batterystate".voltage > -{n}',
    'always ("/robot1/batterystate".present = true and "/robot1/batterystate".current < {n})',
    'always "/robot1/batterystate".cell_voltage[2] < {n}',
    'always "/robot0/laserscan".ranges[180] > -{n}',
    'always ("/robot1/laserscan".ranges[0] < {n} and "/robot1/laserscan".range_max = 30)',
    'eventually[1 s, 1000 h] "/robot0/odometry".pose.pose.position.z > {n}',
    'eventually[1 s, 1000 h] "/robot1/imu".angular_velocity.z > {n}',
    'always ("/robot0/odometry".pose.pose.position.z < {n} or "/robot0/batterystate".voltage > 10)',
    (
        'always ("/robot1/odometry".pose.pose.position.x > {n} -> '
        'eventually[0 s, 2 s] "/robot1/imu".linear_acceleration.x < 1)'
    ),
    'always ("/robot0/laserscan".ranges[180] < {n} or "/robot0/imu".angular_velocity.z < 1)',
    'always "/robot2/odometry".twist.twist.linear.x < {n}',
    'always[0 s, 10 s] "/robot1/laserscan".range_max < 3{n}',
    (
        'always ("/robot2/imu".linear_acceleration.x < {n} or '
        '"/robot2/odometry".pose.pose.position.z < {n})'
    ),
)
"""Formulas over all topics, over one and over two topics, with a place for a threshold."""


def formulas(count: int) -> list[RequestedFormula]:
    """Return formulas that differ in their thresholds."""
    templates = islice(cycle(TEMPLATES), count)
    return [RequestedFormula(each.format(n=50 + n)) for n, each in enumerate(templates)]


def read_raw(path: Path) -> int:
    """Read the messages by rosbags."""
    with Reader(path) as reader:
        connections = [each for each in reader.connections if each.topic in TOPICS]
        return sum(1 for _ in reader.messages(connections))


def check(path: Path, requested: Sequence[RequestedFormula]) -> RecordingReport:
    """Check formulas over a recording."""
    with open_recording(path) as opened:
        return evaluate_recording(opened, requested)


def check_equality(path: Path) -> None:
    """Compare the results with those that are made message by message."""
    requested = formulas(MANY_FORMULAS)
    found = check(path, requested)
    with mock.patch.object(ColumnStates, 'progress', return_value=False):
        assert repr(found) == repr(check(path, requested))
    assert all(each.error is None for each in found.formulas)


def cost(function: Any, *arguments: Any) -> float:
    """Return the processor time of a call, in seconds: the least of some."""
    times = []
    for _ in range(REPETITIONS):
        start = process_time()
        function(*arguments)
        times.append(process_time() - start)
    return min(times)


def checks(folder: Path, count: int) -> dict[str, Any]:
    """Compare checks of 20 and of 200 formulas with the reading of raw messages."""
    check_equality(recording(folder, min(count, CHECKED_MESSAGES)))
    path = recording(folder, count)
    raw = cost(read_raw, path)
    few, many = (cost(check, path, formulas(number)) for number in (FORMULAS, MANY_FORMULAS))
    states = sum(each.states for each in check(path, formulas(FORMULAS)).formulas)
    return {
        'messages': count,
        'states_of_20_formulas': states,
        'rosbags_raw_s': raw,
        'formulas_20_s': few,
        'ratio': few / raw,
        'goal': GOAL,
        'formulas_200_s': many,
        'ratio_of_200_to_20': many / few,
        'goal_of_200_to_20': GOAL_OF_MANY,
    }


def unused_topics(folder: Path, count: int) -> dict[str, Any]:
    """Compare a recording that has images, which no formula uses, with one that has none."""
    used = min(count, USED_MESSAGES)
    plain, images = (recording(folder, used, number) for number in (0, IMAGES))
    requested = formulas(FORMULAS)
    found = [check(path, requested).formulas for path in (plain, images)]
    assert repr(found[0]) == repr(found[1])
    few = cost(check, plain, requested)
    many = cost(check, images, requested)
    battery = [each for each in requested if 'battery' in each.text and 'odom' not in each.text]
    return {
        'messages': used,
        'images_mb': IMAGES,
        'without_images_s': few,
        'with_images_s': many,
        'two_of_ten_topics_s': cost(check, plain, battery),
        'rosbags_raw_s': cost(read_raw, images),
    }


def single_messages(folder: Path, count: int) -> dict[str, Any]:
    """Measure what is read, or progressed, message by message."""
    used = min(count, USED_MESSAGES)
    plain, faulty = recording(folder, used), recording(folder, used, faults=1)
    minimum = 'always min("/robot{n}/laserscan".ranges) > -1000'
    minima = [RequestedFormula(minimum.format(n=number)) for number in range(2)]
    return {
        'messages': used,
        'minima_of_scans_s': cost(check, plain, minima),
        'without_a_fault_s': cost(check, plain, formulas(FORMULAS)),
        'with_a_fault_s': cost(check, faulty, formulas(FORMULAS)),
    }


def memory(path: Path) -> float:
    """Return the memory that a process has needed at most to check a recording, in MB."""
    check(path, formulas(FORMULAS))
    return peak_memory()


def peak_memory() -> float:
    """Return the memory that this process has needed at most, in MB."""
    # ru_maxrss counts what the parent has needed before the start of a process, too.
    status = Path('/proc/self/status').read_text()
    return int(status.partition('VmHWM:')[2].split()[0]) / 1024


def memory_of_checks(folder: Path, count: int) -> dict[str, Any]:
    """Measure the memory of checks of recordings of two lengths."""
    paths = [recording(folder, number) for number in (count // 4, count)]
    found = []
    for path in paths:
        with ProcessPoolExecutor(1, mp_context=get_context('spawn')) as pool:
            found.append(pool.submit(memory, path).result())
    return {
        'messages': count,
        'quarter_mb': found[0],
        'whole_mb': found[1],
        'goal_mb': MEMORY_GOAL_MB,
    }


def first_line(folder: Path, count: int) -> dict[str, Any]:
    """Measure the time from the start of `dyknow check` to its first line."""
    path = recording(folder, min(count, CHECKED_MESSAGES))
    code = 'import sys; from dyknow_command import main; sys.exit(main())'
    command = [sys.executable, '-c', code, 'check', str(path)]
    return {
        'topics_s': _time_of_line([*command, '--topics']),
        'check_s': _time_of_line([*command, '--formula', TEMPLATES[0].format(n=50)]),
        'goal_s': FIRST_LINE_GOAL_S,
    }


def _time_of_line(command: Sequence[str]) -> float:
    times = []
    for _ in range(2 * REPETITIONS):
        start = monotonic()
        with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            assert process.stdout.readline()
            times.append(monotonic() - start)
    return min(times)
