"""Formulas whose variables have names of regions, against the same formulas with other names."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from itertools import combinations, permutations
from random import Random
from typing import Any

import pytest

from dyknow_common import Symbol, Verdict
from dyknow_coordinator import CoordinationError, completed
from dyknow_coordinator.grounding.declared_properties import unknown_features
from dyknow_coordinator.grounding.scopes import Scopes
from dyknow_reasoning import FormulaGroup, UnknownFeatures, parse_formula
from dyknow_reasoning.language.formula import Freeze, walk, with_changed_parts
from dyknow_reasoning.language.terms import Kept, Quantifier, Variable
from dyknow_space import RELATION_NAMES, RegionRelation, SpaceError, SpatialKnowledge

pytestmark = pytest.mark.skipif(find_spec('shapely') is None, reason='shapely is not installed')

CASES = int(os.environ.get('DYKNOW_RANDOM_CASES', '60'))
OBJECTS = ('a', 'b', 'c')
DOMAINS = {'Room': OBJECTS, 'Hall': ('b', 'c'), 'Robot': ('r1',)}
SORTS = ('Room', 'Hall')
RELATIONS = ('DC', 'EC', 'PO', 'TPP', 'NTPPI', 'EQ', 'part_of', 'overlaps', 'touches')
Pair = tuple[str, str]
Scenario = Mapping[Pair, RegionRelation]


@dataclass(frozen=True)
class Text:
    """How a formula is written.

    Args:
        names: of its variables; with a scenario, the objects that they stand for.
        kept: the name of each kept value.
        scenario: the relations of the regions; None: the text asks for them.
    """

    names: Mapping[int, str]
    kept: Mapping[int, str]
    scenario: Scenario | None = None

    def name(self, variable: int | str) -> str:
        return self.names[variable] if isinstance(variable, int) else variable

    def each(self, variable: int, sort: str, body: Node) -> list[str]:
        """Return the text of a formula for each object that a variable stands for."""
        return [self.of(variable, each, body) for each in DOMAINS[sort]]

    def of(self, variable: int, found: str, body: Node) -> str:
        return f'({body(replace(self, names={**self.names, variable: found}))})'


Node = Callable[[Text], str]


@dataclass
class RandomFormula:
    """A formula with all binders of the language, whose variables have names of regions."""

    random: Random
    names: dict[int, str] = field(default_factory=dict)
    kept: dict[int, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = self.random.sample(OBJECTS, len(OBJECTS))
        objects, kept = self.random.choice(((0, 3), (1, 3), (1, 2), (0, 2), (2, 3)))
        # A name stands for one thing in all of the formula.
        self._objects, self._of_variables = names[:objects], [*names[objects:kept], 'Room', 'Hall']
        self._of_kept = [*names[kept:], 'k0', 'k1', 'k2', 'k3']
        self.node = self._make(3, {}, ())

    def text(self) -> str:
        return self.node(Text(self.names, self.kept))

    def text_with_new_names(self) -> str:
        names = {each: f'variable{each}' for each in self.names}
        return self.node(Text(names, {each: f'kept{each}' for each in self.kept}))

    def text_in(self, scenario: Scenario) -> str:
        """Return its text in a scenario, with quantifiers written out."""
        kept = {each: f'kept{each}' for each in self.kept}
        return self.node(Text({}, kept, scenario))

    def _variable(self, bound: Mapping[int, str]) -> int:
        used = {self.names[each] for each in bound}
        new = [each for each in self._of_variables if each not in used]
        number = len(self.names)
        self.names[number] = self.random.choice(new) if new else f'v{number}'
        return number

    def _make(self, depth: int, bound: Mapping[int, str], around: tuple[str, ...]) -> Node:
        kinds = ['relation'] * 2 if self._objects or bound else []
        kinds += ['value'] * bool(bound) or ['p']
        if depth:
            kinds = ['not', 'join', 'join', 'time', 'quantifier', 'quantifier', 'count', 'sum']
            kinds += [] if around else ['let', 'over', 'over']
        make = getattr(self, f'_{self.random.choice(kinds)}')
        node: Node = make(depth - 1, bound, around)
        return node

    def _relation(self, _: int, bound: Mapping[int, str], __: object) -> Node:
        name, found = self.random.choice(RELATIONS), [*self._objects, *[*bound] * 3]
        first, second = self.random.choice(found), self.random.choice(found)

        def node(text: Text) -> str:
            names = text.name(first), text.name(second)
            if text.scenario is None:
                return f'{name}({names[0]}, {names[1]})'
            return 'true' if text.scenario[names] & RELATION_NAMES[name] else 'false'

        return node

    def _value(self, _: int, bound: Mapping[int, str], __: object) -> Node:
        variable, other = self.random.choice([*bound]), self.random.choice([*bound])
        comparison = self.random.choice(('q[{}] > 0', 'q[{}] > q[{}]', 'always q[{}] < 2'))
        return lambda text: comparison.format(text.name(variable), text.name(other))

    def _p(self, *_: object) -> Node:
        found = self.random.choice(('p > 0', 'p > 1', 'always p > 0', 'eventually p > 1'))
        return lambda _: found

    def _not(self, *inside: object) -> Node:
        body = self._make(*inside)  # type: ignore[arg-type]
        return lambda text: f'not ({body(text)})'

    def _time(self, *inside: object) -> Node:
        body = self._make(*inside)  # type: ignore[arg-type]
        word = self.random.choice(('always', 'eventually[0 s, 1 s]', 'always(0 s, 1 s]'))
        return lambda text: f'{word} ({body(text)})'

    def _join(self, *inside: object) -> Node:
        left, right = self._make(*inside), self._make(*inside)  # type: ignore[arg-type]
        word = self.random.choice(('and', 'or', '->'))
        return lambda text: f'({left(text)}) {word} ({right(text)})'

    def _quantifier(self, depth: int, bound: Mapping[int, str], around: tuple[str, ...]) -> Node:
        variable, sort = self._variable(bound), self.random.choice(SORTS)
        body = self._make(depth, {**bound, variable: sort}, around)
        word = self.random.choice(('forall', 'exists', 'at least 2', 'at most 1', 'exactly 1'))

        def node(text: Text) -> str:
            if text.scenario is None:
                return f'{word} {text.name(variable)} in {sort}: ({body(text)})'
            texts = text.each(variable, sort, body)
            if word in {'forall', 'exists'}:
                return (' and ' if word == 'forall' else ' or ').join(texts)
            return f'{word} of ({", ".join(texts)})'

        return node

    def _count(self, _: int, bound: Mapping[int, str], __: object) -> Node:
        variable = self._variable(bound)
        other = self.random.choice([*bound, *self._objects, variable])
        return self._aggregate(
            variable,
            lambda text: f'q[{text.name(variable)}] >= q[{text.name(other)}]',
            'count({}) > 1'.format,
            lambda each: f'at least 2 of ({", ".join(each)})',
        )

    def _sum(self, _: int, bound: Mapping[int, str], __: object) -> Node:
        variable = self._variable(bound)
        return self._aggregate(
            variable,
            lambda text: f'q[{text.name(variable)}]',
            'sum({}) > 2'.format,
            lambda each: f'{" + ".join(each)} > 2',
        )

    def _aggregate(
        self,
        variable: int,
        body: Node,
        asked: Callable[[str], str],
        written_out: Callable[[Sequence[str]], str],
    ) -> Node:
        """Return an aggregate over the objects of a sort."""
        sort = self.random.choice(SORTS)

        def node(text: Text) -> str:
            if text.scenario is None:
                return asked(f'{body(text)} for {text.name(variable)} in {sort}')
            return written_out(text.each(variable, sort, body))

        return node

    def _let(self, depth: int, bound: Mapping[int, str], around: tuple[str, ...]) -> Node:
        number = len(self.kept)
        self.kept[number] = self.random.choice(self._of_kept)
        body = self._make(depth, bound, (*around, 'let'))

        def node(text: Text) -> str:
            name = text.kept[number]
            later = f'eventually[0 s, 2 s] p > {name}'
            return f'let {name} = p in (({later}) or ({body(text)}))'

        return node

    def _over(self, depth: int, bound: Mapping[int, str], around: tuple[str, ...]) -> Node:
        rooms = [each for each, sort in bound.items() if sort == 'Room']
        if not [*rooms, *self._objects]:
            return self._p()
        origin = self.random.choice([*rooms, *self._objects])
        first = self._variable(bound)
        second = self._variable({**bound, first: 'Room'})
        place = self._variable({**bound, first: 'Room', second: 'Room'})
        ends = {first: 'Room', second: 'Room'}
        link = self._relation(0, {**bound, **ends}, ())
        body = self._make(depth, {**bound, place: 'Room'}, (*around, 'over'))
        word = self.random.choice(('somewhere', 'everywhere'))

        def is_link(text: Text, pair: Pair) -> bool:
            names = dict(zip((first, second), pair, strict=True))
            return link(replace(text, names={**text.names, **names})) == 'true'

        def node(text: Text) -> str:
            if text.scenario is None:
                of = f'{text.name(first)}, {text.name(second)} in Room'
                over = f'over ({link(text)} for {of}) from {text.name(origin)}'
                return f'{over} to {text.name(place)}: ({word}[0, 2 hops] ({body(text)}))'
            reached = {text.name(origin)}
            for _ in range(2):
                reached |= {
                    b for a, b in permutations(OBJECTS, 2) if a in reached and is_link(text, (a, b))
                }
            texts = [text.of(place, each, body) for each in sorted(reached)]
            return (' or ' if word == 'somewhere' else ' and ').join(texts)

        return node


def rewritten(
    formula: str, told: Sequence[str], objects: Mapping[str, Sequence[str]] = DOMAINS
) -> str:
    """Return the text of a formula with what is known of its relations."""

    async def domains(sorts: Sequence[str]) -> Mapping[str, Sequence[str]]:
        return {sort: objects[sort] for sort in sorts}

    async def query(sparql: str) -> Sequence[tuple[str, ...]]:
        return [('a', each) for each in told] if 'relations' in sparql else []

    group = FormulaGroup()
    canonical = str(group.formulas[group.add_formula('', formula)])
    return asyncio.run(completed(canonical, tuple(group.symbols()), domains, query))


def verdict(formula: str, trace: Sequence[Mapping[str, int]]) -> Verdict:
    async def query(_: str) -> Sequence[tuple[str, ...]]:
        return []

    group = FormulaGroup()
    group.add_formula('', formula)
    symbols: Sequence[Symbol] = group.symbols()
    group.begin(DOMAINS, UnknownFeatures(asyncio.run(unknown_features(symbols, query))))
    results = group.decided_at_once()
    for time, values in enumerate(trace):
        if not results:
            results = group.progress(time * 10**9, values)
    return results[0].verdict if results else Verdict.UNDECIDED


def random_world(random: Random, *, is_known: bool) -> tuple[list[str], Scenario]:
    """Return what is told of the regions, and a scenario that agrees with it."""
    relations = [str(each) for each in RegionRelation]
    while True:
        found = {pair: random.choice(relations) for pair in combinations(OBJECTS, 2)}
        told = [f'{x} {relation} {y}' for (x, y), relation in found.items()]
        try:
            knowledge = SpatialKnowledge(told)
        except SpaceError:
            continue
        scenario = {pair: knowledge.possible(*pair) for pair in permutations(OBJECTS, 2)}
        scenario |= {(each, each): RegionRelation.EQ for each in OBJECTS}
        if not is_known:
            told[0] = f'a {{{found["a", "b"]}, {random.choice(relations)}}} b'
        return told, scenario


@pytest.mark.timeout(14400)
@pytest.mark.parametrize('is_known', [True, False])
def test_names_of_variables_change_no_verdict(*, is_known: bool) -> None:
    decided = 0
    for case in range(CASES):
        random = Random(case)  # noqa: S311 - no secrets
        told, scenario = random_world(random, is_known=is_known)
        formula = RandomFormula(random)
        features = ['p', *(f'q[{each}]' for each in OBJECTS)]
        trace = [{each: random.randint(0, 2) for each in features} for _ in range(4)]
        text = rewritten(formula.text(), told)
        found = verdict(text, trace)
        renamed = rewritten(formula.text_with_new_names(), told)
        case_text = f'{case}: {told}, {formula.text()}, {text}, {renamed}, {trace}'
        assert found is verdict(renamed, trace), case_text
        if is_known:
            expected = verdict(formula.text_in(scenario), trace)
            # Simplification does not look along links.
            is_late = found is Verdict.UNDECIDED and 'over (' in text
            assert found is expected or is_late, f'{case_text}, {formula.text_in(scenario)}'
        decided += found is not Verdict.UNDECIDED
    assert decided > CASES / 4


def renamed(node: Any) -> Any:
    """Return a formula in which each variable and each kept value has another name."""
    node = with_changed_parts(node, renamed)
    if isinstance(node, Variable | Kept | Freeze):
        return replace(node, name=f'{node.name}_new')
    if isinstance(node, Quantifier):
        return replace(node, variable=f'{node.variable}_new')
    return node


def test_scopes_of_names() -> None:
    for case in range(CASES * 5):
        formula = parse_formula(RandomFormula(Random(case)).text())  # noqa: S311 - no secrets
        scopes, nodes = Scopes(str(formula)), list(walk(formula))
        sorts = [(each.variable, each.sort) for each in nodes if isinstance(each, Quantifier)]
        found = [(each.name, each.sort) for each in scopes.binders if each.sort is not None]
        assert sorted(found) == sorted(sorts)
        kept = {each.name for each in nodes if isinstance(each, Freeze)}
        assert {each.name for each in scopes.binders if each.sort is None} == kept
        text = scopes.renamed({name: f'{name}_new' for name in scopes.names})
        assert text == str(renamed(formula))


TOLD = ['a NTPP b', 'c DC a', 'c DC b']


@pytest.mark.parametrize(
    ('formula', 'expected'),
    [
        # Nothing has the name of a region that the new text mentions.
        ('forall x in Room: DC[x, b]', 'forall x in Room: (((x = c)))'),
        ('forall a in Room: DC[a, b]', 'forall a in Room: (((a = c)))'),
        (
            '(exists x in Robot: q[x] > 1) and (exists x in Hall: (DC[x, b]))',
            '(exists x in Robot: (q[x] > 1)) and (exists x in Hall: (((x = c))))',
        ),
        # Variables, kept values and times with such a name.
        ('forall c in Room: DC[c, b]', 'forall c_2 in Room: (((c_2 = c)))'),
        (
            'forall c in Room: (DC[c, b] or (always[0 s, 1 s] q[c] > 1))',
            'forall c_2 in Room: ((((c_2 = c))) or (always[0 s, 1 s] (q[c_2] > 1)))',
        ),
        (
            'forall x in Room: let c = q[x] in (DC[x, b] or (eventually q[x] > c))',
            'forall x in Room: (let c_2 = q[x] in ((((x = c))) or (eventually (q[x] > c_2))))',
        ),
        (
            'over (DC[x, c] for x, c in Room) from a to y: (somewhere[0, 1 hops] (q[y] > 1))',
            (
                'over ((((x = a) and (c_2 = c)) or ((x = b) and (c_2 = c)) or ((x = c) and '
                '(c_2 = a)) or ((x = c) and (c_2 = b))) for x, c_2 in Room) from a to y: '
                '(somewhere[0, 1 hops] (q[y] > 1))'
            ),
        ),
    ],
)
def test_new_texts(formula: str, expected: str) -> None:
    assert rewritten(formula, TOLD) == expected


def test_a_variable_with_the_name_of_a_unit_of_time_and_of_a_stream() -> None:
    told, objects = ['m NTPP s', 's DC m2', 'm DC m2'], {'S': ('m', 's', 'm2'), 'M': ('s', 'm2')}
    formula = 'forall m in M: at least 2 s in S: (DC[s, m] or (once[1 s, 2 s] q[s] > s.m))'
    assert rewritten(formula, told, objects) == (
        'forall m_2 in M: (at least 2 s_2 in S: ((((s_2 = m) and (m_2 = m2)) or ((s_2 = s) and '
        '(m_2 = m2)) or ((s_2 = m2) and (m_2 = s))) or (once[1 s, 2 s] (q[s_2] > s.m))))'
    )


@pytest.mark.parametrize(
    ('formula', 'kind'),
    [
        ('forall x in Room: (DC[x, b] or c = m)', 'feature'),
        ('forall x in Room: (DC[x, b] or c[x] > 1)', 'feature'),
        ('forall x in Room: (DC[x, b] or (exists y in c: (q[y] > 1)))', 'sort'),
    ],
)
def test_a_region_with_the_name_of_something_else(formula: str, kind: str) -> None:
    with pytest.raises(CoordinationError, match=f"'c' is a region and a {kind} of the formula"):
        rewritten(formula, TOLD, {**DOMAINS, 'c': ['a']})


def test_a_variable_that_is_also_a_word() -> None:
    told = ['a NTPP b', 'by DC a', 'by DC b']
    with pytest.raises(CoordinationError, match="'by' is a variable and a region; rename"):
        rewritten('forall by in Room: DC[by, b]', told, {'Room': ['a', 'b', 'by']})
