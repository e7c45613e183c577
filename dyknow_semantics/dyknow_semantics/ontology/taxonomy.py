"""The order of concepts."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from functools import cache, partial


class Taxonomy:
    """The reflexive and transitive closure of a relation "lies below".

    Concepts that lie below each other are equivalent. Example: the pairs (Observer, UAV),
    (UAV, Drone), (Drone, UAV) and (UAV, Vehicle) give

        above('Observer') == {'Observer', 'UAV', 'Drone', 'Vehicle'}
        below('Drone') == {'Drone', 'UAV', 'Observer'}
        specific_first(['Vehicle', 'UAV', 'Observer']) == ['Observer', 'UAV', 'Vehicle']

    Args:
        pairs: each a concept and one that lies above it.
    """

    def __init__(self, pairs: Iterable[tuple[str, str]]) -> None:
        parents: dict[str, set[str]] = defaultdict(set)
        children: dict[str, set[str]] = defaultdict(set)
        for child, parent in pairs:
            parents[child].add(parent)
            children[parent].add(child)
        self._above = cache(partial(_reachable, parents))
        self._below = cache(partial(_reachable, children))

    def above(self, concept: str) -> frozenset[str]:
        """Return a concept and all that lie above it."""
        return self._above(concept)

    def below(self, concept: str) -> frozenset[str]:
        """Return a concept and all that lie below it."""
        return self._below(concept)

    def specific_first(self, concepts: Iterable[str]) -> list[str]:
        """Sort concepts: each before all that lie strictly above it, otherwise by name."""
        return sorted(concepts, key=lambda concept: (-len(self.above(concept)), concept))


def _reachable(edges: Mapping[str, set[str]], start: str) -> frozenset[str]:
    reached = {start}
    frontier = [start]
    while frontier:
        new = edges.get(frontier.pop(), set()) - reached
        reached |= new
        frontier.extend(new)
    return frozenset(reached)
