"""RCC-8: the composition table against geometry, and knowledge against all scenarios."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from itertools import combinations, permutations, product
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from dyknow_space import (
    ANY,
    RELATION_NAMES,
    Region,
    RegionRelation,
    SpaceError,
    SpatialKnowledge,
    SpatialStatement,
    compose,
    converse,
    relation_of,
)
from dyknow_space.regions.library import shapely

pytestmark = pytest.mark.skipif(find_spec('shapely') is None, reason='shapely is not installed')

CASES = int(os.environ.get('DYKNOW_RANDOM_CASES', '0'))


def polygon(random: Random, near: Any = None) -> Any:
    """One or two rectangles of a small grid, whose sides are often those of another polygon."""
    if near is None:
        x, y = random.randrange(5), random.randrange(5)
        bounds = [x, y, x + random.randint(1, 7), y + random.randint(1, 7)]
    elif random.random() < 0.3:
        by = random.choice((-2, -1, 1, 2))
        bounds = [each + by * sign for each, sign in zip(near.bounds, (-1, -1, 1, 1), strict=True)]
    else:
        bounds = [each + random.choice((-1, 0, 0, 0, 1)) for each in near.bounds]
    if bounds[0] >= bounds[2] or bounds[1] >= bounds[3]:
        return polygon(random)
    found = shapely().box(*bounds)
    return found if random.random() < 0.7 else shapely().union(found, polygon(random))


def triple(random: Random) -> list[Region]:
    """Three polygons in any order, some like another one."""
    found = [polygon(random)]
    for _ in range(2):
        found.append(polygon(random, random.choice((None, *found, *found))))
    return [Region('r', (), 'map', each) for each in random.sample(found, 3)]


def test_compositions_of_drawn_regions() -> None:
    random = Random(7)  # noqa: S311 - no secrets
    seen: dict[tuple[RegionRelation, RegionRelation], RegionRelation] = {}
    for _ in range(CASES or 400):
        a, b, c = triple(random)
        first, second, third = relation_of(a, b), relation_of(b, c), relation_of(a, c)
        assert relation_of(b, a) is converse(first)
        assert third & compose(first, second), (a, b, c)
        seen[first, second] = seen.get((first, second), RegionRelation(0)) | third
    if CASES >= 100_000:
        assert all(seen[pair] == compose(*pair) for pair in seen)


def test_regions_cut_at_180_degrees_are_related_as_elsewhere() -> None:
    random = Random(5)  # noqa: S311 - no secrets
    for _ in range(CASES or 150):
        shift = random.randint(-3, 12)

        def turned(each: Any, shift: int = shift) -> Region:
            moved = shapely().transform(
                each, lambda points: points / 8 + np.array([180 - shift / 8, 0])
            )
            halves = []
            for turn in (0, 360):
                window = shapely().box(-180, -90, 180, 90)
                back = shapely().transform(
                    moved, lambda points, turn=turn: points - np.array([turn, 0])
                )
                found = shapely().intersection(back, window)
                halves += [part for part in shapely().get_parts(found) if part.area > 0]
            return Region('r', (), 'wgs84', shapely().multipolygons(halves))

        first, second, _ = triple(random)
        cut = relation_of(turned(first.geometry), turned(second.geometry))
        assert cut is relation_of(first, second)


def test_laws_of_the_table() -> None:
    for first in RegionRelation:
        assert compose(first, RegionRelation.EQ) == compose(RegionRelation.EQ, first) == first
        assert RegionRelation.EQ & compose(first, converse(first))
        for second in RegionRelation:
            turned = compose(converse(second), converse(first))
            assert converse(compose(first, second)) == turned


def scenarios(
    regions: str, told: Mapping[tuple[str, str], RegionRelation]
) -> Iterator[dict[tuple[str, str], RegionRelation]]:
    """All choices of a relation for each two regions in which each three agree with the table."""
    pairs = list(combinations(regions, 2))

    def chosen(
        found: dict[tuple[str, str], RegionRelation],
    ) -> Iterator[dict[tuple[str, str], RegionRelation]]:
        rest = [pair for pair in pairs if pair not in found]
        if not rest:
            yield dict(found)
            return
        a, b = rest[0]
        for each in RegionRelation:
            if each & told.get((a, b), ANY):
                longer = {**found, (a, b): each, (b, a): converse(each)}
                triples = permutations(regions, 3)
                if all(
                    longer[x, z] & compose(longer[x, y], longer[y, z])
                    for x, y, z in triples
                    if {(x, y), (y, z), (x, z)} <= longer.keys()
                ):
                    yield from chosen(longer)

    yield from chosen({})


def test_knowledge_is_what_all_scenarios_agree_on() -> None:
    for case in range(CASES or 60):
        random = Random(case)  # noqa: S311 - no secrets
        regions = 'abcdef'[: random.choice((2, 3, 4) if not CASES else (2, 3, 4, 5, 6))]
        pairs = list(combinations(regions, 2))
        # Few relations of each: six regions of which nothing is told have too many scenarios.
        told = {
            pair: RegionRelation(random.choice((1, 8, 18, 24, 32, 36, 68, 130, 15)))
            for pair in pairs
        }
        statements = [SpatialStatement(a, each, b) for (a, b), each in told.items()]
        found = list(scenarios(regions, told))
        if not found:
            with pytest.raises(SpaceError, match='contradict each other: ') as raised:
                SpatialKnowledge(statements)
            named = [each for each in statements if str(each) in str(raised.value)]
            for left_out in named:
                SpatialKnowledge([each for each in named if each is not left_out])
            continue
        knowledge = SpatialKnowledge(statements)
        for a, b in pairs:
            possible = RegionRelation(0)
            for each in found:
                possible |= each[a, b]
            assert knowledge.possible(a, b) == possible
        asked = [
            SpatialStatement(*pair[:1], RegionRelation(random.randint(1, 254)), *pair[1:])
            for pair in random.choices([*pairs, *((b, a) for a, b in pairs)], k=3)
        ]
        cases = list(knowledge.cases(asked))
        assert len(cases) == len(set(cases))
        assert set(cases) == {
            tuple(bool(each[one.first, one.second] & one.relation) for one in asked)
            for each in found
        }


def region(name: str, bounds: tuple[float, ...], **details: Any) -> Region:
    return Region(name, (), details.pop('frame', 'map'), shapely().box(*bounds), **details)


def test_told_and_drawn_regions() -> None:
    drawn = [region('flat', (0, 0, 9, 9)), region('office', (20, 0, 29, 9))]
    knowledge = SpatialKnowledge(['kitchen part_of flat', 'hall {EC, DC} flat'], drawn)
    assert knowledge.possible('kitchen', 'office') is RegionRelation.DC
    assert str(knowledge.possible('hall', 'flat')) == '{DC, EC}'
    apart = SpatialStatement('kitchen', RegionRelation.DC, 'hall')
    overlap = SpatialStatement('hall', RELATION_NAMES['overlaps'], 'kitchen')
    assert set(knowledge.cases([apart, overlap])) == {(True, False), (False, False)}
    with pytest.raises(SpaceError, match=r'a EC flat; a NTPP office; flat DC office \(drawn\)$'):
        SpatialKnowledge(['a EC flat', 'a DC x', 'a NTPP office'], drawn)


def test_what_is_not_comparable_is_not_known() -> None:
    here, there = region('here', (0, 0, 9, 9)), region('there', (1, 1, 2, 2), frame='odom')
    later = region('later', (1, 1, 2, 2), times=(5, None))
    assert relation_of(here, there) is relation_of(here, later) is None
    assert SpatialKnowledge(['there NTPP later'], [here, there, later]).regions == [
        'later',
        'there',
    ]


def points(box: tuple[int, ...], margin: float) -> set[tuple[float, ...]]:
    """The points of a lattice in a box with a margin; the lattice shows how boxes meet."""
    low, high = box[:3], box[3:]
    axes = ([x / 2 for x in range(-1, 12)] for _ in low)
    return {
        each
        for each in product(*axes)
        if all(a + margin <= x <= b - margin for a, x, b in zip(low, each, high, strict=True))
    }


def naive_relation(first: tuple[int, ...], second: tuple[int, ...]) -> RegionRelation:
    """The relation of two boxes, by its definition."""
    (a, b), (inner_a, inner_b) = (
        [points(each, margin) for each in (first, second)] for margin in (0, 0.5)
    )
    if not a & b:
        return RegionRelation.DC
    if not inner_a & inner_b:
        return RegionRelation.EC
    if a == b:
        return RegionRelation.EQ
    if a <= b:
        return RegionRelation.NTPP if a <= inner_b else RegionRelation.TPP
    if b <= a:
        return RegionRelation.NTPPI if b <= inner_a else RegionRelation.TPPI
    return RegionRelation.PO


def test_prisms_are_related_as_their_points_are() -> None:
    random = Random(3)  # noqa: S311 - no secrets
    for _ in range(CASES or 60):
        boxes = []
        for _ in range(2):
            low = [random.randint(0, 3) for _ in range(3)]
            boxes.append((*low, *(each + random.randint(1, 2) for each in low)))
        first, second = (
            region('r', (x, y, x2, y2), altitude=(z, z2)) for x, y, z, x2, y2, z2 in boxes
        )
        assert relation_of(first, second) is naive_relation(*boxes), boxes


@pytest.mark.parametrize(
    ('statements', 'message'),
    [
        (['a'], "'a' is no statement about regions"),
        (['a within b'], r"there is no relation 'within' .there are: DC, EC"),
        (['a NTPP b', 'c DC d', 'b NTPP a'], r'contradict each other: a NTPP b; b NTPP a$'),
        ([f'r{n} DC r{n + 1}' for n in range(120)], 'about 121 regions, more than 100'),
    ],
)
def test_wrong_statements(statements: list[str], message: str) -> None:
    with pytest.raises(SpaceError, match=message):
        SpatialKnowledge(statements)


def test_unknown_regions() -> None:
    with pytest.raises(SpaceError, match=r"nothing is told of the region 'x' .there are: a, b"):
        SpatialKnowledge(['a DC b']).possible('a', 'x')


def test_the_example_of_the_manual() -> None:
    page = Path(__file__).parents[2] / 'docs' / 'space_relations.md'
    (text,) = re.findall(r'```python\n(.*?)```', page.read_text(encoding='utf-8'), re.DOTALL)
    exec(compile(text, str(page), 'exec'), {})  # noqa: S102 - our own page
