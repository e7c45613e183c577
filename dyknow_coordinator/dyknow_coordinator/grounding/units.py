"""Units and uncertainties of features, for formulas that need them, and of margins.

In the canonical text of a formula, the unit of a number is in double quotes: `Power[u] > 1 "kW"`.
If the ontology says that `Power` is in W, the formula is `let Power: "W" in (Power[u] > 1 "kW")`,
from which the reasoning engine makes `Power[u] > 1000.0`.

If the ontology says how uncertain `Height` is, the formula `P(always Height[u] > 3) > 0.9` is
`let Height ~ normal(Height, sqrt(Height_variance)) in (P(always Height[u] > 3) > 0.9)`.

The reasoning engine does not know the ontology, so a margin gets here the unit of the features in
the comparison that limits it. Sums have the unit of their features; products and quotients have
none that is known.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from typing import Final

from dyknow_common import ExitCode, Margin, StandingVerdicts, Symbol, quoted
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.candidate_search import feature_symbols
from dyknow_coordinator.grounding.declared_properties import (
    FEATURE_QUERY,
    QueryFunction,
    Rows,
    own_or_inherited,
    property_query,
)

# The unit of a number, or another text in quotes.
_QUOTED: Final = re.compile(r'(?P<unit>(?<=[0-9]) )?"(?:\\.|[^"\\])*"')


_PROBABILITY: Final = re.compile(r'\bP\(')

# A syntactic reference to a quoted stream, the arguments of a feature, or a name.
_TOKEN: Final = re.compile(
    r'"(?:\\.|[^"\\])*"\S*|\[[^\]]*\]|(?P<name>[A-Za-z_][\w.]*\'*)(?P<call>\()?'
)

_SAME_UNIT: Final = {'abs', 'hypot', 'max', 'min', 'mod', 'sum'}
"""The functions whose value has the unit of their arguments."""


def has_units(formula: str) -> bool:
    """Return True if a number in a canonical text has a unit."""
    return any(found['unit'] for found in _QUOTED.finditer(formula))


async def find_units(symbols: Iterable[Symbol], query: QueryFunction) -> dict[str, str]:
    """Return the unit of each feature among symbols, by name; empty for one without a unit.

    Args:
        symbols: the symbols of the formula.
        query: returns the solutions of a SPARQL query of the ontology.

    Raises:
        DyKnowError: for a feature with several units, for a name that is like that of a feature,
            or if the query fails.
    """
    rows = await _stated('unit', symbols, query)
    units = {name: only_unit(name, found) for name, found in rows.items()}
    without = [name for name, unit in units.items() if not unit]
    if without:
        _check_names(without, [each.rpartition(':')[2] for (each,) in await query(FEATURE_QUERY)])
    return units


def _check_names(names: Iterable[str], known: Sequence[str]) -> None:
    """Check that names without a unit are features of the ontology."""
    for name in names:
        if name not in known:
            similar = get_close_matches(name, known, n=1)
            stated = f'declare it, or state the unit, let {name}: UNIT in ...'
            hint = f"did you mean '{similar[0]}'?" if similar else stated
            raise CoordinationError(
                f"the unit of '{name}' is not known, as no ontology describes this feature; {hint}",
                ExitCode.NOT_FOUND,
            )


async def _stated(name: str, symbols: Iterable[Symbol], query: QueryFunction) -> dict[str, Rows]:
    """Return the concepts that state a property, which each feature is or is below, with it."""
    names = [each.name for each in feature_symbols(symbols) if not each.is_reference]
    return {each: await query(property_query(each, name)) for each in dict.fromkeys(names)}


async def find_uncertainties(
    formula: str, symbols: Iterable[Symbol], query: QueryFunction
) -> dict[str, str]:
    """Return what is known of the values of each feature, `normal(Height, 0.5)`, by name.

    Args:
        formula: the canonical text; one that asks for no probability needs none.
        symbols: the symbols of the formula.
        query: returns the solutions of a SPARQL query of the ontology.

    Raises:
        DyKnowError: if the query fails.
    """
    if not _PROBABILITY.search(formula):
        return {}
    rows = await _stated('uncertainty', symbols, query)
    found = {}
    for feature, stated in rows.items():
        # Features above it are measured otherwise.
        for concept, uncertainty in stated:
            if concept.rpartition(':')[2] == feature:
                found[feature] = uncertainty
    return found


def only_unit(feature: str, rows: Rows) -> str:
    """Return the unit of a feature, given the concepts that state one; empty if none does.

    A feature that states its unit does not inherit it.

    Raises:
        CoordinationError: if there are several.
    """
    found = set(own_or_inherited(feature, ((concept, unit) for concept, unit in rows)))
    if len(found) > 1:
        raise CoordinationError(
            f"the unit of '{feature}' is ambiguous, as concepts above it have different ones: "
            f'{", ".join(sorted(found))}; write plain numbers'
        )
    return next(iter(found), '')


def with_units(
    formula: str, units: Mapping[str, str], uncertainties: Mapping[str, str] | None = None
) -> str:
    """Return a text that states the units and the uncertainties of features before a formula."""
    stated = [f'{name}: {quoted(unit)}' for name, unit in units.items()]
    stated += [f'{name} ~ {text}' for name, text in (uncertainties or {}).items()]
    return f'let {", ".join(stated)} in ({formula})' if stated else formula


async def feature_units(symbols: Iterable[Symbol], query: QueryFunction) -> dict[str, str]:
    """Return the unit of each feature; empty for one without a unit, or with an unknown one.

    Args:
        symbols: the symbols of the formula.
        query: returns the solutions of a SPARQL query of the ontology.

    Raises:
        DyKnowError: if the query fails.
    """
    features = feature_symbols(symbols)
    rows = await _stated('unit', features, query)
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


def with_units_of_margins(verdicts: StandingVerdicts, units: Mapping[str, str]) -> StandingVerdicts:
    """Return verdicts whose margins are in the units of their comparisons; see `with_unit`."""
    episodes = (
        replace(each, worst=each.worst and with_unit(each.worst, units))
        for each in verdicts.latest_episodes
    )
    return replace(verdicts, latest_episodes=tuple(episodes))


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
