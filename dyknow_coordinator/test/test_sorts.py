"""Sorts of quantifiers that name none."""

from __future__ import annotations

import asyncio

import pytest

from dyknow_coordinator import CoordinationError
from dyknow_coordinator.grounding.completion import (
    ArgumentPlace,
    declared_sorts,
    infer_sorts,
    only_sort,
    places_of_variables,
    with_sorts,
)
from dyknow_coordinator.grounding.scopes import Scopes

POWER = ArgumentPlace('Power', 1)
TARGET = ArgumentPlace('Distance', 2)


def sorted_text(text: str, **sorts: str) -> str:
    """The formula in which variables of some names have sorts."""
    scopes = Scopes(text)
    unsorted = [each for each in scopes.binders if each.sort == '' and each.name in sorts]
    return with_sorts(scopes, {each: sorts[each.name] for each in unsorted})


def test_the_places_of_variables() -> None:
    text = '(forall u: ((forall w in UAV: (Power[u] < Distance[w, u])) and (exists v: (s.a[v]))))'
    found = places_of_variables(Scopes(text))
    assert {each.name: places for each, places in found.items()} == {'u': (POWER, TARGET), 'v': ()}
    assert places_of_variables(Scopes('forall w in UAV: (always (Power[w] < 2))')) == {}


def test_variables_of_one_name_have_their_own_sorts() -> None:
    """One of them is bound and used between the other quantifier and its uses."""
    text = (
        '(forall u: (Power[u] < Charge)) and (max(Distance[a, u] for u) < 2) and (forall u: (true))'
    )
    first, second, third = places_of_variables(Scopes(text)).values()
    assert (first, second, third) == ((POWER,), (TARGET,), ())

    async def query(text: str) -> list[tuple[str, ...]]:
        return [('Power', 'UAV')] if 'Power' in text else [('Distance', 'Place')]

    scopes = Scopes(text.removesuffix(' and (forall u: (true))'))
    assert with_sorts(scopes, asyncio.run(infer_sorts(scopes, query))) == (
        '(forall u in UAV: (Power[u] < Charge)) and (max(Distance[a, u] for u in Place) < 2)'
    )


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
    assert sorted_text(text, **{'u': 'UAV', "u'": "T'"}) == (
        r"""forall u in UAV: ((Mode[u] = "forall u: \" (") """
        r"""and (exists u' in T': (forall w in S: P[u', w])))"""
    )


def test_sorts_of_aggregates() -> None:
    text = 'max(P[u] for u) < sum(P[v] for v in S) and (forall w: P[w] < min(Q[w, x] for x))'
    assert sorted_text(text, u='UAV', v='T', w='W', x='X') == (
        'max(P[u] for u in UAV) < sum(P[v] for v in S) and '
        '(forall w in W: P[w] < min(Q[w, x] for x in X))'
    )


def test_sorts_of_counts() -> None:
    text = '(at least 2 u: P[u]) and (exactly 10 v: (at most 1 w in S: Q[v, w]))'
    assert sorted_text(text, u='UAV', v='T') == (
        '(at least 2 u in UAV: P[u]) and (exactly 10 v in T: (at most 1 w in S: Q[v, w]))'
    )
