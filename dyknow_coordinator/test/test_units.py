"""Units of features, for formulas that have numbers with units."""

from __future__ import annotations

import pytest

from dyknow_common import Symbol, SymbolKind
from dyknow_coordinator import CoordinationError
from dyknow_coordinator.grounding.units import find_uncertainties, has_units, only_unit, with_units


@pytest.mark.parametrize(
    ('formula', 'expected'),
    [
        ('Power[u] > 150 "W"', True),
        ('(Mode = "a") and (x < (2.5e-07 "m/s" + 1))', True),
        ('Mode = "1 \\" 2"', False),
        ('(Mode = "1") and ("/t1".x > 2)', False),
        ('(Mode = "a\\\\") or (x < 1 "m")', True),
        ('(x = 1) and (Mode = "on")', False),
    ],
)
def test_canonical_texts_with_units(formula: str, *, expected: bool) -> None:
    assert has_units(formula) is expected


def test_a_feature_inherits_a_unit_that_it_does_not_state() -> None:
    assert only_unit('Power', [('uav:Power', 'W'), ('Measure', 'kW')]) == 'W'
    assert only_unit('Power', [('Measure', 'kW'), ('Other', 'kW')]) == 'kW'
    assert only_unit('Power', []) == ''
    with pytest.raises(
        CoordinationError, match=r"the unit of 'Power' is ambiguous.*: W, kW; write"
    ):
        only_unit('Power', [('Measure', 'kW'), ('Other', 'W')])


def test_units_are_stated_before_the_formula() -> None:
    found = with_units('P[u] > 1 "kW"', {'P': 'W', 'Ratio': ''})
    assert found == 'let P: "W", Ratio: "" in (P[u] > 1 "kW")'
    assert with_units('1 "m" > 2 "ft"', {}) == '1 "m" > 2 "ft"'


def test_uncertainties_are_stated_before_the_formula() -> None:
    uncertainties = {'Height': 'normal(Height, 0.5, 2 s)'}
    found = with_units('P(Height > 1 "km") > 0.9', {'Height': 'm'}, uncertainties)
    stated = 'Height: "m", Height ~ normal(Height, 0.5, 2 s)'
    assert found == f'let {stated} in (P(Height > 1 "km") > 0.9)'


def test_only_probabilities_need_uncertainties() -> None:
    asked: list[str] = []

    async def query(sparql: str) -> list[tuple[str, ...]]:
        asked.append(sparql)
        # A feature below another one has its own errors.
        return [('r:Height', 'normal(Height, 1)'), ('r:Position', 'normal(Position, 2)')]

    def uncertainties(formula: str) -> dict[str, str]:
        found = find_uncertainties(formula, [Symbol(SymbolKind.FEATURE, 'Height')], query)
        with pytest.raises(StopIteration) as end:
            found.send(None)
        value: dict[str, str] = end.value.value
        return value

    assert uncertainties('always Height > 1') == {}
    assert not asked
    assert uncertainties('always (P(Height > 1) > 0.9)') == {'Height': 'normal(Height, 1)'}
    assert '#uncertainty>' in asked[0]
