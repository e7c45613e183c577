"""The ontology says which features may be unknown, and between which bounds."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import pytest

from dyknow_common import DyKnowError, Symbol, SymbolKind
from dyknow_coordinator import unknown_features

INF = float('inf')
SYMBOLS = [Symbol(SymbolKind.FEATURE, name, ('r1',)) for name in ('Charge', 'Speed')]


def found(*rows: Sequence[str]) -> dict[str, tuple[float, float]]:
    async def query(_: str) -> Sequence[tuple[str, ...]]:
        return [tuple(row) for row in rows]

    return asyncio.run(unknown_features(SYMBOLS, query))


def test_bounds_are_stated_or_inherited() -> None:
    assert found() == {}
    assert found(('a:Charge', 'a:Charge', '0.0 1.0'), ('a:Other', 'a:Other', '0 1')) == {
        'Charge': (0.0, 1.0)
    }
    assert found(('a:Speed', 'a:Fast', '0 5'), ('a:Speed', 'a:Slow', '-inf 1')) == {
        'Speed': (-INF, 5.0)
    }
    assert found(('a:Speed', 'a:Speed', '0 2'), ('a:Speed', 'a:Fast', '0 5')) == {
        'Speed': (0.0, 2.0)
    }


@pytest.mark.parametrize('bounds', ['1 0', '1', 'nan 1', 'all'])
def test_bounds_that_are_none(bounds: str) -> None:
    with pytest.raises(DyKnowError, match=r"bounds of 'Charge' in the ontology are .*0\.0 1\.0"):
        found(('a:Charge', 'a:Charge', bounds))
