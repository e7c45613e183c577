"""Limits of formula groups: counted before the work is done."""

from __future__ import annotations

import tracemalloc

import pytest
from reasoning_reference import begun

from dyknow_reasoning import FormulaGroup, FormulaLimits, ReasoningError, parse_formula
from dyknow_reasoning.progression.sizes import formula_size

LIMITS = FormulaLimits(
    object_limit=1000,
    instance_limit=100,
    instance_part_limit=50,
    part_limit=300,
)


def group_of(*formulas: str) -> FormulaGroup:
    group = FormulaGroup(LIMITS)
    for formula in formulas:
        group.add_formula(formula, formula)
    return group


def objects(count: int) -> dict[str, list[str]]:
    return {'S': [f's{number}' for number in range(count)]}


@pytest.mark.parametrize(
    ('formula', 'instances', 'parts'),
    [
        ('p', 1, 1),
        ('1 + 2 < p', 1, 2),
        ('forall x in S: P[x]', 3, 1),
        ('forall x in S: always forall y in S: P[x] and Q[y]', 9, 4),
        ('always exists x in S: P[x] or Q[x]', 1, 11),
        ('forall x in S: exists y in S: exists z in S: D[x, y] < z', 3, 13),
        ('forall x in T: P[x]', 1, 1),
    ],
)
def test_the_size_of_a_formula(formula: str, instances: int, parts: int) -> None:
    size = formula_size(parse_formula(formula), {'S': 3})
    assert (size.instances, size.instance_parts) == (instances, parts)
    assert size.parts == instances * (1 + parts)


@pytest.mark.parametrize(
    ('formula', 'count', 'message'),
    [
        ('forall x in S: P[x]', 101, "101 instances .*, more than 100 .*'instance_limit'"),
        ('forall x in S: forall y in S: forall z in S: P[x]', 999, 'has 997002999 instances'),
        ('exists x in S: P[x]', 60, "61 parts for each choice .*more than 50 .*'instance_part_lim"),
        ('forall x in S: P[x] and (Q[x] or R[x])', 80, "480 parts .*more than 300 .*'part_limit'"),
        ('forall x in S: P[x]', 1000, "1001 sorts and objects, more than 1000 .*'object_limit'"),
        (
            ' '.join(f'exists x{n} in S:' for n in range(40)) + ' P[x0]',
            999,
            'has about 1e119 parts',
        ),
    ],
)
def test_a_formula_that_is_too_large(formula: str, count: int, message: str) -> None:
    group = group_of(formula)
    tracemalloc.start()
    with pytest.raises(ReasoningError, match=message):
        group.begin(objects(count))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1_000_000
    group.begin(objects(1))
    assert group.symbols()


def test_the_size_of_a_group() -> None:
    formula = 'forall x in S: P[x] and Q[x]'
    group = group_of(formula)
    assert group.parts == 4
    group.begin(objects(60))
    assert group.parts == 240
    with pytest.raises(ReasoningError, match=r"formulas of the group have 480 .*'part_limit'"):
        group.add_formula('other', formula)
    group.remove_formula(1)
    assert group.parts == 0
    group.add_formula('other', formula)


def test_two_formulas_that_are_too_large_together() -> None:
    group = group_of(*['forall x in S: P[x] and Q[x]'] * 2)
    with pytest.raises(ReasoningError, match='formulas of the group have 480 parts'):
        group.begin(objects(60))
    group.begin(objects(30))


def test_many_atoms_of_one_instance() -> None:
    """Python cannot compile an expression of so many parts."""
    group, _ = begun('always exists x in S: P[x] < 3', objects(5000))
    values = {f'P[s{number}]': 5 for number in range(5000)}
    for time in range(10):
        assert group.progress(time, {**values, 'P[s77]': 1}) == []
    (result,) = group.progress(10, values)
    assert not result.verdict - 2


def test_the_text_of_many_instances_that_remain() -> None:
    group, _ = begun('forall x in S: always P[x] < 3', objects(3000))
    group.progress(0, {f'P[s{number}]': 1 for number in range(3000)})
    text = group.residual(1)
    assert text.startswith('(') and len(text) < 50_000  # noqa: PT018
    assert text.endswith('more)')
