"""The files of a bag: a single one, or those in a folder."""

from __future__ import annotations

import os
import shutil
from collections.abc import Collection
from contextlib import ExitStack
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any, Final

import yaml

from dyknow_common import ExitCode, shortened
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.bags.mcap import McapFile
from dyknow_recordings.reading.bags.storage import ZSTD_MAGIC, StorageFile, decompress_file
from dyknow_recordings.reading.recording import FaultCounter

METADATA: Final = 'metadata.yaml'

_DAMAGE: Final = (
    yaml.YAMLError, ValueError, LookupError, TypeError, AttributeError, RecursionError
)  # fmt: skip
"""Raised where the metadata is damaged."""

BAG_SUFFIXES: Final = ('.mcap', '.db3', '.mcap.zstd', '.db3.zstd')


def open_files(path: Path, faults: FaultCounter, stack: ExitStack) -> list[StorageFile]:
    """Open the files of a bag.

    Args:
        path: of a file, or of a folder with `metadata.yaml`.
        faults: where faults are counted: files that cannot be read, among others that can.
        stack: closes the files.

    Raises:
        RecordingError: if the bag is missing (NOT_FOUND), or no file of it can be read.
    """
    try:
        if not path.exists():
            raise RecordingError(f'{path}: no such recording', ExitCode.NOT_FOUND)
        if not path.is_dir():
            return [_open(path, faults, stack)]
        paths = _paths(path, faults)
    except OSError as error:
        raise RecordingError(f'{path}: cannot be read: {error.strerror}') from None
    files: list[StorageFile] = []
    errors: list[RecordingError] = []
    for file in paths:
        try:
            files.append(_open(file, faults, stack))
        except RecordingError as error:
            errors.append(error)
    if errors and not files:
        raise errors[0]
    for each in errors:
        faults.add(str(path), f'a file is left out: {each}')
    return files


def _open(path: Path, faults: FaultCounter, stack: ExitStack) -> StorageFile:
    try:
        plain = path
        with path.open('rb') as file:
            if file.read(len(ZSTD_MAGIC)) == ZSTD_MAGIC:
                plain = _decompressed(path, faults, stack)
        opened: StorageFile
        if plain.suffix == '.db3':
            # Loading SQLite takes a while.
            from dyknow_recordings.reading.bags.sqlite import (  # noqa: PLC0415
                SqliteFile,
                partial_page,
            )

            if excess := partial_page(plain):
                faults.add(str(path), 'the file ends early, within a page')
                plain = _without_end(plain, excess, stack)
            opened = SqliteFile(plain, str(path), faults)
        else:
            opened = McapFile(plain, str(path), faults)
    except OSError as error:
        raise RecordingError(f'{path}: cannot be read: {error.strerror}') from None
    stack.callback(opened.close)
    return opened


def _decompressed(path: Path, faults: FaultCounter, stack: ExitStack) -> Path:
    folder = stack.enter_context(TemporaryDirectory(prefix='dyknow_recording_'))
    plain = Path(folder, path.name.removesuffix('.zstd'))
    if not decompress_file(path, plain):
        faults.add(str(path), 'the compressed file is damaged or ends early')
    return plain


def _without_end(path: Path, excess: int, stack: ExitStack) -> Path:
    """Return a copy of a file without its last bytes."""
    folder = stack.enter_context(TemporaryDirectory(prefix='dyknow_recording_'))
    copy = Path(shutil.copy(path, folder))
    os.truncate(copy, path.stat().st_size - excess)
    return copy


def _paths(folder: Path, faults: FaultCounter) -> list[Path]:
    """Return the files that the metadata names, or all that look like parts of a bag."""
    present = sorted(each for each in folder.iterdir() if each.name.endswith(BAG_SUFFIXES))
    metadata = folder / METADATA
    if not present and not metadata.exists():
        raise RecordingError(
            f'{folder}: not a recording: the folder has no {METADATA}, and no .mcap or .db3 file'
        )
    named = _named_files(metadata, faults)
    if not named:
        return present
    missing = [name for name in named if not (folder / name).exists()]
    if missing and len(missing) == len(named):
        raise RecordingError(
            f'{folder}: the files of the bag are missing: {shortened(", ".join(missing))}',
            ExitCode.NOT_FOUND,
        )
    for name in missing:
        faults.add(str(folder), f'the file {shortened(name)} is missing')
    return [folder / name for name in named if name not in missing]


def recorded_distro(path: Path, known: Collection[str]) -> str:
    """Return the distribution of ROS 2 that the metadata of a bag names; empty if none is known.

    Args:
        path: of its folder, or of its file.
        known: the distributions.
    """
    folder = path if path.is_dir() else path.parent
    try:
        found: Any = _information(folder / METADATA)
        names = [PurePath(each).name for each in found['relative_file_paths']]
        distro = found.get('ros_distro')
    except (OSError, *_DAMAGE):
        return ''
    return distro if distro in known and (path == folder or path.name in names) else ''


def _information(metadata: Path) -> Any:
    return yaml.safe_load(metadata.read_text(encoding='utf-8'))['rosbag2_bagfile_information']


def _named_files(metadata: Path, faults: FaultCounter) -> list[str] | None:
    try:
        paths = _information(metadata)['relative_file_paths']
        # Early versions give the path from the folder above.
        return [PurePath(path).name for path in paths]
    except OSError:
        reason = f'{METADATA} is missing'
    except _DAMAGE:
        reason = f'{METADATA} is damaged'
    faults.add(str(metadata.parent), f'{reason}: the bag is read without it')
    return None
