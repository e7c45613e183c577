"""Jobs on a cluster of Dask, whose workers see the same files under the same paths."""

from __future__ import annotations

import asyncio
from collections.abc import Generator, Sequence
from dataclasses import replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Final

from dyknow_common import DyKnowError, ExitCode
from dyknow_configuration import TextSource
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.jobs import JobResult, RecordingJob

if TYPE_CHECKING:
    from distributed import Client, Future

_CONNECT_LIMIT_S: Final = 10
"""The time to connect to the scheduler, and again to find a worker."""

_RETRIES: Final = 2
"""Further attempts after a fault. Dask itself repeats jobs of workers that die, three times."""

_LOOK_PERIOD_S: Final = 10
_MAX_LOOKS: Final = 6
"""Looks in a row that find no worker, after which the cluster is given up."""


def run_on_cluster(
    jobs: Sequence[RecordingJob], address: str
) -> Generator[tuple[int, JobResult], None, None]:
    """Return the indices and results of jobs as they come.

    When the generator is closed, jobs that have not begun are withdrawn.

    Args:
        jobs: the jobs.
        address: of the scheduler, such as `tcp://scheduler:8786`.

    Raises:
        RecordingError: UNAVAILABLE, if Dask is not installed, the scheduler cannot be reached, or
            it has no workers.
    """
    return _results(_connected(address), jobs, address)


def _connected(address: str) -> Client:
    try:
        import dask  # noqa: PLC0415 - optional

        # The errors are ours to report.
        quiet = dict.fromkeys(('distributed', 'distributed.client', 'tornado'), 'critical')
        dask.config.set({'logging': quiet})
        from distributed import Client  # noqa: PLC0415
    except ImportError as error:
        raise RecordingError(
            f'--cluster needs Dask ({error}); install it: pip install distributed',
            ExitCode.UNAVAILABLE,
        ) from None
    try:
        asyncio.run(_probe(address))
        client = Client(address, timeout=_CONNECT_LIMIT_S, set_as_default=False)
    except (OSError, ValueError, ImportError) as error:
        reason = str(error) or f'no answer within {_CONNECT_LIMIT_S} s'
        raise RecordingError(
            f"cannot connect to the scheduler '{address}': {reason}; start it: dask scheduler",
            ExitCode.UNAVAILABLE,
        ) from None
    try:
        client.wait_for_workers(1, _CONNECT_LIMIT_S)
    except OSError:
        client.close()
        raise RecordingError(
            f'the scheduler {address} has no workers; start some: dask worker {address}',
            ExitCode.UNAVAILABLE,
        ) from None
    return client


async def _probe(address: str) -> None:
    """Connect once: a client waits for a server that does not answer for ever."""
    from distributed.comm import connect  # noqa: PLC0415

    async with asyncio.timeout(_CONNECT_LIMIT_S):
        connection = await connect(address, timeout=_CONNECT_LIMIT_S)
    await connection.close()


def _results(
    client: Client, jobs: Sequence[RecordingJob], address: str
) -> Generator[tuple[int, JobResult], None, None]:
    finished: SimpleQueue[Future[JobResult]] = SimpleQueue()
    with client:
        running = {}
        for index, job in enumerate(jobs):
            future = client.submit(_run, _absolute(job), pure=False, retries=_RETRIES)
            future.add_done_callback(finished.put)
            running[future.key] = index, future
        looks = 0
        while running and looks < _MAX_LOOKS:
            try:
                future = finished.get(timeout=_LOOK_PERIOD_S)
            except Empty:
                looks = 0 if _has_workers(client) else looks + 1
                continue
            index, _ = running.pop(future.key)
            yield index, _result(future, jobs[index])
        for index, _ in running.values():
            message = f'{jobs[index].name}: the scheduler {address} has lost all of its workers'
            yield index, RecordingError(message, ExitCode.UNAVAILABLE)


def _run(job: RecordingJob) -> JobResult:
    """Run a job on a worker. Faults are raised, so that the job is repeated."""
    result = job.run()
    if isinstance(result, DyKnowError) and result.code is ExitCode.INTERNAL_ERROR:
        raise result
    return result


def _result(future: Future[JobResult], job: RecordingJob) -> JobResult:
    """Return the result of a job that has ended in any way."""
    try:
        result: JobResult = future.result()
    except DyKnowError as error:
        return error
    except Exception as error:  # noqa: BLE001 - of Dask, or of a worker that lacks a package
        text = f'{job.name}: the cluster could not check it: {type(error).__name__}: {error}'
        return RecordingError(text, ExitCode.UNAVAILABLE)
    return result


def _has_workers(client: Client) -> bool:
    try:
        return bool(client.sync(client.scheduler.ncores, callback_timeout=_LOOK_PERIOD_S))
    except (OSError, AttributeError):  # It does not answer, or the client has closed itself.
        return False


def _absolute(job: RecordingJob) -> RecordingJob:
    """Return a job for a process that runs in another folder."""

    def absolute(sources: Sequence[TextSource]) -> tuple[TextSource, ...]:
        return tuple(each.absolute() if isinstance(each, Path) else each for each in sources)

    files = replace(
        job.files,
        ontologies=absolute(job.files.ontologies),
        annotations=absolute(job.files.annotations),
        streams=absolute(job.files.streams),
        bridges=absolute(job.files.bridges),
    )
    types = job.types
    if types is not None:
        folders = tuple(each.absolute() for each in types.folders)
        types = replace(types, folders=folders)
    return replace(job, path=job.path.absolute(), files=files, types=types)
