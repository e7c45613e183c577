"""Opens a recording, whatever its format."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Final

from dyknow_common import ExitCode, sourced_prefixes
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.bags.bag import Bag
from dyknow_recordings.reading.messages.definitions import (
    DISTROS,
    MessageTypes,
    check_folder,
)
from dyknow_recordings.reading.recording import RecordingReader
from dyknow_recordings.reading.trace_recording import TraceRecording
from dyknow_recordings.reading.ulog import UlogRecording

_FORMATS: Final[Mapping[str, Callable[[Path, MessageTypes], RecordingReader]]] = {
    '.mcap': Bag,
    '.db3': Bag,
    '.zstd': Bag,
    '.ulg': lambda path, _: UlogRecording(path),
    '.csv': lambda path, _: TraceRecording(path),
}

ENDINGS: Final = tuple(_FORMATS)
"""The endings of the files that are recordings."""

*_FIRST, _LAST = (each for each in ENDINGS if each != '.zstd')  # It follows another ending.

ENDINGS_TEXT: Final = f'{", ".join(_FIRST)} or {_LAST}'
"""The endings for people."""

_POINTER: Final = b'version https://git-lfs.github.com/spec/'
"""The begin of a file that stands for another one until Git LFS has fetched that."""


def add_reading_options(parser: argparse.ArgumentParser) -> None:
    """Add the options whose values `message_types` returns."""
    parser.add_argument(
        '--distro',
        choices=DISTROS,
        metavar='NAME',
        default='',
        help='the distribution of ROS 2 that recordings are from, such as foxy, for message types '
        'that they do not define (default: the one that they name; else humble for .db3 files, '
        'jazzy for others)',
    )
    parser.add_argument(
        '--messages',
        action='append',
        type=Path,
        default=[],
        metavar='FOLDER',
        help='a folder with the .msg, .srv or .idl files of packages, for types that a recording '
        'does not define; repeatable',
    )


def message_types(options: argparse.Namespace) -> MessageTypes:
    """Return where the definitions are that recordings lack.

    Raises:
        RecordingError: NOT_FOUND, if a folder is missing.
    """
    for folder in options.messages:
        check_folder(folder)
    return MessageTypes(options.distro, tuple(options.messages), sourced_prefixes())


def open_recording(path: Path, types: MessageTypes | None = None) -> RecordingReader:
    """Open a recording: a bag of rosbag2, a log of PX4, or a trace of comma-separated values.

    Args:
        path: the path of a folder with `metadata.yaml`, or of a file with one of the ENDINGS.
        types: where to find message types that it does not define; by default, in its distribution
            of ROS 2 and in the sourced workspaces.

    Raises:
        RecordingError: if the recording is missing (NOT_FOUND), has another format, or if no part
            of it can be read.
    """
    try:
        is_folder = path.is_dir()
        if not path.exists():
            raise RecordingError(f'{path}: no such recording', ExitCode.NOT_FOUND)
        if not is_folder and not path.is_file():
            # A named pipe would be waited for.
            raise RecordingError(f'{path}: not a file; copy the recording into one')
        _check_is_fetched(path.iterdir() if is_folder else (path,))
    except OSError as error:
        raise RecordingError(f'{path}: cannot be read: {error.strerror}') from None
    format_class = Bag if is_folder else _FORMATS.get(path.suffix.lower())
    if format_class is None:
        raise RecordingError(f'{path}: {_other_format(path)}')
    return format_class(path, types or MessageTypes(prefixes=sourced_prefixes()))


def _other_format(path: Path) -> str:
    if path.suffix.lower() == '.bag':
        source = shlex.quote(str(path))
        return f'a bag of ROS 1; convert it with: rosbags-convert --src {source} --dst FOLDER'
    return f'not a recording; DyKnow reads folders of rosbag2, and files that end in {ENDINGS_TEXT}'


def _check_is_fetched(files: Iterable[Path]) -> None:
    for file in files:
        if file.suffix.lower() in ENDINGS and file.is_file():
            with file.open('rb') as content:
                if content.read(len(_POINTER)) == _POINTER:
                    raise RecordingError(
                        f'{file}: a pointer file of Git LFS, not the recording; run: git lfs pull'
                    )
