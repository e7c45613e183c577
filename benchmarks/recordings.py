"""Cost of reading and checking recordings.

The baseline is the time that rosbags needs to read the raw messages of the same topics in the same
run, without decoding them. Equality with what rosbags decodes is checked before the measurement, on
a smaller recording of the same kind.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from functools import reduce
from multiprocessing import get_context
from pathlib import Path
from time import process_time
from typing import Any

from recording_checks import (
    checks,
    first_line,
    memory_of_checks,
    peak_memory,
    read_raw,
    single_messages,
    unused_topics,
)
from recording_files import WANTED, recording
from recording_jobs import many
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from dyknow_recordings import open_recording

CHECKED_MESSAGES = 20_000
REPETITIONS = 3
GOAL = 1.15
"""Times of the baseline: checking formulas over the columns as well has 1.3."""

MEMORY_GOAL_MB = 300


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
    times: dict[str, list[float]] = {'columns': [], 'raw': []}
    for _ in range(REPETITIONS):
        for name, function in (('columns', read_columns), ('raw', read_raw)):
            start = process_time()
            assert function(path) == count
            times[name].append(process_time() - start)
    with ProcessPoolExecutor(1, mp_context=get_context('spawn')) as pool:
        memory = pool.submit(memory_of_columns, path).result()
    columns, raw = min(times['columns']), min(times['raw'])
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
