"""Jobs in several processes of this machine.

An executor of `concurrent.futures` gives up all of its jobs if one process dies, and does not say
which job it had. Here, each thread of an executor has a process, which it starts again.
"""

from __future__ import annotations

import pickle
import signal
import subprocess
import sys
from collections.abc import Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from contextlib import suppress
from queue import SimpleQueue
from typing import IO, Final, cast

from dyknow_common import ExitCode
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.jobs.recording_job import JobResult, RecordingJob

PROGRAM: Final = 'dyknow_recordings.jobs.worker_program'


def run_in_processes(
    jobs: Sequence[RecordingJob], number: int
) -> Generator[tuple[int, JobResult], None, None]:
    """Yield the indices and results of jobs as they come.

    All processes have ended when the generator is closed.

    Args:
        jobs: the jobs.
        number: of processes.
    """
    workers = [_JobProcess() for _ in range(min(number, len(jobs)))]
    idle: SimpleQueue[_JobProcess] = SimpleQueue()
    for each in workers:
        idle.put(each)

    def run(job: RecordingJob) -> JobResult:
        worker = idle.get()
        try:
            return worker.run(job)
        finally:
            idle.put(worker)

    threads = ThreadPoolExecutor(max(1, len(workers)))
    try:
        running: dict[Future[JobResult], int] = {
            threads.submit(run, job): index for index, job in enumerate(jobs)
        }
        for future in as_completed(running):
            yield running.pop(future), future.result()
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        for each in workers:
            each.kill()
        threads.shutdown()
        for each in workers:
            each.close()


class _JobProcess:
    """A process that runs one job after the other: it starts with the first, and after a death.

    One thread at a time calls its methods, except `kill`.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._is_killed = False

    def run(self, job: RecordingJob) -> JobResult:
        """Return the result of a job; an error if the process dies."""
        try:
            process = self._process or self._start()
        except OSError as error:
            text = f'{job.name}: no process can be started: {error.strerror}; use fewer --jobs'
            return RecordingError(text, ExitCode.UNAVAILABLE)
        jobs, results = cast('tuple[IO[bytes], IO[bytes]]', (process.stdin, process.stdout))
        try:
            jobs.write(pickle.dumps(job))
            jobs.flush()
            result: JobResult = pickle.load(results)  # noqa: S301 - of our own program
        except (OSError, EOFError, pickle.UnpicklingError):
            return self._failure(job, process)
        return result

    def kill(self) -> None:
        """Kill the process for good; another thread may be waiting in `run`."""
        self._is_killed = True
        if self._process is not None:
            self._process.kill()

    def close(self) -> None:
        """Wait for the end of the process that has been killed."""
        if self._process is not None:
            _end(self._process)

    def _start(self) -> subprocess.Popen[bytes]:
        self._process = subprocess.Popen(
            # -P: the working folder is no place for modules.
            [sys.executable, '-P', '-m', PROGRAM],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for the command alone.
        )
        if self._is_killed:
            self._process.kill()
        return self._process

    def _failure(self, job: RecordingJob, process: subprocess.Popen[bytes]) -> RecordingError:
        code = _end(process)
        self._process = None
        ending = f'signal {signal.Signals(-code).name}' if code < 0 else f'code {code}'
        return RecordingError(
            f'{job.name}: the process that checked it ended with {ending}; if it needs too much '
            'memory, use fewer --jobs',
            ExitCode.UNAVAILABLE,
        )


def _end(process: subprocess.Popen[bytes]) -> int:
    """Kill a process and free what it used; return its exit code."""
    process.kill()
    with suppress(OSError), process:  # A job that it has not read cannot be written any more.
        pass
    return process.returncode
