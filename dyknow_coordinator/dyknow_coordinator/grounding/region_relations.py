"""Relations between regions in formulas: what the ontology says of them is known before any state.

If `dock` is a part of `warehouse`, and `street` is not, the formula `forall z in Aisle:
part_of[z, warehouse]` is `forall z in Aisle: z = dock`. If it is not known whether `yard` is, a
text that is unknown at each state tells the cases apart:

    forall z in Aisle: ((open_relation[warehouse, yard] = "yard part_of warehouse") and (...)) or
        ((open_relation[warehouse, yard] != "yard part_of warehouse") and (...))

It is read at the first state only, so the formula is decided when all cases decide it alike.

A variable with the name of a region that the new text mentions has another name in it.
"""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice, product
from typing import Final

from dyknow_common import Symbol, SymbolKind
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.candidate_search import OPEN_RELATION, feature_symbols
from dyknow_coordinator.grounding.declared_properties import QueryFunction
from dyknow_coordinator.grounding.scopes import NAME, Scopes
from dyknow_space import RELATION_NAMES, RegionRelation, SpatialKnowledge, SpatialStatement

MAX_CASES: Final = 64
"""The most cases of relations that are not known."""

_QUERY: Final = """
    SELECT ?region ?statements WHERE {
        ?region <http://www.dyknow.org/ontology#relations> ?statements .
    }
"""

_ATOM: Final = re.compile(
    rf'"(?:\\.|[^"\\])*"|\b(?P<relation>{"|".join(RELATION_NAMES)})'
    rf'\[(?P<first>{NAME}), (?P<second>{NAME})\]'
)
_FORALL: Final = re.compile(rf'(forall {NAME} in {NAME}: )(.*)', re.DOTALL)

DomainFunction = Callable[[Sequence[str]], Awaitable[Mapping[str, Sequence[str]]]]
"""Returns the objects of each of some sorts."""


def ground_features(symbols: Iterable[Symbol]) -> tuple[str, ...]:
    """Return the features of objects that the states of a formula must hold.

    Raises:
        CoordinationError: if it depends on nothing but relations that are not known.
    """
    found = tuple(symbols)
    features = tuple(map(str, feature_symbols(found)))
    unknown = [each for each in found if each.name == OPEN_RELATION]
    if unknown and not features:
        regions = ', '.join(unknown[0].arguments)
        raise CoordinationError(
            f'it cannot be decided: the relations of {regions} are not known; tell them in '
            "'relations', or draw the regions"
        )
    return features


async def with_relations(
    formula: str, symbols: Iterable[Symbol], domains: DomainFunction, query: QueryFunction
) -> str:
    """Return a formula in which relations between regions are replaced by what is known of them.

    Args:
        formula: its canonical text, with all sorts.
        symbols: the symbols of the formula.
        domains: returns the objects of sorts.
        query: returns the solutions of a SPARQL query of the ontology.

    Raises:
        CoordinationError: if the unknown relations have too many cases, or for a region with the
            name of a feature or a sort of the formula; for a relation in the place of a value.
        DyKnowError: if nothing is known of a region, or a request fails.
    """
    if not any(each['relation'] for each in _ATOM.finditer(formula)):
        return formula
    rows = await query(_QUERY)
    if not rows:
        return formula  # They are features.
    scopes = Scopes(formula)
    objects = await domains(scopes.sorts)
    knowledge = _knowledge(tuple(sorted({statements for _, statements in rows})))
    text, regions = _RelationTexts(scopes, objects, knowledge).text()
    _check_regions(regions, scopes, symbols)
    captured = regions & scopes.names
    if not captured:
        return text
    others = regions.union(*objects.values())
    new_names = {name: scopes.unused_name(name, others) for name in sorted(captured)}
    text, _ = _RelationTexts(Scopes(scopes.renamed(new_names)), objects, knowledge).text()
    return text


def _check_regions(regions: Iterable[str], scopes: Scopes, symbols: Iterable[Symbol]) -> None:
    """Check that the regions that a new text mentions stand for nothing else in the formula."""
    kinds = {each.name: 'feature' for each in symbols if each.kind is SymbolKind.FEATURE}
    kinds |= dict.fromkeys(scopes.sorts, 'sort')
    for name in sorted(regions):
        if name in kinds:
            raise CoordinationError(
                f"'{name}' is a region and a {kinds[name]} of the formula; rename one of them"
            )


@lru_cache(8)
def _knowledge(texts: Sequence[str]) -> SpatialKnowledge:
    return SpatialKnowledge(statement for text in texts for statement in text.split(';'))


@dataclass(frozen=True, slots=True)
class _Atom:
    """A relation in a formula.

    Args:
        relation: the relation.
        names: the names of the regions, or of variables.
        objects: the objects that each variable stands for; None for a region.
    """

    relation: RegionRelation
    names: tuple[str, str]
    objects: tuple[Sequence[str] | None, ...]

    def questions(self) -> dict[tuple[str, str], SpatialStatement]:
        """Return what it asks for each two regions that it may be about."""
        pairs = zip(self.names, self.objects, strict=True)
        first, second = ((name,) if found is None else found for name, found in pairs)
        both = product(first, second)
        if self.names[0] == self.names[1]:
            both = zip(first, second, strict=True)  # type: ignore[assignment]
        return {(a, b): SpatialStatement(a, self.relation, b) for a, b in both}


