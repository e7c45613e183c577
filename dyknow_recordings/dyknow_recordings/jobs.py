"""Checks of recordings: each as it can run here, in a process of its own or on a cluster of Dask.

The workers of a cluster see the same files under the same paths.
"""

from __future__ import annotations

import sys
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Final, Self

from dyknow_common import DyKnowError, ExitCode
from dyknow_common.errors import error_text
from dyknow_common.executables import installed_version
from dyknow_common.worker_pool import WorkerPool
from dyknow_configuration import NO_MAP, RequestedFormula, RobotMap, TextSource, TopicExpectation
from dyknow_recordings.black_boxes import BlackBoxContent, suffix_report
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.episodes import EpisodeStart, Every
from dyknow_recordings.evaluation.evaluation import evaluate_recording
from dyknow_recordings.evaluation.recorded_map import recorded_map
from dyknow_recordings.evaluation.results import RecordingReport
from dyknow_recordings.evaluation.vocabulary import MonitoringFiles
from dyknow_recordings.health import broken_in, unchecked
from dyknow_recordings.reading.messages.definitions import MessageTypes
from dyknow_recordings.reading.opening import open_recording
from dyknow_recordings.reading.recording import BEGINNING

if TYPE_CHECKING:
    from distributed import Client, Future
    from rich.progress import Progress

JobResult = RecordingReport | DyKnowError
"""The results of a recording, or why there are none."""

_CONNECT_LIMIT_S: Final = 10
"""The time to connect to the scheduler, and again to find a worker."""

_RETRIES: Final = 2
"""Further attempts after a fault. Dask itself repeats jobs of workers that die, three times."""

_LOOK_PERIOD_S: Final = 10

_MAX_LOOKS: Final = 6
"""Looks in a row that find no worker, after which the cluster is given up."""

_VERSION: Final = (
    "__import__('dyknow_recordings') and "
    "__import__('dyknow_common.executables').executables.installed_version()"
)
"""The version of DyKnow: a text, as a worker without DyKnow shuts down at a function of ours."""


@dataclass(frozen=True, slots=True)
class RecordingJob:
    """The check of one recording. It and its result can be pickled.

    Args:
        name: the name of the recording, for people.
        path: the path of the recording.
        formulas: the formulas to evaluate.
        files: the configuration.
        begin: evaluate from this time after the start of the recording on, in nanoseconds; None for
            all of it.
        every: `first`, `state`, or the formula of a trigger.
        keep_signals: True to keep the signals of the states, for pictures.
        margins: True to compute the margins of the formulas.
        probabilities: True to compute their probabilities.
        retries: True to evaluate a formula again after an error.
        black_box: the content of the recording if it is one that is to be checked by itself.
        types: where the definitions of message types are that the recording lacks.
        expectations: about its topics.
        map: the regions and positions to draw.
    """

    name: str
    path: Path
    formulas: tuple[RequestedFormula, ...]
    files: MonitoringFiles
    begin: int | None = None
    every: str = Every.FIRST.value
    keep_signals: bool = False
    margins: bool = False
    probabilities: bool = False
    retries: bool = False
    black_box: BlackBoxContent | None = None
    types: MessageTypes | None = None
    expectations: tuple[TopicExpectation, ...] = ()
    map: RobotMap = NO_MAP

    def run(self) -> JobResult:
        """Check the recording. A fault of any kind is an error of this recording alone."""
        try:
            return self._report()
        except DyKnowError as error:
            return error
        except Exception as error:  # noqa: BLE001 - other recordings are checked all the same
            return RecordingError(f'{self.path}: {error_text(error)}', ExitCode.INTERNAL_ERROR)

    def _report(self) -> RecordingReport:
        with open_recording(self.path, self.types) as recording:
            is_suffix = recording.is_suffix and self.black_box is None
            # From a chosen time on, a trigger that holds already begins an episode.
            start = replace(
                self._start(recording.start_time), is_suffix=is_suffix and not self.begin
            )
            report = evaluate_recording(
                recording,
                self.formulas,
                self.files,
                start,
                keep_signals=self.keep_signals,
                margins=self.margins,
                probabilities=self.probabilities,
                retries=self.retries,
            )
            notes = dict.fromkeys((*report.notes, *unchecked(recording, self.expectations)))
            broken = broken_in(recording, self.expectations)
            report = replace(report, broken=broken, notes=tuple(notes))
            if self.map.frame:
                failures = [each.failure for each in report.formulas]
                moments = [each.decided_at for each in failures if each and each.decided_at]
                found = recorded_map(recording, self.map, self.files.streams, moments)
                report = replace(report, map=found)
        if self.black_box is not None:
            report = self.black_box.judged(report)
        if is_suffix:
            report = self._suffix_report(report)
        return replace(report, recording=self.name)

    def _suffix_report(self, report: RecordingReport) -> RecordingReport:
        pairs = zip(report.formulas, self.formulas, strict=True)
        trigger = '' if self.every in {Every.FIRST, Every.STATE} else self.every
        formulas = (
            suffix_report(
                each,
                every_state=self.every != Every.FIRST or requested.every_state,
                trigger=trigger,
            )
            for each, requested in pairs
        )
        return replace(report, formulas=tuple(formulas))

    def _start(self, start_time: int) -> EpisodeStart:
        if self.black_box is not None:
            return self.black_box.start
        begin = BEGINNING if self.begin is None else start_time + self.begin
        if self.every in {Every.FIRST, Every.STATE}:
            return EpisodeStart(begin, Every(self.every))
        return EpisodeStart(begin, Every.TRIGGER, self.every)


