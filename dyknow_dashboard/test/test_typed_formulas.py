"""Formulas while they are typed."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import pytest

from dyknow_dashboard.errors import DashboardError
from dyknow_dashboard.model.typed_formulas import (
    MAX_FORMULA,
    MAX_PROPOSALS,
    check,
    proposals,
)
from dyknow_semantics import Ontology
from dyknow_semantics.ontology.features import StatedSignature


@pytest.fixture(scope='module')
def knowledge() -> object:
    with closing(Ontology()) as ontology:
        ontology.create_concept('UAV')
        ontology.create_concept('Power', [], StatedSignature(('UAV',), 'float', 'W'))
        ontology.create_concept('Position', [], StatedSignature(('UAV',), 'float'))
        for name in ('uav1', 'uav2'):
            ontology.create_instance(name, ['UAV'])
        return ontology.knowledge


def texts(text: str, knowledge: object, cursor: int | None = None) -> list[str]:
    place = len(text) if cursor is None else cursor
    return [each['text'] for each in proposals(text, place, knowledge)]  # type: ignore[arg-type]


def test_a_formula_has_a_canonical_text_and_notes() -> None:
    found = check('always[0, 5] a.x < 3', None)
    assert found['canonical'] == 'always[0 s, 5 ms] (a.x < 3)'
    (note,) = found['notes']
    assert 'the time 5 has no unit' in note
    assert note.splitlines()[-1].strip() == '^'


def test_a_fault_has_its_place_and_a_caret() -> None:
    found = check('always a.x <', None)
    assert (found['line'], found['column']) == (1, 13)
    first, text, caret = found['fault'].splitlines()
    assert first.startswith('formula:1:13: unexpected end of the formula, expected ')
    assert text == '  always a.x <'
    assert caret == ' ' * 14 + '^'


def test_a_fault_of_types() -> None:
    assert 'fault' in check('always (3 and a.x)', None)


def test_an_unknown_feature_has_its_place_and_a_caret(knowledge: Any) -> None:
    (note,) = check('forall u in UAV:\n  always Pwer[u] < 3', knowledge)['notes']
    first, text, caret = note.splitlines()
    assert first.startswith('formula:2:10: ')
    assert "'Pwer'" in first
    assert caret.index('^') == text.index('Pwer')


def test_nothing_typed_is_no_fault() -> None:
    assert check(' \n', None) == {'canonical': '', 'notes': []}


def test_a_feature_that_the_ontology_lacks(knowledge: object) -> None:
    found = check('always Powr[uav1] < 3', knowledge)  # type: ignore[arg-type]
    assert "'Powr'" in found['notes'][0]
    assert check('always Power[uav1] < 3', knowledge)['notes'] == []  # type: ignore[arg-type]


def test_proposals_complete_the_name_at_the_cursor(knowledge: object) -> None:
    assert texts('always Po', knowledge) == ['Position', 'Power']
    (power,) = proposals('always Pow', 10, knowledge)  # type: ignore[arg-type]
    assert power == {'text': 'Power', 'kind': 'feature', 'note': '[UAV]: float in W', 'from': 7}
    assert texts('forall u in U', knowledge) == ['UAV', 'uav1', 'uav2', 'unless', 'until']
    assert texts('Pow < 3', knowledge, cursor=3) == ['Power']


def test_no_proposals_where_no_name_ends(knowledge: object) -> None:
    for text in ('', 'always ', 'Power[uav1] < 3', 'Power'):
        assert texts(text, knowledge) == []


def test_operators_are_known_without_an_ontology() -> None:
    assert texts('ev', None) == ['eventually']
    assert len(texts('a', None)) <= MAX_PROPOSALS


def test_a_text_that_is_too_long() -> None:
    with pytest.raises(DashboardError, match=f'takes at most {MAX_FORMULA}'):
        check('x' * (MAX_FORMULA + 1), None)
