"""The order of concepts."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from functools import cache, partial
from typing import Final

from dyknow_semantics.errors import SemanticsError

MAX_PAIRS: Final = 1_000_000
"""The number of pairs in the closure of a relation."""


class Taxonomy:
    """The reflexive and transitive closure of a relation "lies below".

    Concepts that lie below each other are equivalent. Example: the pairs (Observer, UAV),
    (UAV, Drone), (Drone, UAV) and (UAV, Vehicle) give

        above('Observer') == {'Observer', 'UAV', 'Drone', 'Vehicle'}
        below('Drone') == {'Drone', 'UAV', 'Observer'}
        specific_first(['Vehicle', 'UAV', 'Observer']) == ['Observer', 'UAV', 'Vehicle']

    Args:
        pairs: each a concept and one that lies above it.

    Raises:
        SemanticsError: if the closure has more than MAX_PAIRS pairs.
    """

    def __init__(self, pairs: Iterable[tuple[str, str]]) -> None:
        parents: dict[str, set[str]] = defaultdict(set)
        children: dict[str, set[str]] = defaultdict(set)
        for child, parent in pairs:
            parents[child].add(parent)
            children[parent].add(child)
        self.above = cache(partial(_reachable, parents))
        """Returns a concept and all that lie above it."""
        self.below = cache(partial(_reachable, children))
        """Returns a concept and all that lie below it."""
        self._check_size({*parents, *children})

    def _check_size(self, concepts: Iterable[str]) -> None:
        """Check that the closure is small; a long chain has a large one."""
        size = 0
        for concept in concepts:
            size += len(self.above(concept))
            if size > MAX_PAIRS:
                raise SemanticsError(
                    f'the ontology has more than {MAX_PAIRS:,} pairs of a concept, or a name of an '
                    'instance, and one above it or the same; make its hierarchy flatter'
                )

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
