"""Relations of regions in formulas, against the verdicts in each scenario alone."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Iterator, Mapping, Sequence
from importlib.util import find_spec
from itertools import combinations, product
from random import Random

import pytest

from dyknow_common import DyKnowError, Verdict
from dyknow_coordinator import CoordinationError, ground_features
from dyknow_coordinator.grounding.declared_properties import unknown_features
from dyknow_coordinator.grounding.region_relations import with_relations
from dyknow_reasoning import FormulaGroup, UnknownFeatures
from dyknow_space import (
    RELATION_NAMES,
    RegionRelation,
    SpaceError,
    SpatialKnowledge,
    SpatialStatement,
    compose,
    converse,
    parse_statement,
)

pytestmark = pytest.mark.skipif(find_spec('shapely') is None, reason='shapely is not installed')

CASES = int(os.environ.get('DYKNOW_RANDOM_CASES', '20'))
OBJECTS = ('a', 'b', 'c')
DOMAINS = {'Room': OBJECTS}
NAMES = ('DC', 'EC', 'PO', 'TPP', 'NTPP', 'TPPI', 'NTPPI', 'EQ', 'part_of', 'overlaps', 'touches')
Pair = tuple[str, str]


def rewritten(text: str, statements: Sequence[str]) -> str:
    async def domains(sorts: Sequence[str]) -> Mapping[str, Sequence[str]]:
        return {sort: DOMAINS[sort] for sort in sorts}

    async def query(sparql: str) -> Sequence[tuple[str, ...]]:
        return [('a', each) for each in statements] if 'relations' in sparql else []

    group = FormulaGroup()
    canonical = str(group.formulas[group.add_formula('', text)])
    return asyncio.run(with_relations(canonical, group.symbols(), domains, query))


def verdict(text: str, trace: Sequence[int]) -> Verdict:
    async def query(_: str) -> Sequence[tuple[str, ...]]:
        return []

    group = FormulaGroup()
    group.add_formula('', text)
    group.begin(DOMAINS, UnknownFeatures(asyncio.run(unknown_features(group.symbols(), query))))
    results = group.decided_at_once()
    for time, value in enumerate(trace):
        if not results:
            results = group.progress(time * 10**9, {'p': value})
    return results[0].verdict if results else Verdict.UNDECIDED


def scenarios(statements: Sequence[str]) -> Iterator[dict[Pair, RegionRelation]]:
    """All choices of one relation for each two regions that agree with the statements."""
    told = [parse_statement(each) for each in statements]
    for ab, bc, ac in product(RegionRelation, repeat=3):
        if not ac & compose(ab, bc):
            continue
        found = {('a', 'b'): ab, ('b', 'c'): bc, ('a', 'c'): ac}
        found |= {(y, x): converse(each) for (x, y), each in found.items()}
        if all(found[each.first, each.second] & each.relation for each in told):
            yield found | {(each, each): RegionRelation.EQ for each in OBJECTS}


class RandomFormula:
    """A formula, and its text in a scenario, with quantifiers written out."""

    def __init__(self, random: Random) -> None:
        self._random = random
        self._tree = self._make(3, [])

    def _make(self, depth: int, bound: list[str]) -> tuple[object, ...]:
        random, variables = self._random, [*OBJECTS, *bound * 3]
        kind = random.choice(('atom', 'atom', 'p'))
        if depth:
            kind = random.choice(('atom', 'not', 'and', 'or', '->', 'forall', 'exists', 'time'))
        match kind:
            case 'atom':
                names = random.choice(variables), random.choice(variables)
                return (kind, random.choice(NAMES), *names)
            case 'p':
                return kind, random.choice(('p > 0', 'p > 1', 'always p > 0', 'eventually p > 1'))
            case 'forall' | 'exists':
                variable = f'v{len(bound)}'
                return kind, variable, self._make(depth - 1, [*bound, variable])
            case 'not' | 'time':
                word = 'not' if kind == 'not' else random.choice(('always', 'eventually[0 s, 1 s]'))
                return 'not', word, self._make(depth - 1, bound)
            case _:
                return kind, self._make(depth - 1, bound), self._make(depth - 1, bound)

    def text(self, scenario: Mapping[Pair, RegionRelation] | None = None) -> str:
        return self._text(self._tree, {}, scenario)

    def _text(  # noqa: PLR0911 - one for each kind
        self,
        tree: tuple[object, ...],
        bound: Mapping[str, str],
        scenario: Mapping[Pair, RegionRelation] | None,
    ) -> str:
        def part(each: object, more: Mapping[str, str] = bound) -> str:
            assert isinstance(each, tuple)
            return f'({self._text(each, more, scenario)})'

        match tree:
            case 'atom', str(name), str(first), str(second):
                if scenario is None:
                    return f'{name}({first}, {second})'
                found = scenario[bound.get(first, first), bound.get(second, second)]
                return 'true' if found & RELATION_NAMES[name] else 'false'
            case 'p', str(text):
                return text
            case ('forall' | 'exists') as word, str(variable), body:
                if scenario is None:
                    return f'{word} {variable} in Room: {part(body)}'
                texts = [part(body, {**bound, variable: each}) for each in OBJECTS]
                return (' and ' if word == 'forall' else ' or ').join(texts)
            case 'not', str(word), body:
                return f'{word} {part(body)}'
            case str(word), left, right:
                return f'{part(left)} {word} {part(right)}'
        raise AssertionError(tree)


def test_a_formula_is_decided_when_all_scenarios_agree() -> None:
    agreed = differing = 0
    for case in range(CASES):
        random = Random(case)  # noqa: S311 - no secrets
        told = [
            f'{x} {{{", ".join(random.sample([str(each) for each in RegionRelation], 3))}}} {y}'
            for x, y in random.sample(list(combinations(OBJECTS, 2)), random.randint(2, 3))
        ]
        found = list(scenarios(told))
        if not found:
            continue
        if len({y for each in told for y in each.split() if y in OBJECTS}) < len(OBJECTS):
            told.append(f'c {{{", ".join(map(str, RegionRelation))}}} a')
        trace = [random.randint(0, 2) for _ in range(3)]
        formula = RandomFormula(random)
        expected = {verdict(formula.text(each), trace) for each in found}
        single = expected.pop() if len(expected) == 1 else Verdict.UNDECIDED
        agreed, differing = agreed + (not expected), differing + bool(expected)
        text = rewritten(formula.text(), told)
        assert verdict(text, trace) is single, (told, formula.text(), text, trace)
    assert agreed
    assert differing or CASES < 10


def test_what_is_told_of_no_region() -> None:
    with pytest.raises(SpaceError, match=r"nothing is told of the region 'c' .there are: a, b"):
        rewritten('forall z in Room: DC[z, a]', ['a EC b'])
    assert rewritten('DC[a, b]', []) == 'DC[a, b]'


def test_too_much_is_not_known() -> None:
    names = ', '.join(map(str, RegionRelation))
    rooms = [f'r{number}' for number in range(9)]
    told = [f'{x} {{{names}}} {y}' for x, y in combinations(rooms, 2)]
    atoms = ' and '.join(f'overlaps[{x}, {y}]' for x, y in combinations(rooms, 2))
    with pytest.raises(DyKnowError, match=r'36 relations that are not known.*more than 64 cases'):
        rewritten(atoms, told)


def test_relations_alone() -> None:
    group = FormulaGroup()
    group.add_formula('', rewritten('EC[a, b]', ['a {EC, DC} b']))
    group.begin({})
    with pytest.raises(CoordinationError, match='the relations of a, b are not known; tell them'):
        ground_features(group.symbols())


def test_statements_have_one_text() -> None:
    for text in ('a part_of b', 'a {DC, PO} b', 'a overlaps b', 'a NTPPI b'):
        (statement,) = SpatialKnowledge([text]).statements
        assert str(statement) == text
        assert SpatialStatement('a', statement.relation, 'b') == statement


@pytest.mark.parametrize(
    'text',
    [
        'count(part_of[x, a] for x in Room) > 1',
        'forall x in Room: part_of[x, a] = true',
        'forall x in Room: true != part_of[x, a]',
        'forall x in Room: prev(part_of[x, a]) = true',
        'forall x in Room: let k = part_of[x, a] in p > 1 or k = true',
    ],
)
def test_a_relation_is_no_value(text: str) -> None:
    with pytest.raises(CoordinationError, match=r"'part_of\[x, a\]' is a relation of regions"):
        rewritten(text, ['a {EC, DC} b', 'c EC a'])
