"""Positions of the characters of a YAML scalar in its document.

YAML folds lines, removes indentation and resolves escapes, but it never changes the order of
characters, and except in escapes it changes only whitespace. So the n-th character of a value that
is not whitespace is the n-th such character of its source:

    formula: >-          the value 'always p',
      always             whose 'p' is the seventh character that is not whitespace,
      p                  and so is the 'p' in the source
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

_ESCAPE: Final = re.compile(
    r'\\(?:x(?P<x>[0-9a-fA-F]{2})|u(?P<u>[0-9a-fA-F]{4})|U(?P<U>[0-9a-fA-F]{8})|(?P<one>.))',
    re.DOTALL,
)
_SPECIAL: Final = {
    '0': '\0', 'a': '\a', 'b': '\b', 'e': '\x1b', '"': '"', '/': '/', '\\': '\\',
    # These stand for whitespace.
    't': ' ', 'n': ' ', 'v': ' ', 'f': ' ', 'r': ' ', ' ': ' ', '\t': ' ', '\n': ' ', '_': ' ',
    'N': ' ', 'L': ' ', 'P': ' ',
}  # fmt: skip


def source_offsets(value: str, source: str, style: str | None) -> list[int] | None:
    """Return the offset in the source of each character of a value, and of its end.

    A character of whitespace is placed after the character before it.

    Args:
        value: of the scalar.
        source: its text in the document, with quotes or the header of a block.
        style: `'`, `"`, `|`, `>`, or None for a plain scalar.

    Returns:
        None if the two do not correspond.
    """
    visible = [(each, place) for each, place in _characters(source, style) if not each.isspace()]
    if ''.join(each for each, _ in visible) != ''.join(value.split()):
        return None
    offsets: list[int] = []
    places = (place for _, place in visible)
    after = visible[0][1] if visible else 0
    for each in value:
        if each.isspace():
            offsets.append(after)
        else:
            offsets.append(next(places))
            after = offsets[-1] + 1
    return [*offsets, after]


def _characters(source: str, style: str | None) -> Iterator[tuple[str, int]]:
    """Yield the characters of the value with their offsets in the source."""
    if style == "'":
        for found in re.finditer("''|[^']", source[1:-1]):
            yield found[0][0], found.start() + 1
    elif style == '"':
        for found in re.finditer(_ESCAPE.pattern + r'|[^\\]', source[1:-1], re.DOTALL):
            yield _resolved(found), found.start() + 1
    else:
        # The first line of a block is its header.
        begin = source.find('\n') + 1 if style in {'|', '>'} else 0
        yield from ((each, begin + place) for place, each in enumerate(source[begin:]))


def _resolved(found: re.Match[str]) -> str:
    code = found['x'] or found['u'] or found['U']
    if code:
        return chr(int(code, 16))
    return found[0] if found['one'] is None else _SPECIAL.get(found['one'], found['one'])
