"""Positions in many serialised messages at once, and the values there, as numpy vectors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dyknow_recordings.reading.messages.stored_messages import MessageBuffer

Offset = Any
"""The same number for all messages, an int, or one for each: an array of shape (n,)."""

ALIGNMENT: Final = 8
"""Sizes of fields depend on their position modulo this."""

HEADER_SIZE: Final = 4
"""The bytes of the encapsulation header: the byte order, and options."""

_RESIDUES: Final = np.arange(ALIGNMENT)
WIDE_SIZE: Final = 4
"""The bytes of a code unit of a wide string."""


def primitive_sizes(size: int, count: int = 1) -> NDArray[np.int64]:
    """Return the bytes that values of a primitive type take, by the residue of their position.

    Args:
        size: the size of a value, which is also its alignment.
        count: the number of values, at least one.
    """
    return -_RESIDUES % size + size * count


def followed_by(first: NDArray[np.int64], second: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the bytes that two fields after each other take, by the residue of the position."""
    sizes: NDArray[np.int64] = first + second[(_RESIDUES + first) % ALIGNMENT]
    return sizes


class SizeTables:
    """The bytes that elements of a fixed size take, for any number of elements.

    Args:
        element: the bytes of one element, by the residue of its position.
    """

    def __init__(self, element: NDArray[np.int64]) -> None:
        self._powers = [element]

    def after(self, position: Offset, count: Offset) -> Offset:
        """Return the position after some elements."""
        for power in range(int(np.max(count, initial=0)).bit_length()):
            if power == len(self._powers):
                self._powers.append(followed_by(self._powers[-1], self._powers[-1]))
            sizes = self._powers[power]
            position = position + sizes[position % ALIGNMENT] * (count >> power & 1)
        return position

    def total(self, count: int) -> NDArray[np.int64]:
        """Return the bytes of some elements, by the residue of the position of the first."""
        sizes: NDArray[np.int64] = self.after(_RESIDUES, count) - _RESIDUES
        return sizes


class SerialisedMessages:
    """Serialised messages of one type and one byte order, in one buffer.

    Args:
        data: the buffer, of at least 8 bytes.
        order: `<` for little endian, `>` for big endian.
    """

    def __init__(self, data: MessageBuffer, order: str) -> None:
        self.data = data
        self.order = order
        self._views: dict[str, NDArray[np.generic]] = {}

    def values(self, code: str, positions: NDArray[np.int64]) -> NDArray[np.generic]:
        """Return the values of a numpy type at any positions in the buffer."""
        view = self._views.get(code)
        if view is None:
            # One element starts at each byte: numpy reads values that are not aligned.
            kind = np.dtype(self.order + code)
            shape = (len(self.data) - kind.itemsize + 1,)
            view = np.ndarray(shape, kind, self.data, strides=(1,))
            self._views[code] = view
        return view[positions].astype(view.dtype.newbyteorder('='), copy=False)


class CdrCursor:
    """A position in each of some messages, which moves forward.

    Args:
        messages: the buffer with the messages.
        origins: where each message starts in the buffer, after the encapsulation header.
        sizes: the number of bytes of each message from there.
    """

    def __init__(
        self, messages: SerialisedMessages, origins: NDArray[np.int64], sizes: NDArray[np.int64]
    ) -> None:
        self._messages = messages
        self._origins = origins
        self._sizes = sizes
        self._smallest = int(sizes.min()) if len(sizes) else 0
        self.position: Offset = 0
        self.intact = np.ones(len(origins), np.bool_)
        """False for messages that end before their type does; their values are arbitrary."""

    def __len__(self) -> int:
        return len(self._origins)

    def skip(self, sizes: NDArray[np.int64]) -> None:
        """Move over a field of a fixed size, given by the residue of its position."""
        added = sizes[self.position % ALIGNMENT]
        self.position += int(added) if isinstance(self.position, int) else added
        self._check(self.position)

    def value(self, code: str) -> NDArray[np.generic]:
        """Return the values of a primitive field of a numpy type, and move over it."""
        size = np.dtype(code).itemsize
        start = self.position + -self.position % size
        self.position = start + size
        return self._messages.values(code, self._checked(start, size))

    def length(self) -> NDArray[np.int64]:
        """Return the lengths of a string or sequence, and move to its first element."""
        return self.value('u4').astype(np.int64)

    def text(self, *, wide: bool, wanted: bool) -> Sequence[str]:
        """Return the texts of a string field, and move over it.

        Args:
            wide: True for a string of UTF-16 code units, each in 4 bytes.
            wanted: False to move only.
        """
        sizes = self.length() * (WIDE_SIZE if wide else 1)
        start = self._checked(self.position, sizes)
        self.move(self.position + sizes)
        if not wanted:
            return ()
        data, ends = self._messages.data, (start + sizes * self.intact).tolist()
        pieces = [data[each:end] for each, end in zip(start.tolist(), ends, strict=True)]
        return [text_of(piece, self._messages.order, wide=wide) for piece in pieces]

    def move(self, position: Offset) -> None:
        """Move forward to a position."""
        if not isinstance(position, int) and len(position) and (position == position[0]).all():
            # Numbers are faster than vectors, and messages of a topic mostly have one layout.
            position = int(position[0])
        self.position = position
        self._check(position)

    def limit(self, counts: NDArray[np.int64], smallest: int) -> NDArray[np.int64]:
        """Return the lengths of a sequence; 0 for messages that are too small for these.

        Args:
            counts: the lengths that the messages state.
            smallest: the least number of bytes of an element.
        """
        self._check(self.position + counts * smallest)
        return counts * self.intact

    def part(self, rows: NDArray[np.int64]) -> CdrCursor:
        """Return a cursor over some of the messages, at the same positions."""
        part = CdrCursor(self._messages, self._origins[rows], self._sizes[rows])
        part.intact = self.intact[rows]
        part.position = self.position if isinstance(self.position, int) else self.position[rows]
        return part

    def follow(self, part: CdrCursor, rows: NDArray[np.int64]) -> None:
        """Move some of the messages to where another cursor has moved them."""
        position = np.array(np.broadcast_to(self.position, len(self)))
        position[rows] = part.position
        self.intact[rows] = part.intact
        self.move(position)

    def _check(self, end: Offset) -> None:
        if not isinstance(end, int) or end > self._smallest:
            self.intact &= end <= self._sizes

    def _checked(self, start: Offset, size: Offset) -> NDArray[np.int64]:
        """Return positions in the buffer; 0 for messages that are too short."""
        self._check(start + size)
        positions = self._origins + start
        return positions if self.intact.all() else np.where(self.intact, positions, 0)


def text_of(piece: bytes, order: str, *, wide: bool) -> str:
    """Return a text in UTF-8; a wide one of UTF-16 code units, each in 4 bytes of an order."""
    if not wide:
        return str(piece.removesuffix(b'\0'), 'utf-8', 'replace')
    units = np.frombuffer(piece, f'{order}u4')
    return units.astype('<u2').tobytes().decode('utf-16-le', 'replace')
