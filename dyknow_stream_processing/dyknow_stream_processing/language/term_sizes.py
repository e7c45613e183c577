"""The size of resolved streams, which is bounded.

A resolved stream contains the streams that it is made of, each as often as it refers to them. So
its size may double with each declaration: `stream b = merge(a, a); stream c = merge(b, b); ...`.
"""

from __future__ import annotations

from dyknow_common import MAX_DEPTH, MAX_STREAM_PARTS
from dyknow_stream_processing.language.specification import Term


class TermSizes:
    """Counts the parts of resolved streams; a part that several share is visited once."""

    def __init__(self) -> None:
        self._total = 0
        # The terms are kept, so that their identities stay theirs.
        self._known: dict[int, tuple[Term, int, int]] = {}

    def excess(self, term: Term) -> str:
        """Add a resolved stream, and return what is too large; empty if nothing is."""
        depth, parts = self._extent(term)
        self._total += parts
        if depth > MAX_DEPTH:
            return f'it is made through more than {MAX_DEPTH} streams, one from the other'
        if self._total > MAX_STREAM_PARTS:
            return f'the streams that it is made of have more than {MAX_STREAM_PARTS} parts'
        return ''

    def _extent(self, term: Term) -> tuple[int, int]:
        """Return the depth of a term, and the number of terms in it."""
        if id(term) not in self._known:
            extents = [self._extent(each) for each in term.inputs]
            depth = 1 + max((depth for depth, _ in extents), default=0)
            self._known[id(term)] = term, depth, 1 + sum(parts for _, parts in extents)
        return self._known[id(term)][1:]
