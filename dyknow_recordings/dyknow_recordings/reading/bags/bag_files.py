"""The files of a bag, a single file or the files in a folder, and the metadata of a folder."""

from __future__ import annotations

import json
import os
import re
import shutil
from base64 import b64decode, b64encode
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any, Final

import yaml

from dyknow_common import ExitCode, shortened
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.bags.mcap import McapFile
from dyknow_recordings.reading.bags.storage import ZSTD_MAGIC, StorageFile, decompress_file
from dyknow_recordings.reading.recording import BEGINNING, END, FaultCounter, LostMessages

BAG_SUFFIXES: Final = ('.mcap', '.db3', '.mcap.zstd', '.db3.zstd')

METADATA: Final = 'metadata.yaml'

CUT: Final = 'dyknow_cut'
"""The key, in the custom data of a bag cut from a recording, for what the recording lacks."""

_PART: Final = re.compile(r'(.*)_(\d+)(\.mcap|\.db3)(\.zstd)?')
"""The name of a part of a bag: its stem, number and ending, and whether it is compressed."""

_DAMAGE: Final = (
    yaml.YAMLError, ValueError, LookupError, TypeError, AttributeError, RecursionError
)  # fmt: skip
"""Raised where the metadata is damaged."""

_LOADER: Final = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)


def open_files(
    path: Path, faults: FaultCounter, stack: ExitStack
) -> tuple[list[StorageFile], BagMetadata]:
    """Open the files of a bag; return its metadata, too.

    Args:
        path: the path of a file, or of a folder with `metadata.yaml`.
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
                    if not plain.stat().st_size:
                        reason = f'{fault}, in its first block; was it copied completely?'
                        raise RecordingError(f'{path}: {reason}')
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
    """Return the files that the metadata names, or the files numbered as parts of one bag."""
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
    return named or _numbered(folder, present, faults), metadata


def _numbered(folder: Path, present: Sequence[Path], faults: FaultCounter) -> list[Path]:
    """Return the parts of a bag in the order of their numbers, and the first of each hole."""
    matches = [_PART.fullmatch(each.name) for each in present]
    parts = sorted((int(match[2]), match.string) for match in matches if match)
    names = {match and match.group(1, 3) for match in matches}
    name = names.pop() if len(names) == 1 else None
    if name and (parts[0][0] == 0 or name[0] == folder.resolve().name):
        paths, expected = [], 0
        for number, file in parts:
            if number > expected:
                paths.append(folder / f'{name[0]}_{expected}{name[1]}')
            paths.append(folder / file)
            expected = number + 1
        if expected > 1:
            last = shortened(parts[-1][1])
            faults.add(
                str(folder), f'files after {last} may be missing: {METADATA} would name them'
            )
        return paths
    if len(present) > 1:
        listed = shortened(', '.join(each.name for each in present))
        endings = ' '.join(sorted({f'{folder}/*{each.suffix}' for each in present}))
        raise RecordingError(
            f'{folder}: the folder has no usable {METADATA}, and its files are not numbered as '
            f'those of one bag: {listed}; to check each for itself, write: {endings}'
        )
    return list(present)


@dataclass(frozen=True, slots=True)
class BagMetadata:
    """The metadata of a bag; empty if there is none.

    Args:
        files: the names of its files, each once.
        counts: the number of messages by topic.
        distro: the distribution of ROS 2 of its recorder, such as `humble`; empty if unknown.
        losses: the messages that the recording lacks which the bag is cut from.
        is_suffix: True if that recording has messages from before the bag.
    """

    files: tuple[str, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)
    distro: str = ''
    losses: tuple[LostMessages, ...] = ()
    is_suffix: bool = False


def read_metadata(folder: Path, faults: FaultCounter) -> BagMetadata:
    """Return the metadata in the folder of a bag; what is wrong with it is a fault."""
    try:
        information = _information(folder)
        # Early versions give the path from the folder above.
        files = [PurePath(path).name for path in information['relative_file_paths']]
    except OSError:
        reason = f'{METADATA} is missing'
    except _DAMAGE:
        reason = f'{METADATA} is damaged'
    else:
        names = tuple(dict.fromkeys(files))
        if len(names) < len(files):
            faults.add(str(folder), f'{METADATA} names a file again', len(files) - len(names))
        cut = _cut(information, str(folder), faults)
        return BagMetadata(names, _counts(information), _distro(information), *cut)
    faults.add(str(folder), f'{reason}: the bag is read without it')
    return BagMetadata()


def cut_data(losses: Iterable[LostMessages], *, is_suffix: bool) -> str:
    """Return a text for the custom data of a bag that is cut from a recording; see BagMetadata."""
    stated = [
        [None if each.topics is None else sorted(each.topics), each.first, each.last, each.reason]
        for each in losses
    ]
    # The library that writes YAML folds long texts with backslashes incorrectly.
    return b64encode(json.dumps([stated, is_suffix]).encode()).decode()


def _cut(
    information: Mapping[str, Any], place: str, faults: FaultCounter
) -> tuple[tuple[LostMessages, ...], bool]:
    data = information.get('custom_data') or {}
    if CUT not in data:
        return (), False
    try:
        losses, is_suffix = json.loads(b64decode(data[CUT], validate=True))
        return tuple(
            LostMessages(None if topics is None else frozenset(topics), first, last, str(reason))
            for topics, first, last, reason in losses
        ), bool(is_suffix)
    except _DAMAGE:
        faults.lose(place, f'what {METADATA} says of the recording that it is cut from is damaged')
        return (), True


def distro_beside(path: Path) -> str:
    """Return the distribution that the metadata beside a file of a bag names, or an empty text."""
    try:
        found = _information(path.parent)
        names = [PurePath(each).name for each in found['relative_file_paths']]
    except (OSError, *_DAMAGE):
        return ''
    return _distro(found) if path.name in names else ''


def _information(folder: Path) -> Any:
    text = (folder / METADATA).read_text(encoding='utf-8')
    # The safe loaders of PyYAML; the loader in C takes a tenth of the time.
    return yaml.load(text, _LOADER)['rosbag2_bagfile_information']  # noqa: S506


def _counts(information: Mapping[str, Any]) -> Mapping[str, int]:
    counts: Counter[str] = Counter()
    try:
        for each in information['topics_with_message_count']:
            counts[str(each['topic_metadata']['name'])] += int(each['message_count'])
    except (LookupError, TypeError, ValueError):
        return {}
    return counts


def _distro(information: Mapping[str, Any]) -> str:
    return str(information.get('ros_distro') or '')