def run_here(jobs: Sequence[RecordingJob]) -> Generator[tuple[int, JobResult], None, None]:
    """Run jobs one after the other in this process; yield their indices and results."""
    for index, job in enumerate(jobs):
        yield index, job.run()


@contextmanager
def run_in_processes(
    jobs: Sequence[RecordingJob], number: int
) -> Iterator[Iterator[tuple[int, JobResult]]]:
    """Run jobs in a block, which gets their indices and results as they come.

    All processes have ended when the block ends. It starts before this process has further threads,
    such as the thread of a progress bar: workers can then be forked.

    Args:
        jobs: the jobs.
        number: the number of processes.
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


class ProgressBar:
    """The number of recordings that are checked, on the standard error output if it is a terminal.

    Args:
        total: the number of recordings; of one, nothing is shown.
    """

    def __init__(self, total: int) -> None:
        is_shown = total > 1 and sys.stderr.isatty()
        self._progress = _progress(total) if is_shown else None

    def __enter__(self) -> Self:
        if self._progress is not None:
            self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._progress is not None:
            self._progress.stop()

    def advance(self) -> None:
        """Count a recording."""
        if self._progress is not None:
            self._progress.advance(self._progress.task_ids[0])

    @contextmanager
    def hidden(self) -> Iterator[None]:
        """Remove the bar from the terminal for a while."""
        self.__exit__()
        yield
        self.__enter__()


def _progress(total: int) -> Progress:
    # Only a bar that is shown needs the time to import rich.
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import (  # noqa: PLC0415
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    progress = Progress(
        TextColumn('checking'),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        # It is removed while results are printed, perhaps to somewhere else.
        redirect_stdout=False,
        redirect_stderr=False,
    )
    progress.add_task('', total=total)
    return progress


def run_on_cluster(
    jobs: Sequence[RecordingJob], address: str
) -> Generator[tuple[int, JobResult], None, None]:
    """Return the indices and results of jobs as they come.

    When the generator is closed, jobs that have not begun are withdrawn.

    Args:
        jobs: the jobs.
        address: the address of the scheduler, such as `tcp://scheduler:8786`.

    Raises:
        RecordingError: UNAVAILABLE, if Dask is not installed, the scheduler cannot be reached, or
            it has no workers, or one without this version of DyKnow.
    """
    client = _connected(address)
    try:
        _check_versions(client)
    except BaseException:
        client.close()
        raise
    return _cluster_results(client, jobs, address)


def _connected(address: str) -> Client:
    import asyncio  # noqa: PLC0415 - as dask, for a cluster alone

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


def _check_versions(client: Client) -> None:
    """Check that each worker has this version of DyKnow."""
    own = installed_version()
    for worker, found in client.run(eval, _VERSION, on_error='return').items():
        if found != own:
            lack = f'no DyKnow: {found}' if isinstance(found, Exception) else f'DyKnow {found}'
            raise RecordingError(
                f'the worker {worker} has {lack}; install DyKnow {own} there, as here, or stop it',
                ExitCode.UNAVAILABLE,
            )


async def _probe(address: str) -> None:
    """Connect once: a client waits for a server that does not answer for ever."""
    import asyncio  # noqa: PLC0415

    from distributed.comm import connect  # noqa: PLC0415

    async with asyncio.timeout(_CONNECT_LIMIT_S):
        connection = await connect(address, timeout=_CONNECT_LIMIT_S)
    await connection.close()


def _cluster_results(
    client: Client, jobs: Sequence[RecordingJob], address: str
) -> Generator[tuple[int, JobResult], None, None]:
    finished: SimpleQueue[Future[JobResult]] = SimpleQueue()
    with client:
        running = {}
        for index, job in enumerate(jobs):
            future = client.submit(_run_on_worker, _absolute(job), pure=False, retries=_RETRIES)
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
            yield index, _cluster_result(future, jobs[index])
        for index, _ in running.values():
            message = f'{jobs[index].name}: the scheduler {address} has lost all of its workers'
            yield index, RecordingError(message, ExitCode.UNAVAILABLE)


def _run_on_worker(job: RecordingJob) -> JobResult:
    """Run a job on a worker. Faults are raised, so that the job is repeated."""
    result = job.run()
    if isinstance(result, DyKnowError) and result.code is ExitCode.INTERNAL_ERROR:
        raise result
    return result


def _cluster_result(future: Future[JobResult], job: RecordingJob) -> JobResult:
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
