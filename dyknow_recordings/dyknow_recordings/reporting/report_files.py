"""Files that outputs write at the end of a check."""

from __future__ import annotations

from pathlib import Path

from dyknow_common import ExitCode, replace_file
from dyknow_recordings.errors import RecordingError


def check_place(option: str, path: Path) -> None:
    """Check that a file can have a path, before the recordings are read.

    Raises:
        RecordingError: naming the option and the mend.
    """
    if path.is_dir():
        raise RecordingError(f'{option} {path}: is a folder; give the name of a file')
    if not path.parent.is_dir():
        text = f'{option} {path}: there is no folder {path.parent}; make it'
        raise RecordingError(text, ExitCode.NOT_FOUND)


def write_report(path: Path, content: bytes) -> None:
    """Replace a file; an interruption leaves the old one.

    Raises:
        RecordingError: if it cannot be written.
    """
    try:
        replace_file(path, content)
    except OSError as error:
        raise RecordingError(f'{path}: cannot be written: {error.strerror}') from None