class _RelationTexts:
    """Replaces the relations in a formula.

    Args:
        scopes: the scopes of its canonical text.
        domains: the objects of its sorts.
        knowledge: the knowledge of the regions.
    """

    def __init__(
        self, scopes: Scopes, domains: Mapping[str, Sequence[str]], knowledge: SpatialKnowledge
    ) -> None:
        self._formula, self._knowledge = scopes.formula, knowledge
        self._regions: set[str] = set()
        atoms = [each for each in _ATOM.finditer(self._formula) if each['relation']]
        self._atoms = [_atom(each, scopes, domains) for each in atoms]
        questions = {each for atom in self._atoms for each in atom.questions().values()}
        truths = {each: self._truth(each) for each in questions}
        self._known = {each: truth for each, truth in truths.items() if truth is not None}
        self._open = sorted(questions - self._known.keys(), key=str)

    def text(self) -> tuple[str, frozenset[str]]:
        """Return the formula without relations, and the regions that it mentions instead."""
        text = self._without_relations()
        return text, frozenset(self._regions)

    def _without_relations(self) -> str:
        if not self._open:
            return self._replaced(self._formula, self._known)
        cases = list(islice(self._knowledge.cases(self._open), MAX_CASES + 1))
        if len(cases) > MAX_CASES:
            raise CoordinationError(
                f'the formula depends on {len(self._open)} relations that are not known, which '
                f"have more than {MAX_CASES} cases; tell more of them in 'relations'"
            )
        return self._distinguished(self._formula, cases)

    def _distinguished(self, formula: str, cases: Sequence[Sequence[bool]]) -> str:
        """Return a formula that is like it in each case; a case is the same for all objects."""
        if found := _FORALL.fullmatch(formula):
            head, body = found.groups()
            body = body[1:-1] if body.startswith('(') else body
            return f'{head}({self._distinguished(body, cases)})'
        *others, last = cases
        regions = sorted({name for each in self._open for name in (each.first, each.second)})
        self._regions.update(regions)
        feature = f'{OPEN_RELATION}[{", ".join(regions)}]'
        text = self._in_case(formula, last)
        for case in reversed(others):
            pairs = zip(self._open, case, strict=True)
            label = '; '.join(f'{"" if truth else "not "}{each}' for each, truth in pairs)
            holds = f'({feature} = "{label}") and ({self._in_case(formula, case)})'
            text = f'({holds}) or (({feature} != "{label}") and ({text}))'
        return text

    def _in_case(self, formula: str, case: Sequence[bool]) -> str:
        truths = self._known | dict(zip(self._open, case, strict=True))
        return self._replaced(formula, truths)

    def _replaced(self, formula: str, truths: Mapping[SpatialStatement, bool]) -> str:
        """Return a text that contains all relations of the formula without them."""
        atoms = iter(self._atoms)

        def replacement(found: re.Match[str]) -> str:
            if not found['relation']:
                return found[0]
            atom = next(atoms)
            questions = atom.questions()
            true = [names for names, each in questions.items() if truths[each]]
            other = [names for names, each in questions.items() if not truths[each]]
            if len(true) <= len(other):
                return f'({self._equalities(atom, true)})'
            return f'(not ({self._equalities(atom, other)}))'

        return _ATOM.sub(replacement, formula)

    def _equalities(self, atom: _Atom, found: Iterable[tuple[str, str]]) -> str:
        """Return that the variables of an atom stand for one of some pairs."""
        texts = list(self._pair_texts(atom, found))
        return 'true' if '' in texts else ' or '.join(texts) or 'false'

    def _pair_texts(self, atom: _Atom, found: Iterable[tuple[str, str]]) -> Iterator[str]:
        for regions in found:
            compared = dict.fromkeys(
                (name, region)
                for name, objects, region in zip(atom.names, atom.objects, regions, strict=True)
                if objects is not None
            )
            self._regions.update(region for _, region in compared)
            equal = [f'({name} = {region})' for name, region in compared]
            yield f'({" and ".join(equal)})' if equal else ''

    def _truth(self, asked: SpatialStatement) -> bool | None:
        if asked.first == asked.second:
            return bool(asked.relation & RegionRelation.EQ)
        possible = self._knowledge.possible(asked.first, asked.second)
        if not possible & asked.relation:
            return False
        return None if possible & ~asked.relation else True


def _atom(found: re.Match[str], scopes: Scopes, domains: Mapping[str, Sequence[str]]) -> _Atom:
    start, end = found.span()
    before, after = scopes.formula[max(0, start - 6) : start], scopes.formula[end : end + 5]
    is_value = before.endswith(('= ', 'prev(')) or after.startswith((' = ', ' != '))
    if is_value or (before == 'count(' and after == ' for '):
        raise CoordinationError(
            f"'{found[0]}' is a relation of regions, which cannot be counted, compared or kept; "
            "write it alone, and instead of a count, 'at least 2 x in S: ...'"
        )
    names = found['first'], found['second']
    binders = [scopes.binder(name, found.start()) for name in names]
    objects = tuple(
        None if each is None else tuple(dict.fromkeys(domains[each.sort or ''])) for each in binders
    )
    return _Atom(RELATION_NAMES[found['relation']], names, objects)
