"""The program of a worker process: it runs the jobs that it reads, and writes their results.

A process that is started afresh runs the module; one that is forked from the command calls `serve`,
and has imported all that it needs.
"""

from __future__ import annotations

import copyreg
import os
import pickle
import sys
import threading
from collections.abc import Mapping
from queue import SimpleQueue
from typing import Any, BinaryIO, NoReturn

from dyknow_recordings.jobs.recording_job import RecordingJob


def serve(jobs: BinaryIO, results: BinaryIO) -> NoReturn:
    """Run jobs until their end, which comes at the latest when the parent ends."""
    read: SimpleQueue[RecordingJob] = SimpleQueue()
    threading.Thread(target=_read, args=(jobs, read), daemon=True).start()
    while True:
        pickler = pickle.Pickler(results)
        # A fork may have other reducers of errors, such as Dask's for tracebacks.
        pickler.dispatch_table = _without_errors(copyreg.dispatch_table)
        pickler.dump(read.get().run())
        results.flush()


def _without_errors(reducers: Mapping[type, Any]) -> dict[type, Any]:
    return {each: reducers[each] for each in reducers if not issubclass(each, BaseException)}


def _read(stream: BinaryIO, jobs: SimpleQueue[RecordingJob]) -> None:
    """Read jobs. Without a parent, the process ends also in the middle of one."""
    try:
        while True:
            jobs.put(pickle.load(stream))  # noqa: S301 - the parent is no stranger
    finally:
        os._exit(0)


def main() -> NoReturn:
    """Serve the standard input, and write the results to the standard output."""
    # Libraries that print something must not disturb the results.
    with os.fdopen(os.dup(sys.stdout.fileno()), 'wb') as results:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        serve(sys.stdin.buffer, results)


if __name__ == '__main__':
    main()
