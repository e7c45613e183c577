"""What an ontology says in vain is named."""

from __future__ import annotations

import pytest

from dyknow_semantics import Ontology, void_statements

UPPER = 'http://www.dyknow.org/ontology#'
TURTLE = """
@prefix : <http://example.org/team#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix d: <{namespace}> .
<http://example.org/team> a owl:Ontology ; owl:imports <http://www.dyknow.org/ontology> .
:Drone a owl:Class ; rdfs:subClassOf d:Object .
:d1 a :Drone .
:Height a owl:Class ; rdfs:subClassOf d:Feature ; d:argument1 :Drone ; d:value_type "float" .
:Gps a owl:Class ; rdfs:subClassOf :Height .
{more}
"""

WIDE = """
:Wide a owl:Class ; rdfs:subClassOf d:Feature ; d:value_type "float" ; d:argument1 :Drone ;
    d:argument2 :Drone ; d:argument3 :Drone ; d:argument4 :Drone ; d:argument5 :Drone .
"""


def found(more: str = '', namespace: str = UPPER) -> list[str]:
    with Ontology() as ontology:
        ontology.load_text(TURTLE.format(more=more, namespace=namespace))
        return [*void_statements(ontology.triples, ontology.knowledge)]


@pytest.mark.parametrize(
    'more',
    [
        '',
        'd:Boat a owl:Class . :b a d:Boat .',
        WIDE,
        ':Height d:unit "m" ; d:unknown "0 1" ; d:uncertainty "normal(Height, 1, 2 s)" .',
        ':d1 <http://www.dyknow.org/ontology/fleet#owner> "me" .',
    ],
)
def test_nothing_is_in_vain(more: str) -> None:
    assert found(more) == []


@pytest.mark.parametrize('more', ['', 'd:units a owl:AnnotationProperty .'])
def test_a_term_that_there_is_not(more: str) -> None:
    (text,) = found(f':Height d:units "m" . {more}')
    assert text == "DyKnow's ontology has no term 'units'; did you mean 'unit'?"


@pytest.mark.parametrize(
    'namespace',
    ['http://www.dyknow.org/ontology/', 'https://www.dyknow.org/ontology#'],
)
def test_a_namespace_that_is_nearly_the_right_one(namespace: str) -> None:
    (text,) = found(namespace=namespace)
    assert text.startswith(f'what the namespace {namespace} names has no meaning; did you mean ')
    assert UPPER in text


def test_an_individual_of_a_feature() -> None:
    assert found(':h1 a :Gps .') == [
        "'h1' is an individual of the feature 'Gps', which has none; remove it"
    ]
