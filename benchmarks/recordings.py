"""Cost of reading and checking recordings.

python benchmarks/recordings.py [--json] [--quick] [--only PART] [--folder FOLDER]

Each recording has a million messages; with --quick, 100,000.

The baseline is the time that rosbags needs to read the raw messages of the same topics in the same
run, without decoding them. Equality with what rosbags decodes is checked before the measurement, on
a smaller recording of the same kind.
"""

from __future__ import annotations

import resource
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import reduce
from itertools import cycle, islice
from multiprocessing import get_context
from os import getloadavg
from pathlib import Path
from time import monotonic, perf_counter
from typing import Any
from unittest import mock

from parts import measure, processor_times
from recording_files import TOPICS, WANTED, recording
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from dyknow_recordings import RecordingReport, RequestedFormula, evaluate_recording, open_recording
from dyknow_recordings.evaluation.evaluation import ColumnStates

CHECKED_MESSAGES = 20_000
REPETITIONS = 3
FORMULAS, MANY_FORMULAS = 20, 200
FEW_MESSAGES, MANY_MESSAGES = 100_000, 1_000_000

NAMES = {f'{topic[8]}{topic[6]}': f'"{topic}"' for topic in TOPICS}
"""The topics in formulas: `o0` is the odometry of robot 0, `i`, `b` and `l` its other topics."""

TEMPLATES = (
    'always {o0}.pose.pose.position.z < {n}',
    'always {o1}.pose.pose.position.x < {n}',
    (
        'always ({o0}.pose.pose.position.z > {n} -> eventually[0 s, 1 s] '
        '{o0}.twist.twist.linear.x < 2)'
    ),
    'always ({o2}.pose.pose.position.z < {n} or {o2}.pose.covariance[35] > 90)',
    'always {i0}.angular_velocity.z < {n}',
    'always {i1}.linear_acceleration.x > -{n}',
    'always ({i2}.angular_velocity.z > {n} -> always[0 s, 500 ms] {i2}.linear_acceleration.x < 2)',
    'always {b0}.voltage > -{n}',
    'always ({b1}.present = true and {b1}.current < {n})',
    'always {b1}.cell_voltage[2] < {n}',
    'always {l0}.ranges[180] > -{n}',
    'always ({l1}.ranges[0] < {n} and {l1}.range_max = 30)',
    'eventually[1 s, 1000 h] {o0}.pose.pose.position.z > {n}',
    'eventually[1 s, 1000 h] {i1}.angular_velocity.z > {n}',
    'always ({o0}.pose.pose.position.z < {n} or {b0}.voltage > 10)',
    (
        'always ({o1}.pose.pose.position.x > {n} -> eventually[0 s, 2 s] '
        '{i1}.linear_acceleration.x < 1)'
    ),
    'always ({l0}.ranges[180] < {n} or {i0}.angular_velocity.z < 1)',
    'always {o2}.twist.twist.linear.x < {n}',
    'always[0 s, 10 s] {l1}.range_max < 3{n}',
    'always ({i2}.linear_acceleration.x < {n} or {o2}.pose.pose.position.z < {n})',
)
"""Formulas over all topics, over one and over two topics, with a place for a threshold."""

RECORDINGS = 8
CHECK = (
    sys.executable,
    '-c',
    'import sys; from dyknow_command import main; sys.exit(main())',
    'check',
)
"""The beginning of the command line of a check."""


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


def reading(*, folder: Path, quick: bool) -> dict[str, Any]:
    """Compare reading columns with reading raw messages."""
    count = FEW_MESSAGES if quick else MANY_MESSAGES
    check_equality(recording(folder, CHECKED_MESSAGES))
    path = recording(folder, count)
    assert read_columns(path) == read_raw(path) == count
    columns, raw = cost(read_columns, path), cost(read_raw, path)
    return {
        'messages': count,
        'megabytes': path.stat().st_size / 1e6,
        'columns_s': columns,
        'rosbags_raw_s': raw,
        'ratio': columns / raw,
        'memory_mb': memory_of(read_columns, path),
    }


def formulas(count: int) -> list[RequestedFormula]:
    """Return formulas that differ in their thresholds."""
    templates = islice(cycle(TEMPLATES), count)
    return [RequestedFormula(each.format(n=50 + n, **NAMES)) for n, each in enumerate(templates)]


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
    return min(processor_times(lambda: function(*arguments), REPETITIONS))


def checks(*, folder: Path, quick: bool) -> dict[str, Any]:
    """Compare checks of 20 and of 200 formulas with the reading of raw messages."""
    count = FEW_MESSAGES if quick else MANY_MESSAGES
    check_equality_of_checks(recording(folder, CHECKED_MESSAGES))
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
        'formulas_200_s': many,
        'ratio_of_200_to_20': many / few,
    }


def fault(*, folder: Path, **_: Any) -> dict[str, Any]:
    """Compare a recording with one that has a message without a stamp."""
    paths = [recording(folder, FEW_MESSAGES, is_faulty=each) for each in (False, True)]
    without, with_it = (cost(check, path, formulas(FORMULAS)) for path in paths)
    return {'without_a_fault_s': without, 'with_a_fault_s': with_it}


def memory_of(function: Callable[..., object], path: Path, *arguments: Any) -> float:
    """Return the memory that a process needs at most to call a function, in MB."""
    with ProcessPoolExecutor(1, mp_context=get_context('spawn')) as pool:
        return pool.submit(_peak_memory, function, path, *arguments).result()


def _peak_memory(function: Callable[..., object], *arguments: Any) -> float:
    function(*arguments)
    # ru_maxrss counts what the parent has needed before the start of a process, too.
    status = Path('/proc/self/status').read_text()
    return int(status.partition('VmHWM:')[2].split()[0]) / 1024


def memory(*, folder: Path, quick: bool) -> dict[str, Any]:
    """Measure the memory of checks of recordings of two lengths."""
    count = FEW_MESSAGES if quick else MANY_MESSAGES
    quarter, whole = (
        memory_of(check, recording(folder, each), formulas(FORMULAS))
        for each in (count // 4, count)
    )
    return {'messages': count, 'quarter_mb': quarter, 'whole_mb': whole}


def first_line(*, folder: Path, **_: Any) -> dict[str, Any]:
    """Measure the time from the start of `dyknow check` to its first line."""
    path = recording(folder, CHECKED_MESSAGES)
    formula = TEMPLATES[0].format(n=50, **NAMES)
    return {
        'topics_s': _time_of_line([*CHECK, str(path), '--topics']),
        'check_s': _time_of_line([*CHECK, str(path), '--formula', formula]),
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
    options = [f'--formula={each.text}' for each in formulas(6)]
    return [*CHECK, *[str(path)] * count, '--json', f'--jobs={jobs}', *options]


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


def jobs(*, folder: Path, quick: bool) -> dict[str, Any]:
    """Compare the check of equal recordings with `--jobs 2` to that one by one.

    The speedup is what a user sees who waits for the command: two processors must be free. Two
    commands at the same time, each for half of the recordings, show what the machine allows. The
    processor time shows what the second process costs, on a busy machine as well.
    """
    count = FEW_MESSAGES if quick else MANY_MESSAGES
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
        'load': getloadavg()[0],
    }


if __name__ == '__main__':
    measure(
        __doc__,
        *(reading, checks, fault, memory, first_line, jobs),
        folder=Path('/tmp/dyknow_benchmark_recordings'),  # noqa: S108 - only a cache
    )
