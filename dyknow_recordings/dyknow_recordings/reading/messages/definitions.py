"""Definitions of message types, as texts.

Definitions that a recording does not contain are looked up in the folders of the user, then in the
distribution of ROS 2 that the recording is from, then in the sourced workspaces.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any, Final

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from dyknow_common import ExitCode, TypeConstants, shortened
from dyknow_common.text_files import read_regular
from dyknow_recordings.errors import RecordingError

Members = tuple[tuple[str, Any], ...]
"""The names and types of the fields of a message; the types are descriptions of rosbags."""

PLACEHOLDER: Final = 'structure_needs_at_least_one_member'
"""The only field, a uint8, of a message type that has no fields."""

CHARACTER: Final = 'character'
"""A `char` of IDL, which is a text in rclpy; in .msg files, `char` is a number."""

SERVICE_EVENT: Final = '_Event'
"""The end of the types of messages with the requests and responses of a service."""

MAX_DEFINITION: Final = 1 << 20
"""The characters of a definition, which takes some seconds to parse."""

_IDL_SEPARATOR: Final = '=' * 80 + '\n'
_SERVICE: Final = re.compile(rf'(?:{"=" * 80}\nSRV: [^\n]*\n)?(.*?)(?={"=" * 80}\n|\Z)', re.DOTALL)
_BOUND: Final = re.compile(r'\bwstring<=\d+')

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
class TypeDefinition:
    """A message type as a recording defines it.

    Args:
        name: such as `nav_msgs/msg/Odometry`.
        encoding: `ros2msg`, `ros2idl`, or empty if there is no definition. A service event has the
            text of the service, with any encoding.
        text: the definition of the type and of types within it; empty if there is none.
    """

    name: str
    encoding: str = ''
    text: str = ''


def parsed_types(definition: TypeDefinition) -> dict[str, Members]:
    """Return the types in the text of a definition, by name.

    Raises:
        RecordingError: if the text cannot be read.
    """
    if not definition.text:
        return {}
    if len(definition.text) > MAX_DEFINITION:
        raise RecordingError(
            f"the definition of the message type '{shortened(definition.name)}' is larger than "
            f'{MAX_DEFINITION} characters'
        )
    try:
        types = _parse(definition)
    except MemoryError:
        raise
    except Exception as error:
        # Damaged texts make the library raise errors of many kinds.
        raise RecordingError(
            f"the definition of the message type '{shortened(definition.name)}' cannot be read"
        ) from error
    is_idl = definition.encoding == 'ros2idl'
    found = {name: _corrected(members, is_idl) for name, (_, members) in types.items()}
    if '/srv/' in definition.name and definition.name.endswith(SERVICE_EVENT):
        found[definition.name] = _service_event(definition.name)
    return found


def type_constants(definition: TypeDefinition) -> TypeConstants:
    """Return the constants of the types in the text of a definition; none if it cannot be read."""
    try:
        types = _parse(definition) if 0 < len(definition.text) <= MAX_DEFINITION else {}
    except MemoryError:
        raise
    except Exception:  # noqa: BLE001 - see `parsed_types`, which tells of them
        return {}
    return _named_constants(types)


def _named_constants(types: Mapping[str, tuple[Any, Any]]) -> TypeConstants:
    """Return the constants of types as rosbags describes them."""
    return {
        name: {constant: value for constant, _, value in constants}
        for name, (constants, _) in types.items()
    }


def _parse(definition: TypeDefinition) -> Mapping[str, tuple[Any, Any]]:
    # The library does not know wstring, and takes it for the name of a message type.
    text = _BOUND.sub('wstring', definition.text.replace('\r\n', '\n'))
    package, _, name = definition.name.partition('/srv/')
    if name.endswith(SERVICE_EVENT) and definition.encoding != 'ros2idl':
        return _service_types(package, name.removesuffix(SERVICE_EVENT), text)
    if definition.encoding == 'ros2msg':
        return get_types_from_msg(text, definition.name)
    if definition.encoding != 'ros2idl':
        raise ValueError(definition.encoding)
    types: dict[str, tuple[Any, Any]] = {}
    for text in definition.text.split(_IDL_SEPARATOR):
        types |= get_types_from_idl(re.sub(r'\AIDL: .*\n', '', text)) if text.strip() else {}
    return types


def _service_types(package: str, name: str, text: str) -> Mapping[str, tuple[Any, Any]]:
    """Return the types in the definition of a service, and the types that it refers to."""
    service = _SERVICE.match(text)
    if service is None:
        raise ValueError(text)
    parts = re.split(r'^---[ \t]*$', service[1], maxsplit=1, flags=re.MULTILINE)
    types: dict[str, tuple[Any, Any]] = {}
    for part, suffix in zip(parts, ('Request', 'Response'), strict=True):
        # The library knows messages only.
        found = get_types_from_msg(part + text[service.end() :], f'{package}/msg/{name}')
        types |= found | {f'{package}/srv/{name}_{suffix}': found[f'{package}/msg/{name}']}
    return types


def _service_event(name: str) -> Members:
    service = name.removesuffix(SERVICE_EVENT)
    parts = tuple(
        (part, (Nodetype.SEQUENCE, ((Nodetype.NAME, f'{service}_{part.title()}'), 1)))
        for part in ('request', 'response')
    )
    return (('info', (Nodetype.NAME, 'service_msgs/msg/ServiceEventInfo')), *parts)


def _corrected(members: Collection[tuple[str, Any]], is_idl: bool) -> Members:  # noqa: FBT001
    found = tuple((name, _corrected_kind(kind, is_idl)) for name, kind in members)
    return found or ((PLACEHOLDER, (Nodetype.BASE, ('uint8', 0))),)


def _corrected_kind(kind: Any, is_idl: bool) -> Any:  # noqa: FBT001
    if kind[0] in {Nodetype.ARRAY, Nodetype.SEQUENCE}:
        element, size = kind[1]
        return kind[0], (_corrected_kind(element, is_idl), size)
    if kind[0] == Nodetype.NAME and kind[1].rpartition('/')[2] == 'wstring':
        return Nodetype.BASE, ('wstring', 0)
    return (Nodetype.BASE, (CHARACTER, 0)) if is_idl and kind[1] == ('char', 0) else kind


@dataclass(frozen=True, slots=True)
class MessageTypes:
    """Sources of message definitions that a recording lacks. It can be pickled.

    Args:
        distro: the distribution of ROS 2, such as `humble`; empty: the recording names it.
        folders: folders of `<package>/msg/<name>.msg`, `.idl` or `<package>/srv/<name>.srv`.
        prefixes: the prefixes of the workspaces that are sourced.
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
        return _named_constants(_released(self.distro or LATEST))


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
    if released := _released(types.distro or LATEST).get(name):
        return tuple(released[1])
    for prefix in types.prefixes:
        path = prefix / 'share' / _base(name)
        for each in (path.with_name(f'{path.name}{suffix}') for suffix in _ENCODINGS):
            if each.is_file() and (found := _members_in(each, name)):
                return found
    latest = _released(LATEST).get(name)
    return None if latest is None else tuple(latest[1])


@cache
def _released(distro: str) -> Mapping[str, tuple[Any, Any]]:
    """Return the constants and members of the types of a distribution, by name."""
    # Loaded only where a definition is missing: this takes 0.1 s.
    return get_typestore(Stores[f'ROS2_{distro.upper()}']).fielddefs


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
