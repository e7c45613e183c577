"""Jobs in several processes of this machine.

An executor of `concurrent.futures` gives up all of its jobs if one process dies, and does not say
which job it had. Here, each thread of an executor has a process, which it starts again.
"""

from __future__ import annotations

import pickle
import signal
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from queue import SimpleQueue

from dyknow_common import ExitCode
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.jobs.recording_job import JobResult, RecordingJob
from dyknow_recordings.jobs.workers import FreshWorker, JobWorker, forked_workers


@contextmanager
def run_in_processes(
    jobs: Sequence[RecordingJob], number: int
) -> Iterator[Iterator[tuple[int, JobResult]]]:
    """Run jobs in a block, which gets their indices and results as they come.

    All processes have ended when the block ends. It starts before this process has further threads,
    such as that of a progress bar, so that workers can be forked.

    Args:
        jobs: the jobs.
        number: of processes.
    """
    number = min(number, len(jobs))
    forked = forked_workers(number)
    workers = [_JobProcess(each) for each in forked]
    workers += [_JobProcess() for _ in range(number - len(workers))]
    threads = ThreadPoolExecutor(max(1, number))
    try:
        yield _results(jobs, workers, threads)
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        for each in workers:
            each.kill()
        threads.shutdown()
        for each in workers:
            each.close()


def _results(
    jobs: Sequence[RecordingJob], workers: Sequence[_JobProcess], threads: ThreadPoolExecutor
) -> Generator[tuple[int, JobResult], None, None]:
    idle: SimpleQueue[_JobProcess] = SimpleQueue()
    for each in workers:
        idle.put(each)

    def run(job: RecordingJob) -> JobResult:
        worker = idle.get()
        try:
            return worker.run(job)
        finally:
            idle.put(worker)

    running: dict[Future[JobResult], int] = {
        threads.submit(run, job): index for index, job in enumerate(jobs)
    }
    for future in as_completed(running):
        yield running.pop(future), future.result()


class _JobProcess:
    """A process that runs one job after the other, which is started again after a death.

    One thread at a time calls its methods, except `kill`.

    Args:
        worker: the process; None to start one with the first job.
    """

    def __init__(self, worker: JobWorker | None = None) -> None:
        self._worker = worker
        self._is_killed = False

    def run(self, job: RecordingJob) -> JobResult:
        """Return the result of a job; an error if the process dies."""
        try:
            worker = self._worker or self._start()
        except OSError as error:
            text = f'{job.name}: no process can be started: {error.strerror}; use fewer --jobs'
            return RecordingError(text, ExitCode.UNAVAILABLE)
        try:
            worker.jobs.write(pickle.dumps(job))
            worker.jobs.flush()
            result: JobResult = pickle.load(worker.results)  # noqa: S301 - of our own program
        except (OSError, EOFError, pickle.UnpicklingError):
            return self._failure(job, worker)
        return result

    def kill(self) -> None:
        """Kill the process for good; another thread may be waiting in `run`."""
        self._is_killed = True
        if self._worker is not None:
            self._worker.kill()

    def close(self) -> None:
        """Wait for the end of the process that has been killed."""
        if self._worker is not None:
            self._worker.end()

    def _start(self) -> JobWorker:
        self._worker = FreshWorker()
        if self._is_killed:
            self._worker.kill()
        return self._worker

    def _failure(self, job: RecordingJob, worker: JobWorker) -> RecordingError:
        code = worker.end()
        self._worker = None
        ending = f'signal {signal.Signals(-code).name}' if code < 0 else f'code {code}'
        return RecordingError(
            f'{job.name}: the process that checked it ended with {ending}; if it needs too much '
            'memory, use fewer --jobs',
            ExitCode.UNAVAILABLE,
        )
