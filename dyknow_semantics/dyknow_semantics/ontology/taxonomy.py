"""An order of concepts: which lies below which."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping


class Taxonomy:
    """The reflexive and transitive closure of a relation; what lies below each other is equivalent.

    Args:
        pairs: each a concept and one that lies above it.
    """

    def __init__(self, pairs: Iterable[tuple[str, str]]) -> None:
        self._parents: dict[str, set[str]] = defaultdict(set)
        self._children: dict[str, set[str]] = defaultdict(set)
        for child, parent in pairs:
            self._parents[child].add(parent)
            self._children[parent].add(child)
        self._above: dict[str, frozenset[str]] = {}
        self._below: dict[str, frozenset[str]] = {}

    def above(self, concept: str) -> frozenset[str]:
        """A concept and all that lie above it."""
        if concept not in self._above:
            self._above[concept] = _reachable(concept, self._parents)
        return self._above[concept]

    def below(self, concept: str) -> frozenset[str]:
        """A concept and all that lie below it."""
        if concept not in self._below:
            self._below[concept] = _reachable(concept, self._children)
        return self._below[concept]

    def specific_first(self, concepts: Iterable[str]) -> list[str]:
        """Concepts such that each comes before all that lie strictly above it; else by name."""
        return sorted(concepts, key=lambda concept: (-len(self.above(concept)), concept))


def _reachable(start: str, edges: Mapping[str, set[str]]) -> frozenset[str]:
    reached = {start}
    frontier = [start]
    while frontier:
        new = edges.get(frontier.pop(), set()) - reached
        reached |= new
        frontier.extend(new)
    return frozenset(reached)
