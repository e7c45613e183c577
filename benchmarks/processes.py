"""Processes in a private ROS domain, and their costs."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Self

from dyknow_interfaces.msg import StreamStatusArray
from dyknow_interfaces.srv import StreamCreateFromSpec

from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.processes import Process
from dyknow_common.ros import LATCHED

sys.path.insert(0, str(Path(__file__).parent.parent / 'tests'))

import system
from domains import reserve_domain

WORKERS = Path(__file__).with_name('workers.py')
ENGINE = 'stream_processing_engine'
MANAGER = 'stream_manager'
EXIT_LIMIT_S = 10.0


def use_private_domain() -> None:
    """Isolate this process and its children from other ROS processes."""
    os.environ['ROS_DOMAIN_ID'] = str(reserve_domain())
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'


def use_private_domain_without_shared_memory() -> None:
    """Isolate this process and its children, of which some are killed.

    One that is killed may leave locks in shared memory, for which the others wait.
    """
    os.environ.update(system.private_environment())


@contextmanager
def worker(*arguments: object, program: Path = WORKERS) -> Iterator[subprocess.Popen[str]]:
    """Run a process of workers.py, or of another program, until the end of the block."""
    with subprocess.Popen(
        [sys.executable, str(program), *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def wait_until_begun(process: subprocess.Popen[str]) -> None:
    """Wait until a worker prints that it has begun; the middleware may print lines before."""
    if process.stdout is None or 'begun\n' not in process.stdout:
        raise RuntimeError('a worker ended before it started')


def tell(process: subprocess.Popen[str], *words: object) -> str:
    """Send a line to a worker and return its answer."""
    if process.stdin is None or process.stdout is None:
        raise RuntimeError('the worker has no pipes')
    print(*words, file=process.stdin, flush=True)
    answer = process.stdout.readline()
    if not answer:
        raise RuntimeError(f'a worker has ended, with exit code {process.wait(EXIT_LIMIT_S)}')
    return answer.strip()


def result_of(process: subprocess.Popen[str]) -> Any:
    """Wait for the end of a worker and return its result."""
    output, _ = process.communicate(timeout=600.0)
    return json.loads(output.splitlines()[-1])


class Client(system.Client):
    """The client of the tests, in the domain of this process; a context manager that closes it."""

    def __init__(self) -> None:
        super().__init__({'ROS_DOMAIN_ID': os.environ['ROS_DOMAIN_ID']})

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def create(self, name: str, specification: str, node: str = ENGINE) -> str:
        """Create a stream and return its topic."""
        spec = StreamCreateFromSpec.Request().spec
        spec.name, spec.specification = name, specification
        answer = self.call(StreamCreateFromSpec, f'{node}/stream_create_from_spec', spec=spec)
        if answer.exit_status.code:
            raise RuntimeError(answer.exit_status.message)
        return str(answer.stream_topic)


class SampleCounts:
    """The latest counts of samples of all streams that an engine reports, by stream."""

    def __init__(self, client: Client) -> None:
        self.emitted: dict[str, int] = {}
        self.dropped: dict[str, int] = {}
        client.node.create_subscription(
            StreamStatusArray, f'{ENGINE}/streams', self._on_report, LATCHED
        )

    def received(self) -> int:
        """Return the samples that all streams received: each was emitted or dropped."""
        return sum(self.emitted.values()) + sum(self.dropped.values())

    def _on_report(self, report: Any) -> None:
        self.emitted = {each.name: each.samples for each in report.streams}
        self.dropped = {
            each.name: sum(drop.count for drop in each.drops) for each in report.streams
        }


@contextmanager
def engine() -> Iterator[tuple[Client, int]]:
    """Run a stream processing engine and a client; yield the client and the process id."""
    with (
        Client() as client,
        tempfile.TemporaryDirectory() as folder,
        Launcher(Path(folder)) as launcher,
    ):
        yield client, launcher.start(Process('dyknow_stream_processing', ENGINE, {})).pid


def processor_time(process: int) -> float:
    """Return the processor time of a process in seconds, including system calls."""
    fields = Path(f'/proc/{process}/stat').read_text(encoding='ascii').rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def resident_memory(process: int) -> float:
    """Return the resident memory of a process, MB."""
    pages = int(Path(f'/proc/{process}/statm').read_text(encoding='ascii').split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / 1e6


def costs(
    processes: Mapping[str, int], wait: Callable[[float], object], seconds: float
) -> dict[str, dict[str, float]]:
    """Return the share of a core and the memory in MB of each process over a time."""
    begun = time.monotonic()
    before = {name: processor_time(each) for name, each in processes.items()}
    wait(seconds)
    elapsed = time.monotonic() - begun
    return {
        name: {
            'share': round((processor_time(each) - before[name]) / elapsed, 4),
            'memory_mb': round(resident_memory(each), 1),
        }
        for name, each in processes.items()
    }


def proportional_memory(process: int) -> float:
    """Return the memory of a process in MB, with its share of what it shares with others (PSS)."""
    rollup = Path(f'/proc/{process}/smaps_rollup').read_text(encoding='ascii')
    (kilobytes,) = (line.split()[1] for line in rollup.splitlines() if line.startswith('Pss:'))
    return int(kilobytes) * 1024 / 1e6


def memory_of_group(group: int) -> float:
    """Return the resident memory of all processes of a process group, MB."""
    found = 0.0
    for each in Path('/proc').glob('[0-9]*'):
        with suppress(OSError):
            fields = (each / 'stat').read_text(encoding='ascii').rpartition(')')[2].split()
            if int(fields[2]) == group:
                found += resident_memory(int(each.name))
    return found


def open_files(process: int) -> int:
    """Return the number of open files of a process."""
    return sum(1 for _ in Path(f'/proc/{process}/fd').iterdir())


def growth_per_minute(found: Sequence[tuple[float, float]], warm_up: float) -> float:
    """Return the growth of a quantity, by least squares.

    Args:
        found: times in seconds, with the values.
        warm_up: the fraction at the beginning to ignore.
    """
    times, sizes = zip(*found[int(len(found) * warm_up) :], strict=True)
    return round(statistics.linear_regression(times, sizes).slope * 60, 3)


def percentile(values: Sequence[float], percent: float) -> float:
    """Return the smallest value that the given percentage of the values do not exceed."""
    return sorted(values)[min(int(len(values) * percent / 100), len(values) - 1)]


def summary(nanoseconds: Sequence[int]) -> dict[str, float]:
    """Return the median and 99th percentile of delays, microseconds."""
    return {
        'median_us': round(statistics.median(nanoseconds) / 1e3, 1),
        'p99_us': round(percentile(nanoseconds, 99) / 1e3, 1),
        'count': len(nanoseconds),
    }


def ratios(found: Mapping[str, float], baseline: Mapping[str, float]) -> dict[str, float]:
    """Return the ratios of two summaries."""
    return {
        f'{name}_ratio': round(found[f'{name}_us'] / baseline[f'{name}_us'], 2)
        for name in ('median', 'p99')
    }
