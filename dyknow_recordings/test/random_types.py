"""Random message types with random messages, serialised by rosbags."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from dyknow_recordings.reading.messages.definitions import TypeDefinition

NAME = 'made_up/msg/Top'
NUMBERS = {
    'bool': st.booleans(),
    'float32': st.floats(width=32),
    'float64': st.floats(),
    'byte': st.integers(-128, 127),
    'char': st.integers(0, 255),
} | {
    f'{sign}int{bits}': st.integers(
        0 if sign else -(2 ** (bits - 1)), 2 ** (bits if sign else bits - 1) - 1
    )
    for sign in ('', 'u')
    for bits in (8, 16, 32, 64)
}
DTYPES = {'bool': 'bool', 'byte': 'int8', 'char': 'uint8'}
TEXTS = st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=9)


@dataclass(frozen=True)
class Member:
    """A field of a random type: its kind, and `[3]`, `[]`, `[<=3]` or nothing."""

    kind: str
    array: str


def members(nested: list[str]) -> st.SearchStrategy[Member]:
    kinds = st.sampled_from([*NUMBERS, 'string', 'string', 'string<=9', *nested, *nested])
    return st.builds(Member, kinds, st.sampled_from(['', '', '', '[1]', '[3]', '[]', '[<=3]']))


@st.composite
def types(draw: Any) -> dict[str, list[Member]]:
    """A message type, and those within it."""
    made: dict[str, list[Member]] = {}
    for name in ('Leaf', 'Inner', 'Top'):
        made[name] = draw(st.lists(members(list(made)), min_size=1, max_size=4))
    return made


def text(made: dict[str, list[Member]]) -> str:
    parts = []
    for name, fields in reversed(made.items()):
        lines = [f'{each.kind}{each.array} f{i}\n' for i, each in enumerate(fields)]
        header = f'{"=" * 80}\nMSG: made_up/{name}\n' if name != 'Top' else ''
        parts.append(header + ''.join(lines))
    return ''.join(parts)


def typestore(made: dict[str, list[Member]]) -> Any:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text(made), NAME))
    return store


def definition(made: dict[str, list[Member]]) -> TypeDefinition:
    return TypeDefinition(NAME, 'ros2msg', text(made))


def draw_message(draw: Any, made: dict[str, list[Member]], store: Any, name: str = 'Top') -> Any:
    return store.types[f'made_up/msg/{name}'](
        *(draw_member(draw, made, store, member) for member in made[name])
    )


def draw_member(draw: Any, made: dict[str, list[Member]], store: Any, member: Member) -> Any:
    def one() -> Any:
        if member.kind in made:
            return draw_message(draw, made, store, member.kind)
        return draw(NUMBERS.get(member.kind, TEXTS))

    if not member.array:
        return one()
    size = re.sub(r'\D', '', member.array)
    fixed = size and '<' not in member.array
    count = int(size) if fixed else draw(st.integers(0, int(size or 4)))
    values = [one() for _ in range(count)]
    if member.kind in NUMBERS:
        return np.array(values, DTYPES.get(member.kind, member.kind))
    return values


@st.composite
def messages(draw: Any) -> tuple[dict[str, list[Member]], list[Any], list[bytes]]:
    """A type, messages of it, and these as serialised in either byte order."""
    made = draw(types())
    store = typestore(made)
    drawn = [draw_message(draw, made, store) for _ in range(draw(st.integers(1, 5)))]
    orders = draw(st.lists(st.booleans(), min_size=len(drawn), max_size=len(drawn)))
    serialised = [
        bytes(store.serialize_cdr(message, NAME, little_endian=order))
        for message, order in zip(drawn, orders, strict=True)
    ]
    decoded = [store.deserialize_cdr(data, NAME) for data in serialised]
    for message in decoded:
        make_bytes_unsigned(message, made)
    return made, decoded, serialised


def make_bytes_unsigned(message: Any, made: dict[str, list[Member]], name: str = 'Top') -> None:
    """Make the bytes of a message numbers from 0 to 255, as in ROS; rosbags has signed ones."""
    for i, member in enumerate(made[name]):
        value = getattr(message, f'f{i}')
        if member.kind in made:
            for each in value if member.array else [value]:
                make_bytes_unsigned(each, made, member.kind)
        elif member.kind == 'byte':
            setattr(message, f'f{i}', value.view(np.uint8) if member.array else value % 256)


def all_values(message: Any, made: dict[str, list[Member]], name: str = 'Top') -> dict[str, Any]:
    """Return the values of a decoded message by their paths."""
    found: dict[str, Any] = {}
    for i, member in enumerate(made[name]):
        value = getattr(message, f'f{i}')
        items = {f'f{i}': value}
        if member.array:
            items = {f'f{i}[{k}]': each for k, each in enumerate(value)}
        for path, item in items.items():
            if member.kind in made:
                nested = all_values(item, made, member.kind)
                found |= {f'{path}.{rest}': each for rest, each in nested.items()}
            else:
                found[path] = item
    return found
