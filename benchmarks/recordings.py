"""Cost of reading and checking recordings.

The baseline is the time that rosbags needs to read the raw messages of the same topics in the same
run, without decoding them. Equality with what rosbags decodes is checked before the measurement, on
a smaller recording of the same kind.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
from collections import defaultdict
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import reduce
from itertools import cycle, islice
from multiprocessing import get_context
from os import getloadavg
from pathlib import Path
from time import monotonic, perf_counter, process_time
from typing import Any
from unittest import mock

from recording_files import TOPICS, WANTED, recording
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from dyknow_recordings import RecordingReport, RequestedFormula, evaluate_recording, open_recording
from dyknow_recordings.evaluation.evaluation import ColumnStates

CHECKED_MESSAGES = 20_000
REPETITIONS = 3
GOAL = 1.15
"""Times of the baseline: checking formulas over the columns as well has 1.3."""

MEMORY_GOAL_MB = 300
FORMULAS, MANY_FORMULAS = 20, 200
GOAL_OF_CHECKS, GOAL_OF_MANY = 1.3, 1.5
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

SPEEDUP_GOAL = 1.8
RECORDINGS = 8
CHECK = 'import sys; from dyknow_command import main; sys.exit(main())'
CHECKED_FORMULAS = [
    formula
    for number in range(2)
    for formula in (
        f'always "/robot{number}/odometry".pose.pose.position.z < 100',
        f'always "/robot{number}/batterystate".voltage > -100',
        f'eventually(0 s, 1 s] "/robot{number}/imu".angular_velocity.z > 100',
    )
]


def check_equality(path: Path) -> None:
    """Compare the columns with the messages as rosbags decodes them."""
    store = get_typestore(Stores.ROS2_JAZZY)
    found: dict[str, dict[str, list[Any]]] = defaultdict(lambda: defaultdict(list))
    with open_recording(path) as opened:
        for part in opened.columns(WANTED):
            found[part.topic]['log_time'] += part.log_times.tolist()
            for name, column in part.values.items():
                found[part.topic][name] += column.tolist()
        assert opened.faults == ()
    expected: dict[str, dict[str, list[Any]]] = defaultdict(lambda: defaultdict(list))
    with Reader(path) as reader:
        for connection, time, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            expected[connection.topic]['log_time'].append(time)
            for name in WANTED[connection.topic]:
                expected[connection.topic][name].append(value_at(message, name))
    assert found == expected


def value_at(message: Any, path: str) -> Any:
    """Return the value of a field, in the slow and obvious way."""
    steps = path.replace('[', '.').rstrip(']').split('.')
    return reduce(
        lambda at, step: at[int(step)] if step.isdigit() else getattr(at, step), steps, message
    )


def read_columns(path: Path) -> int:
    """Read the fields that are used as columns."""
    with open_recording(path) as opened:
        return sum(len(part.log_times) for part in opened.columns(WANTED))


def memory_of_columns(path: Path) -> float:
    """Return the memory that a process has needed at most to read the columns, in MB."""
    read_columns(path)
    return peak_memory()


def reading(folder: Path, count: int) -> dict[str, Any]:
    """Compare reading columns with reading raw messages."""
    check_equality(recording(folder, min(count, CHECKED_MESSAGES)))
    path = recording(folder, count)
    assert read_columns(path) == read_raw(path) == count
    columns, raw = cost(read_columns, path), cost(read_raw, path)
    with ProcessPoolExecutor(1, mp_context=get_context('spawn')) as pool:
        memory = pool.submit(memory_of_columns, path).result()
    return {
        'messages': count,
        'megabytes': path.stat().st_size / 1e6,
        'columns_s': columns,
        'rosbags_raw_s': raw,
        'ratio': columns / raw,
        'goal': GOAL,
        'memory_mb': memory,
        'memory_goal_mb': MEMORY_GOAL_MB,
    }


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


def check_equality_of_checks(path: Path) -> None:
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
    check_equality_of_checks(recording(folder, min(count, CHECKED_MESSAGES)))
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
        'goal': GOAL_OF_CHECKS,
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
    command = [sys.executable, '-c', CHECK, 'check', str(path)]
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


def time_of_children() -> float:
    """Return the processor time of all processes that have ended, in seconds."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def command(count: int, path: Path, jobs: int) -> list[str]:
    """Return the command that checks a number of equal recordings."""
    words = [sys.executable, '-c', CHECK, 'check', *[str(path)] * count, '--json']
    return [
        *words,
        '--jobs',
        str(jobs),
        *(w for each in CHECKED_FORMULAS for w in ('--formula', each)),
    ]


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


def main() -> None:
    """Measure and print the results."""
    parts = {
        'reading': reading,
        'check': checks,
        'unused': unused_topics,
        'single': single_messages,
        'memory': memory_of_checks,
        'first line': first_line,
        'jobs': many,
    }
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument('--json', action='store_true', help='print one JSON object')
    parser.add_argument('--only', choices=parts, action='append')
    parser.add_argument('--messages', type=int, default=1_000_000, help='(default: 1000000)')
    parser.add_argument(
        '--folder',
        type=Path,
        default=Path('/tmp/dyknow_benchmark_recordings'),  # noqa: S108 - only a cache
        help='where the recordings are kept (default: %(default)s)',
    )
    arguments = parser.parse_args()
    found = {
        name: parts[name](arguments.folder, arguments.messages) for name in arguments.only or parts
    }
    if arguments.json:
        print(json.dumps(found))
        return
    for name, row in found.items():
        print(name)
        for key, value in row.items():
            print(f'  {key:30} {value:10.2f}')


if __name__ == '__main__':
    main()
