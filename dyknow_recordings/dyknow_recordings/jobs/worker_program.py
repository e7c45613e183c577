"""The program of a worker process: it runs the jobs that it reads, and writes their results."""

from __future__ import annotations

import os
import pickle
import sys
import threading
from queue import SimpleQueue
from typing import BinaryIO

from dyknow_recordings.jobs.recording_job import RecordingJob


def main() -> int:
    """Serve the standard input until its end, which comes at the latest when the parent ends."""
    jobs: SimpleQueue[RecordingJob] = SimpleQueue()
    # Libraries that print something must not disturb the results.
    with os.fdopen(os.dup(sys.stdout.fileno()), 'wb') as results:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        threading.Thread(target=_read, args=(sys.stdin.buffer, jobs), daemon=True).start()
        while True:
            pickle.dump(jobs.get().run(), results)
            results.flush()


def _read(stream: BinaryIO, jobs: SimpleQueue[RecordingJob]) -> None:
    """Read jobs. Without a parent, the process ends also in the middle of one."""
    try:
        while True:
            jobs.put(pickle.load(stream))  # noqa: S301 - the parent is no stranger
    finally:
        os._exit(0)


if __name__ == '__main__':
    sys.exit(main())
