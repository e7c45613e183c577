"""The files of a bag: a single one, or those in a folder."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from dyknow_common import ExitCode, shortened
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.bags.bag_metadata import METADATA, BagMetadata, read_metadata
from dyknow_recordings.reading.bags.mcap import McapFile
from dyknow_recordings.reading.bags.storage import ZSTD_MAGIC, StorageFile, decompress_file
from dyknow_recordings.reading.lost_messages import BEGINNING, END
from dyknow_recordings.reading.recording import FaultCounter

BAG_SUFFIXES: Final = ('.mcap', '.db3', '.mcap.zstd', '.db3.zstd')


def open_files(
    path: Path, faults: FaultCounter, stack: ExitStack
) -> tuple[list[StorageFile], BagMetadata]:
    """Open the files of a bag; return its metadata, too.

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
            return [_open(path, faults, stack)], BagMetadata()
        paths, metadata = _paths(path, faults)
    except OSError as error:
        raise RecordingError(f'{path}: cannot be read: {error.strerror}') from None
    files: list[StorageFile | None] = []
    errors: list[RecordingError] = []
    for file in paths:
        try:
            files.append(_open(file, faults, stack))
        except RecordingError as error:
            files.append(None)
            errors.append(error)
    found = [each for each in files if each is not None]
    if errors and not found:
        raise errors[0]
    _lose_files(str(path), paths, files, errors, faults)
    return found, metadata


def _lose_files(
    place: str,
    paths: Sequence[Path],
    files: Sequence[StorageFile | None],
    errors: Sequence[RecordingError],
    faults: FaultCounter,
) -> None:
    """Note that some files cannot be read: their messages are between their neighbours'."""
    lost = [number for number, file in enumerate(files) if file is None]
    for number, error in zip(lost, errors, strict=True):
        is_there = paths[number].exists()
        name = shortened(paths[number].name)
        reason = f'a file is left out: {error}' if is_there else f'the file {name} is missing'
        before = [each.span[1] for each in files[:number] if each and each.span]
        after = [each.span[0] for each in files[number:] if each and each.span]
        between = max(before, default=BEGINNING), min(after, default=END)
        faults.lose(place, reason, first=min(between), last=max(between))


def _open(path: Path, faults: FaultCounter, stack: ExitStack) -> StorageFile:
    try:
        plain, fault = path, ''
        with path.open('rb') as file:
            if file.read(len(ZSTD_MAGIC)) == ZSTD_MAGIC:
                plain = Path(_temporary_folder(stack), path.name.removesuffix('.zstd'))
                if not decompress_file(path, plain):
                    fault = 'the compressed file is damaged or ends early'
        opened: StorageFile
        if plain.suffix == '.db3':
            # Loading SQLite takes a while.
            from dyknow_recordings.reading.bags.sqlite import (  # noqa: PLC0415
                SqliteFile,
                partial_page,
            )

            if excess := partial_page(plain):
                fault = fault or 'the file ends early, within a page'
                plain = _without_end(plain, excess, stack)
            opened = SqliteFile(plain, str(path), faults)
        else:
            opened = McapFile(plain, str(path), faults)
    except OSError as error:
        raise RecordingError(f'{path}: cannot be read: {error.strerror}') from None
    if fault:
        first = BEGINNING if opened.span is None else opened.span[1] + 1
        faults.lose(str(path), fault, first=first)
    stack.callback(opened.close)
    return opened


def _temporary_folder(stack: ExitStack) -> str:
    return stack.enter_context(TemporaryDirectory(prefix='dyknow_recording_'))


def _without_end(path: Path, excess: int, stack: ExitStack) -> Path:
    """Return a copy of a file without its last bytes."""
    copy = Path(shutil.copy(path, _temporary_folder(stack)))
    os.truncate(copy, path.stat().st_size - excess)
    return copy


def _paths(folder: Path, faults: FaultCounter) -> tuple[list[Path], BagMetadata]:
    """Return the files that the metadata names, or all that look like parts of a bag."""
    present = sorted(each for each in folder.iterdir() if each.name.endswith(BAG_SUFFIXES))
    if not present and not (folder / METADATA).exists():
        raise RecordingError(
            f'{folder}: not a recording: the folder has no {METADATA}, and no .mcap or .db3 file'
        )
    metadata = read_metadata(folder, faults)
    named = [folder / name for name in metadata.files]
    if named and not any(each.exists() for each in named):
        names = shortened(', '.join(metadata.files))
        raise RecordingError(
            f'{folder}: the files of the bag are missing: {names}', ExitCode.NOT_FOUND
        )
    return named or present, metadata
