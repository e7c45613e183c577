"""The size of resolved streams, which is bounded.

A resolved stream contains the streams that it is made of, each as often as it refers to them. So
its size may double with each declaration, and the number of its samples, too:
`stream b = merge(a, a); stream c = merge(b, b); ...`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import Final

from dyknow_common import MAX_DEPTH, MAX_STREAM_PARTS
from dyknow_stream_processing.language.specification import Merge, Select, StreamReference, Term

MAX_PARTS: Final = 20_000
"""The number of parts of one stream, with all streams that it is made of."""

MAX_COPIES: Final = 100
"""The number of samples of a stream that merges make of one sample of a topic."""

MAX_FIELDS: Final = 10_000
"""The number of fields of a stream."""


@dataclass(frozen=True, slots=True)
class _Extent:
    """The depth of a term, the number of terms in it, and the samples for one of each origin."""

    term: Term
    depth: int
    parts: int
    copies: Mapping[Hashable, int]


class TermSizes:
    """Counts the parts of resolved streams; a part that several share is visited once."""

    def __init__(self) -> None:
        self._total = 0
        # The terms are kept, so that their identities stay theirs.
        self._known: dict[int, _Extent] = {}

    def excess(self, term: Term) -> str:
        """Add a resolved stream, and return what is too large; empty if nothing is."""
        extent = self._extent(term)
        self._total += extent.parts
        if extent.depth > MAX_DEPTH:
            return f'it is made through more than {MAX_DEPTH} streams, one from the other'
        if max(extent.copies.values()) > MAX_COPIES:
            return f'its merges repeat each sample of a stream more than {MAX_COPIES} times'
        if extent.parts > MAX_PARTS:
            return f'it has more than {MAX_PARTS} parts, with all streams that it is made of'
        if self._total > MAX_STREAM_PARTS:
            return f'the streams that it is made of have more than {MAX_STREAM_PARTS} parts'
        return ''

    def _extent(self, term: Term) -> _Extent:
        if id(term) not in self._known:
            extents = [self._extent(each) for each in term.inputs]
            depth = 1 + max((each.depth for each in extents), default=0)
            parts = 1 + sum(each.parts for each in extents)
            copies: Mapping[Hashable, int] = {id(term): 1}
            match term:
                case StreamReference():
                    copies = {term.name: 1}
                case Select():
                    copies = extents[0].copies
                case Merge():
                    counter: Counter[Hashable] = Counter()
                    for each in extents:
                        counter.update(each.copies)
                    copies = counter
                # A sync and a unit emit once for each valid time.
            self._known[id(term)] = _Extent(term, depth, parts, copies)
        return self._known[id(term)]
