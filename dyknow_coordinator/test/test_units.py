"""Units of features, for formulas that have numbers with units."""

from __future__ import annotations

import pytest

from dyknow_coordinator import CoordinationError, has_units, with_units
from dyknow_coordinator.grounding.units import only_unit


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
