"""Units of margins."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import pytest

from dyknow_common import Margin, Symbol, SymbolKind
from dyknow_coordinator.grounding.units import feature_units, with_unit

UNITS = {'Power': 'W', 'Limit': 'W', 'Altitude': 'm', 'Mode': '', 'wind.speed': ''}


@pytest.mark.parametrize(
    ('atom', 'unit'),
    [
        ('Power[uav1] > 150', 'W'),
        ('(Power[uav1] - Limit[Altitude]) > 3', 'W'),
        ('Power[uav1] > (2 * Limit[uav1])', ''),
        ('Power[uav1] > Altitude[uav1]', ''),
        ('Power[uav1] > wind.speed', ''),
        ('Power[uav1] > "/uav1/Power".Power', ''),
        ('abs(Power[uav1] - Limit[uav1]) < 3', 'W'),
        ('sqrt(Power[uav1]) < 3', ''),
        ('Power[uav1] < 150 W', 'W'),
        ('1 < 2', ''),
        ('', ''),
    ],
)
def test_unit_of_the_limiting_comparison(atom: str, unit: str) -> None:
    assert with_unit(Margin(1.0, 1.0, '', atom), UNITS) == Margin(1.0, 1.0, unit, atom)


def test_units_of_features() -> None:
    rows = {
        'Power': [('Power', 'W')],
        'GpsAltitude': [('Altitude', 'm'), ('GpsAltitude', 'ft')],
        'LaserAltitude': [('Altitude', 'm')],
        'Mixed': [('Altitude', 'm'), ('Power', 'W')],
        'Mode': [],
    }

    async def query(sparql: str) -> Sequence[tuple[str, ...]]:
        return next(found for name, found in rows.items() if f'"#{name}"' in sparql)

    symbols = [Symbol(SymbolKind.FEATURE, name) for name in rows]
    symbols += [Symbol(SymbolKind.FEATURE, 'a.b'), Symbol(SymbolKind.SORT, 'UAV')]
    assert asyncio.run(feature_units(symbols, query)) == {
        'Power': 'W',
        'GpsAltitude': 'ft',
        'LaserAltitude': 'm',
        'Mixed': '',
        'Mode': '',
        'a.b': '',
    }
