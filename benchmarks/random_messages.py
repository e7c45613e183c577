"""Random values for every field of a message: valid, extreme and malformed ones."""

from __future__ import annotations

import random
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from rclpy.serialization import serialize_message
from rosidl_parser.definition import (
    AbstractNestedType,
    AbstractSequence,
    Array,
    BasicType,
    BoundedSequence,
    NamespacedType,
)

NAMES = ('', ' ', 'hostile', 'Hostile', '/', '//', '~', '{}', 'a' * 300, '/' + 'b/' * 200, '\n',
         '\0', '%s%n', "'; DROP TABLE x; --", 'ü∀\U0001f600', '..', '/dev/null', 'x y', '0', '-1',
         'c' * 1_000_000)  # fmt: skip
"""Texts that are no names, or long ones."""

TEXTS = (
    'always Power[uav1] < 1000', 'forall u in UAV: Power[u] > 0', 'always', 'true', '((((', '1 / 0',
    'forall x in : always', 'p until[5 s, 1 s] q', 'Power[uav1] > 1e999', 'not ' * 5000 + 'true',
    'select current from "/uav1/battery"', 'sink', 'merge(nothing, nothing)',
    'select x from "/hostile/' + 'y' * 300 + '"', 'stream hostile contains Power[uav1] = x',
    'stream hostile contains Power[u] = x for every u in UAV where u = id', 'Power[u]',
    'SELECT * WHERE { ?a ?b ?c }', 'SELECT', 'nonsense', '\\', '"', '"""', '#', '(' * 50_000,
)  # fmt: skip
"""Texts in the languages of DyKnow, correct and wrong."""


def interface(name: str) -> Any:
    """Return a type of messages or services by its name, such as `std_msgs/msg/String`."""
    package, kind, name = name.split('/')
    return getattr(import_module(f'{package}.{kind}'), name)


def random_message(kind: Any, chance: random.Random, depth: int = 0) -> Any:
    """Return a message, a request or a goal of a type, with random values in all fields."""
    found = kind()
    for name, slot in zip(kind.get_fields_and_field_types(), kind.SLOT_TYPES, strict=True):
        if chance.random() < 0.9:  # noqa: PLR2004 - the others keep their defaults
            setattr(found, name, _value(slot, chance, depth))
    return found


def random_bytes(kind: Any, chance: random.Random) -> bytes:
    """Return a malformed serialized message: cut, changed, or with texts that are not UTF-8."""
    marker = 'QQQQ'
    message = random_message(kind, random.Random(chance.random()), 1)  # noqa: S311
    for name, slot in kind.get_fields_and_field_types().items():
        if slot == 'string':
            setattr(message, name, marker)
    found = bytearray(serialize_message(message).replace(marker.encode(), b'\xff\xfe\xc0\x80'))
    match chance.randrange(5):
        case 0:
            del found[chance.randrange(len(found) + 1) :]
        case 1:
            for _ in range(chance.randrange(1, 20)):
                found[chance.randrange(len(found))] = chance.randrange(256)
        case 2:  # Lengths beyond the end of the message.
            place = chance.randrange(4, max(len(found), 5))
            found[place : place + 4] = b'\xff\xff\xff\x7f'
        case 3:
            found = bytearray(chance.randbytes(chance.choice((0, 1, 3, 4, 5, 100, 10_000))))
        case _:
            pass
    return bytes(found)


def _value(slot: Any, chance: random.Random, depth: int) -> Any:
    if isinstance(slot, AbstractNestedType):
        return _values(slot, chance, depth)
    if isinstance(slot, NamespacedType):
        return random_message(interface('/'.join((*slot.namespaces, slot.name))), chance, depth + 1)
    if isinstance(slot, BasicType):
        return _basic(slot.typename, chance)
    return _text(chance, depth)


def _values(slot: Any, chance: random.Random, depth: int) -> Sequence[Any]:
    if isinstance(slot, Array):
        length = slot.size
    else:
        assert isinstance(slot, AbstractSequence)
        length = chance.choice((0, 1, 2, 2, 30 if depth < 2 else 2))  # noqa: PLR2004
        if isinstance(slot, BoundedSequence):
            length = min(length, slot.maximum_size)
    values = [_value(slot.value_type, chance, depth + 1) for _ in range(length)]
    is_bytes = isinstance(slot.value_type, BasicType) and slot.value_type.typename == 'octet'
    return values if not is_bytes else [bytes([0])] * length


def _basic(name: str, chance: random.Random) -> Any:
    if 'int' in name:
        span = 1 << int(name.lstrip('uint'))
        low, high = (0, span - 1) if name.startswith('u') else (-span // 2, span // 2 - 1)
        # Not small numbers: some belong to streams and groups of other clients.
        return chance.choice((low, high, low + 77, high - 55, chance.randint(low, high)))
    if name == 'boolean':
        return chance.random() < 0.5  # noqa: PLR2004
    if name == 'octet':
        return bytes([chance.randrange(256)])
    return chance.choice((0.0, -1.0, 1e308, float('nan'), float('inf'), -float('inf')))


def _text(chance: random.Random, depth: int) -> str:
    texts = (*TEXTS, *NAMES) if depth < 2 else (*TEXTS, *NAMES[:-1])  # noqa: PLR2004
    return chance.choice(texts)
