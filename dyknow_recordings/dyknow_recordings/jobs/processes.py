"""Jobs in several processes of this machine."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager

from dyknow_common import ExitCode
from dyknow_common.worker_pool import WorkerPool
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.jobs.recording_job import JobResult, RecordingJob


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
    number = max(1, min(number, len(jobs)))
    pool = WorkerPool(number, forks=True)
    threads = ThreadPoolExecutor(number)
    try:
        yield _results(jobs, pool, threads)
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        pool.stop()
        threads.shutdown()


def _results(
    jobs: Sequence[RecordingJob], pool: WorkerPool, threads: ThreadPoolExecutor
) -> Generator[tuple[int, JobResult], None, None]:
    running = {threads.submit(_run, job, pool): index for index, job in enumerate(jobs)}
    for future in as_completed(running):
        yield running.pop(future), future.result()


def _run(job: RecordingJob, pool: WorkerPool) -> JobResult:
    """Return the result of a job; an error if its process dies."""
    try:
        result: JobResult = pool.run(RecordingJob.run, (job,))
    except ChildProcessError as error:
        return RecordingError(f'{job.name}: {error}; use fewer --jobs', ExitCode.UNAVAILABLE)
    return result
