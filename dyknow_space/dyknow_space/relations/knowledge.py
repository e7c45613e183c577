"""Knowledge of regions that are told, not drawn: what follows from it, and what contradicts it.

    knowledge = SpatialKnowledge(['kitchen part_of flat', 'flat DC office'])
    knowledge.possible('kitchen', 'office')     DC

*Path consistency* removes from what a may be to c all that no composition over a region b allows.
Where one relation is left for each two regions, it decides whether they can be drawn so (J. Renz,
B. Nebel, "On the complexity of qualitative spatial reasoning", 1999): in a *scenario*.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Final, TypeAlias

from dyknow_common import listed
from dyknow_space.errors import SpaceError
from dyknow_space.regions.region import Region
from dyknow_space.relations.calculus import (
    ANY,
    RELATION_NAMES,
    RegionRelation,
    bases,
    compose,
    converse,
)
from dyknow_space.relations.drawn import relation_of

MAX_RELATED: Final = 100
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
    is_drawn: bool = field(default=False, compare=False)

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
        if name not in RELATION_NAMES:
            raise SpaceError(
                f"'{text}': there is no relation '{name}' (there are: {listed(RELATION_NAMES)})"
            )
        relation |= RELATION_NAMES[name]
    return SpatialStatement(first, RegionRelation(relation), second)


class ContradictionError(SpaceError):
    """Statements about regions with which no scenario agrees.

    Args:
        statements: a minimal contradiction: if any statement is removed, the others are consistent.
    """

    def __init__(self, statements: Sequence[SpatialStatement]) -> None:
        self.statements = statements
        shown = '; '.join(f'{each}{" (drawn)" if each.is_drawn else ""}' for each in statements)
        super().__init__(f'statements about regions contradict each other: {shown}')


class SpatialKnowledge:
    """The relations between regions that statements leave possible.

    Args:
        statements: the statements, or their texts.
        drawn: regions, whose relations are known where they can be compared.

    Raises:
        SpaceError: for a text that is no statement, or too many regions.
        ContradictionError: if no scenario agrees with the statements.
    """

    def __init__(
        self, statements: Iterable[SpatialStatement | str], drawn: Sequence[Region] = ()
    ) -> None:
        told = [parse_statement(each) if isinstance(each, str) else each for each in statements]
        for first, second in combinations(drawn, 2):
            relation = relation_of(first, second)
            if relation is not None:
                told.append(SpatialStatement(first.name, relation, second.name, is_drawn=True))
        self.regions = sorted({name for each in told for name in (each.first, each.second)})
        if len(self.regions) > MAX_RELATED:
            raise SpaceError(
                f'the statements are about {len(self.regions)} regions, more than {MAX_RELATED}; '
                'tell less at once'
            )
        self._choices = 0
        self._relations = self._closed(told)
        if not self._is_consistent(self._relations):
            raise ContradictionError(self._contradiction(told))

    @property
    def statements(self) -> Iterator[SpatialStatement]:
        """A statement for each pair of regions with known relations."""
        for pair in combinations(self.regions, 2):
            if self._relations[pair] != ANY:
                yield SpatialStatement(pair[0], self._relations[pair], pair[1])

    def possible(self, first: str, second: str) -> RegionRelation:
        """Return the relations that a region has to another one in some scenario.

        Raises:
            SpaceError: for an unknown region, or if there are too many choices to try.
        """
        pair = self._pair(first, second)
        found = 0
        for each, narrowed in self._narrowed(self._relations, pair, bases(self._relations[pair])):
            found |= each if self._is_consistent(narrowed) else 0
        return RegionRelation(found)

    def cases(self, questions: Sequence[SpatialStatement]) -> Iterator[tuple[bool, ...]]:
        """Yield the truths that questions have together in some scenario, each once.

        Args:
            questions: the questions of each two regions, whether they have one of some relations.

        Raises:
            SpaceError: as `possible`.
        """
        for each in questions:
            self._pair(each.first, each.second)
        yield from self._cases(self._relations, questions)

    def _cases(
        self, relations: _Relations, questions: Sequence[SpatialStatement]
    ) -> Iterator[tuple[bool, ...]]:
        if not questions:
            yield ()
            return
        asked, *others = questions
        pair, parts = (asked.first, asked.second), (asked.relation, ANY & ~asked.relation)
        for each, narrowed in self._narrowed(relations, pair, parts):
            if self._is_consistent(narrowed):
                for rest in self._cases(narrowed, others):
                    yield (each == asked.relation, *rest)

    def _pair(self, first: str, second: str) -> Pair:
        for name in (first, second):
            if name not in self.regions:
                known = listed(self.regions) or 'none'
                raise SpaceError(f"nothing is told of the region '{name}' (there are: {known})")
        self._choices = 0
        return first, second

    def _is_consistent(self, relations: _Relations) -> bool:
        """Return True if a scenario has one of the relations of each pair, which are closed."""
        if not all(relations.values()):
            return False
        pending = [pair for pair, each in relations.items() if each.bit_count() > 1]
        if not pending:
            return True
        pair = min(pending, key=lambda each: relations[each].bit_count())
        narrowed = self._narrowed(relations, pair, bases(relations[pair]))
        return any(self._is_consistent(each) for _, each in narrowed)

    def _narrowed(
        self, relations: _Relations, pair: Pair, parts: Iterable[RegionRelation]
    ) -> Iterator[tuple[RegionRelation, _Relations]]:
        """Yield each part of the relations that a pair may have, and what follows from it."""
        for each in parts:
            narrower = relations[pair] & each
            if narrower in {RegionRelation(0), relations[pair]}:
                if narrower:
                    yield each, relations
                continue
            self._choices += 1
            if self._choices > MAX_CHOICES:
                raise SpaceError(
                    f'the relations of the regions allow too many choices (more than {MAX_CHOICES} '
                    'were tried); tell more of them, or ask about fewer'
                )
            first, second = pair
            narrowed = relations | {pair: narrower, (second, first): converse(narrower)}
            found = self._path_consistent(narrowed, [pair])
            if found is not None:
                yield each, found

    def _closed(self, told: Iterable[SpatialStatement]) -> _Relations:
        """Return what follows from statements of each pair; nothing in a contradiction.

        Drawn regions agree with each other, so it begins with what is told.
        """
        told = list(told)
        same = {(name, name): RegionRelation.EQ for name in self.regions}
        found = dict.fromkeys(((a, b) for a in self.regions for b in self.regions), ANY) | same
        for each in told:
            for pair, relation in (
                ((each.first, each.second), each.relation),
                ((each.second, each.first), converse(each.relation)),
            ):
                found[pair] &= relation
        changed = {(each.first, each.second) for each in told if not each.is_drawn}
        closed = self._path_consistent(found, changed) if all(found.values()) else None
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
        """Return a minimal set of contradictory statements."""
        needed = list(told)
        for each in told:
            others = [other for other in needed if other is not each]
            self._choices = 0
            if not self._is_consistent(self._closed(others)):
                needed = others
        return needed
