"""Sorts of quantifiers that name none."""

from __future__ import annotations

import pytest

from dyknow_common import Symbol, SymbolKind
from dyknow_coordinator import CoordinationError
from dyknow_coordinator.grounding.completion import (
    ArgumentPlace,
    declared_sorts,
    only_sort,
    places_of_variables,
    with_sorts,
)

POWER = ArgumentPlace('Power', 1)
TARGET = ArgumentPlace('Distance', 2)


def test_the_places_of_variables() -> None:
    symbols = (
        Symbol(SymbolKind.SORT, '?u'),
        Symbol(SymbolKind.SORT, 'UAV'),
        Symbol(SymbolKind.SORT, '?v'),
        Symbol(SymbolKind.FEATURE, 'Power', ('?u',)),
        Symbol(SymbolKind.FEATURE, 'Distance', ('UAV', '?u')),
    )
    assert places_of_variables(symbols) == {'u': (POWER, TARGET), 'v': ()}
    assert places_of_variables(symbols[1:2]) == {}


def test_a_feature_inherits_a_sort_that_it_does_not_state() -> None:
    inherited = [('Measured', 'Vehicle')]
    assert declared_sorts(POWER, inherited) == {'Vehicle'}
    assert declared_sorts(POWER, [*inherited, ('Power', 'UAV')]) == {'UAV'}
    # The prefix tells it from a feature of that name in another ontology.
    assert declared_sorts(POWER, [*inherited, ('uav:Power', 'UAV')]) == {'UAV'}
    assert declared_sorts(POWER, []) == frozenset()


def test_the_only_sort() -> None:
    assert only_sort('u', {POWER: ['UAV'], TARGET: ['UAV']}) == 'UAV'


@pytest.mark.parametrize(
    ('sorts', 'message'),
    [
        ({}, "the sort of 'u' is unknown, as no feature has it as an argument; write u in SORT"),
        (
            {POWER: ['UAV'], TARGET: []},
            "the sort of 'u' is unknown: the ontology has none for argument 2 of Distance; write",
        ),
        (
            {POWER: ['UAV'], TARGET: ['Place']},
            (
                "the sort of 'u' is ambiguous: UAV as argument 1 of Power, Place as argument 2 of "
                'Distance; write u in SORT after forall or exists'
            ),
        ),
        ({POWER: ['a:UAV']}, "the sort of 'u' is a:UAV, a name that formulas cannot have"),
    ],
)
def test_no_only_sort(sorts: dict[ArgumentPlace, list[str]], message: str) -> None:
    with pytest.raises(CoordinationError) as error:
        only_sort('u', sorts)
    assert str(error.value).startswith(message)


def test_sorts_in_a_canonical_text() -> None:
    text = (
        r"""forall u: ((Mode[u] = "forall u: \" (") and (exists u': (forall w in S: P[u', w])))"""
    )
    assert with_sorts(text, {'u': 'UAV', "u'": "T'"}) == (
        r"""forall u in UAV: ((Mode[u] = "forall u: \" (") """
        r"""and (exists u' in T': (forall w in S: P[u', w])))"""
    )


def test_sorts_of_aggregates() -> None:
    text = 'max(P[u] for u) < sum(P[v] for v in S) and (forall w: P[w] < min(Q[w, x] for x))'
    assert with_sorts(text, {'u': 'UAV', 'v': 'T', 'w': 'W', 'x': 'X'}) == (
        'max(P[u] for u in UAV) < sum(P[v] for v in S) and '
        '(forall w in W: P[w] < min(Q[w, x] for x in X))'
    )


def test_sorts_of_counts() -> None:
    text = '(at least 2 u: P[u]) and (exactly 10 v: (at most 1 w in S: Q[v, w]))'
    assert with_sorts(text, {'u': 'UAV', 'v': 'T'}) == (
        '(at least 2 u in UAV: P[u]) and (exactly 10 v in T: (at most 1 w in S: Q[v, w]))'
    )
