"""Knowledge of regions that are told, not drawn: what follows from it, and what contradicts it.

    knowledge = SpatialKnowledge(['kitchen part_of flat', 'flat DC office'])
    knowledge.possible('kitchen', 'office')     DC

*Path consistency* removes from what a may be to c all that no composition over a region b allows.
Where one relation is left for each two regions, it decides whether they can be drawn so (J. Renz,
B. Nebel, "On the complexity of qualitative spatial reasoning", 1999): in a *scenario*.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Final, TypeAlias

from dyknow_common import listed
from dyknow_space.errors import SpaceError
from dyknow_space.relations.calculus import ANY, NAMES, RegionRelation, bases, compose, converse
from dyknow_space.relations.drawn import relation_of

MAX_REGIONS: Final = 100
"""The most regions that statements may be about: the work grows with their cube."""
MAX_CHOICES: Final = 20_000
"""The most relations that are tried to answer a question."""

_STATEMENT: Final = re.compile(r"\s*([\w']+)\s+(\w+|\{[\w\s,]+\})\s+([\w']+)\s*", re.ASCII)

Pair: TypeAlias = tuple[str, str]
_Relations: TypeAlias = dict[Pair, RegionRelation]


@dataclass(frozen=True, slots=True)
class SpatialStatement:
    """A relation between two regions that is told or drawn; `str` is its text."""

    first: str
    relation: RegionRelation
    second: str

    def __str__(self) -> str:
        return f'{self.first} {self.relation} {self.second}'


def parse_statement(text: str) -> SpatialStatement:
    """Return a statement: `kitchen part_of flat`, `hall {EC, DC} flat`.

    Raises:
        SpaceError: for a text that is none, or an unknown relation.
    """
    found = _STATEMENT.fullmatch(text)
    if found is None:
        raise SpaceError(
            f"'{text}' is no statement about regions; write, for example, 'kitchen part_of flat'"
        )
    first, names, second = found.groups()
    relation = 0
    for name in re.findall(r'\w+', names):
        if name not in NAMES:
            raise SpaceError(
                f"'{text}': there is no relation '{name}' (there are: {listed(NAMES)})"
            )
        relation |= NAMES[name]
    return SpatialStatement(first, RegionRelation(relation), second)


class SpatialKnowledge:
    """What statements say of the relations between regions.

    Args:
        statements: the statements, or their texts.
        drawn: polygons of shapely, by the names of their regions.

    Raises:
        SpaceError: for a text that is no statement, too many regions, or a contradiction, of which
            it names statements without any one of which there would be none.
    """

    def __init__(
        self,
        statements: Iterable[SpatialStatement | str],
        drawn: Mapping[str, Any] | None = None,
    ) -> None:
        told = [parse_statement(each) if isinstance(each, str) else each for each in statements]
        told += (
            SpatialStatement(a, relation_of(first, second), b)
            for (a, first), (b, second) in combinations((drawn or {}).items(), 2)
        )
        self.regions = sorted({name for each in told for name in (each.first, each.second)})
        if len(self.regions) > MAX_REGIONS:
            raise SpaceError(
                f'the statements are about {len(self.regions)} regions, more than {MAX_REGIONS}; '
                'tell less at once'
            )
        self._choices = 0
        self._relations = self._closed(told)
        if not self._is_consistent(self._relations):
            shown = '; '.join(map(str, self._contradiction(told)))
            raise SpaceError(f'statements about regions contradict each other: {shown}')

    def possible(self, first: str, second: str) -> RegionRelation:
        """Return the relations that a region has to another one in some scenario.

        Raises:
            SpaceError: for an unknown region, or if there are too many choices to try.
        """
        pair = self._pair(first, second)
        found = 0
        for each, _ in self._scenarios([pair]):
            found |= each[pair]
        return RegionRelation(found)

    def verdict(
        self, pairs: Sequence[Pair], holds: Callable[[Mapping[Pair, RegionRelation]], bool]
    ) -> bool | None:
        """Return the truth of a condition, or None if scenarios differ.

        Args:
            pairs: the regions whose relations the condition depends on.
            holds: the condition, given one relation for each pair.

        Raises:
            SpaceError: as `possible`.
        """
        found = set[bool]()
        for each, _ in self._scenarios([self._pair(*pair) for pair in pairs]):
            found.add(holds(each))
            if len(found) > 1:
                return None
        return found.pop()

    def _pair(self, first: str, second: str) -> Pair:
        for name in (first, second):
            if name not in self.regions:
                known = listed(self.regions) or 'none'
                raise SpaceError(f"nothing is told of the region '{name}' (there are: {known})")
        self._choices = 0
        return first, second

    def _scenarios(self, pairs: Sequence[Pair]) -> Iterator[tuple[_Relations, _Relations]]:
        """Yield the relations of some pairs in each scenario, and what follows from them."""
        yield from self._chosen(self._relations, pairs, {})

    def _chosen(
        self, relations: _Relations, pairs: Sequence[Pair], chosen: _Relations
    ) -> Iterator[tuple[_Relations, _Relations]]:
        if not pairs:
            if self._is_consistent(relations):
                yield chosen, relations
            return
        pair, *others = pairs
        for each, narrowed in self._narrowed(relations, pair):
            yield from self._chosen(narrowed, others, {**chosen, pair: each})

    def _is_consistent(self, relations: _Relations) -> bool:
        """Return True if a scenario has one of the relations of each pair, which are closed."""
        if not all(relations.values()):
            return False
        pending = [pair for pair, each in relations.items() if each.bit_count() > 1]
        if not pending:
            return True
        pair = min(pending, key=lambda each: relations[each].bit_count())
        return any(self._is_consistent(each) for _, each in self._narrowed(relations, pair))

    def _narrowed(
        self, relations: _Relations, pair: Pair
    ) -> Iterator[tuple[RegionRelation, _Relations]]:
        """Yield each relation that a pair may have, and what follows from it."""
        for each in bases(relations[pair]):
            self._choices += 1
            if self._choices > MAX_CHOICES:
                raise SpaceError(
                    f'the relations of the regions allow too many choices (more than {MAX_CHOICES} '
                    'were tried); tell more of them, or ask about fewer'
                )
            first, second = pair
            narrowed = relations | {pair: each, (second, first): converse(each)}
            found = self._path_consistent(narrowed, [pair])
            if found is not None:
                yield each, found

    def _closed(self, told: Iterable[SpatialStatement]) -> _Relations:
        """Return what statements say of each pair; nothing is possible in a contradiction."""
        same = {(name, name): RegionRelation.EQ for name in self.regions}
        found = dict.fromkeys(((a, b) for a in self.regions for b in self.regions), ANY) | same
        for each in told:
            for pair, relation in (
                ((each.first, each.second), each.relation),
                ((each.second, each.first), converse(each.relation)),
            ):
                found[pair] &= relation
        closed = self._path_consistent(found, list(found)) if all(found.values()) else None
        return closed or dict.fromkeys(found, RegionRelation(0))

    def _path_consistent(self, relations: _Relations, changed: Iterable[Pair]) -> _Relations | None:
        """Return relations without what compositions exclude; None if nothing is left of one."""
        found, pending = dict(relations), dict.fromkeys(changed)
        while pending:
            a, b = next(iter(pending))
            del pending[a, b]
            for c in self.regions:
                for (x, y), (z, w) in (((a, b), (b, c)), ((c, a), (a, b))):
                    narrower = found[x, w] & compose(found[x, y], found[z, w])
                    if not narrower:
                        return None
                    if narrower != found[x, w]:
                        found[x, w], found[w, x] = narrower, converse(narrower)
                        pending[x, w] = None
        return found

    def _contradiction(self, told: Sequence[SpatialStatement]) -> list[SpatialStatement]:
        """Return contradictory statements, none of which can be left out."""
        needed = list(told)
        for each in told:
            others = [other for other in needed if other is not each]
            self._choices = 0
            if not self._is_consistent(self._closed(others)):
                needed = others
        return needed
