"""Definitions of message types, as texts."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, Final

from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_idl, get_types_from_msg

from dyknow_common import TypeConstants, shortened
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


@dataclass(frozen=True, slots=True)
class TypeDefinition:
    """A message type as a recording defines it.

    Args:
        name: such as `nav_msgs/msg/Odometry`.
        encoding: of the definition: `ros2msg`, `ros2idl`, or empty if there is none. The text of a
            service event is the service's, with any encoding.
        text: the definition of the type and of those within it; empty if there is none.
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
    return named_constants(types)


def named_constants(types: Mapping[str, tuple[Any, Any]]) -> TypeConstants:
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
