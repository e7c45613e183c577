"""Definitions of message types that a recording does not contain.

They are looked for in the folders of the user, in the distribution of ROS 2 that the recording is
from, and in the workspaces that are sourced, in this order.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Final

from rosbags.typesys import Stores, get_typestore

from dyknow_common import ExitCode, TypeConstants
from dyknow_common.text_files import read_regular
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.messages.definitions import (
    MAX_DEFINITION,
    SERVICE_EVENT,
    Members,
    TypeDefinition,
    named_constants,
    parsed_types,
)

DISTROS: Final = tuple(
    each.name.removeprefix('ROS2_').lower() for each in Stores if each.name.startswith('ROS2_')
)
"""The distributions of ROS 2 whose messages are known, in their order."""

LATEST: Final = 'jazzy'
"""The distribution that is taken where nothing names one."""

MAX_FILES: Final = 100_000
"""The files and folders of a folder with definitions."""

_ENCODINGS: Final = {'.msg': 'ros2msg', '.srv': 'ros2msg', '.idl': 'ros2idl'}


@dataclass(frozen=True, slots=True)
class MessageTypes:
    """Sources of message definitions that a recording lacks. It can be pickled.

    Args:
        distro: of ROS 2, such as `humble`; empty: the one that the recording names.
        folders: with files `<package>/msg/<name>.msg`, `.idl` or `<package>/srv/<name>.srv`.
        prefixes: of the workspaces that are sourced.
    """

    distro: str = ''
    folders: tuple[Path, ...] = ()
    prefixes: tuple[Path, ...] = ()

    @property
    def release(self) -> str:
        """The distribution, for people."""
        return f'ROS 2 {(self.distro or LATEST).title()}'

    def members(self, name: str) -> Members | None:
        """Return the fields of a type; None if it is unknown.

        Raises:
            RecordingError: naming a folder or a file that cannot be read.
        """
        return _members(self, name)

    @property
    def constants(self) -> TypeConstants:
        """The constants of the types of the distribution."""
        return _released_constants(self.distro or LATEST)


NO_TYPES: Final = MessageTypes()


def check_folder(folder: Path) -> None:
    """Raise RecordingError, NOT_FOUND, if a folder with definitions is missing."""
    if not folder.is_dir():
        raise RecordingError(f'{folder}: no such folder with messages', ExitCode.NOT_FOUND)


@cache
def _members(types: MessageTypes, name: str) -> Members | None:
    for folder in types.folders:
        if found := _members_in(_files(folder).get(_base(name)), name):
            return found
    distro = types.distro or LATEST
    if found := _released(distro).get(name):
        return found
    for prefix in types.prefixes:
        path = prefix / 'share' / _base(name)
        for each in (path.with_name(f'{path.name}{suffix}') for suffix in _ENCODINGS):
            if each.is_file() and (found := _members_in(each, name)):
                return found
    return _released(LATEST).get(name)


@cache
def _released_constants(distro: str) -> TypeConstants:
    return named_constants(get_typestore(Stores[f'ROS2_{distro.upper()}']).fielddefs)


@cache
def _released(distro: str) -> Mapping[str, Members]:
    # Loaded only where a definition is missing: this takes 0.1 s.
    types = get_typestore(Stores[f'ROS2_{distro.upper()}']).fielddefs
    return {name: tuple(members) for name, (_, members) in types.items()}


def _base(name: str) -> str:
    """Return the name of the file of a type, without its ending."""
    package, kind, base = name.partition('/srv/')
    if kind:
        for suffix in (SERVICE_EVENT, '_Request', '_Response'):
            base = base.removesuffix(suffix)
    return f'{package}{kind}{base}'


def _members_in(path: Path | None, name: str) -> Members | None:
    return None if path is None else _types_in(path, name).get(name)


@cache
def _types_in(path: Path, name: str) -> Mapping[str, Members]:
    try:
        content = read_regular(path, MAX_DEFINITION)
    except OSError as error:
        raise RecordingError(f'{path}: cannot be read: {error.strerror}') from None
    text = str(content, 'utf-8', 'replace')
    is_event = path.suffix == '.srv'
    root = f'{_base(name)}{SERVICE_EVENT}' if is_event else name
    try:
        # A definition may be empty; the library takes no such text.
        return parsed_types(TypeDefinition(root, _ENCODINGS[path.suffix], text or '\n'))
    except RecordingError as error:
        raise RecordingError(f'{path}: {error}', error.code) from error


@cache
def _files(folder: Path) -> Mapping[str, Path]:
    """Return the files with definitions by the names of their types."""
    check_folder(folder)
    paths = list(islice(_walk(folder.absolute()), MAX_FILES + 1))
    if len(paths) > MAX_FILES:
        raise RecordingError(
            f'{folder}: more than {MAX_FILES} files; give the folder of the packages with messages'
        )
    found: dict[str, Path] = {}
    for path in sorted(each for each in paths if each.suffix in _ENCODINGS):
        kind = path.parent.name if path.parent.name in {'msg', 'srv'} else ''
        package = path.parent.parent.name if kind else path.parent.name
        name = f'{package}/{kind or path.suffix[1:].replace("idl", "msg")}/{path.stem}'
        # Texts in IDL are made from the texts of messages.
        if found.setdefault(name, path).suffix == '.idl':
            found[name] = path
    return found


def _walk(folder: Path) -> Iterator[Path]:
    for parent, folders, names in os.walk(folder):
        yield from (Path(parent, each) for each in (*folders, *names))
