"""Units of margins: the unit of the features in the comparison that limits a margin.

The reasoning engine does not know the ontology, so a margin has its unit from here. Sums have the
unit of their features; products and quotients have none that is known.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Final

from dyknow_common import Margin, Symbol
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.declared_properties import QueryFunction, Rows
from dyknow_coordinator.grounding.symbols import feature_symbols
from dyknow_coordinator.grounding.units import only_unit, stated_units

# A syntactic reference to a quoted stream, the arguments of a feature, or a name.
_TOKEN: Final = re.compile(
    r'"(?:\\.|[^"\\])*"\S*|\[[^\]]*\]|(?P<name>[A-Za-z_][\w.]*\'*)(?P<call>\()?'
)

_SAME_UNIT: Final = {'abs', 'hypot', 'max', 'min', 'mod', 'sum'}
"""The functions whose value has the unit of their arguments."""


async def feature_units(symbols: Iterable[Symbol], query: QueryFunction) -> dict[str, str]:
    """Return the unit of each feature; empty for one without a unit, or with an unknown one.

    Args:
        symbols: of the formula.
        query: returns the solutions of a SPARQL query of the ontology.

    Raises:
        DyKnowError: if the query fails.
    """
    features = feature_symbols(symbols)
    rows = await stated_units(features, query)
    units = {name: _known_unit(name, found) for name, found in rows.items()}
    return {**{each.name: '' for each in features if each.is_reference}, **units}


def _known_unit(feature: str, rows: Rows) -> str:
    try:
        return only_unit(feature, rows)
    except CoordinationError:
        return ''


def with_unit(margin: Margin, units: Mapping[str, str]) -> Margin:
    """Return a margin in the unit of its comparison.

    Args:
        margin: without its unit.
        units: the unit of each feature.
    """
    return replace(margin, unit=_unit_of(margin.atom, units))


def _unit_of(atom: str, units: Mapping[str, str]) -> str:
    if ' * ' in atom or ' / ' in atom:
        return ''
    found = set()
    for token in _TOKEN.finditer(atom):
        name = token['name']
        if token['call']:
            found |= set() if name in _SAME_UNIT else {''}
        elif name in units:
            found.add(units[name])
        elif token[0].startswith('"'):
            found.add('')
    return found.pop() if len(found) == 1 else ''
