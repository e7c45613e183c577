"""The serialisations of OWL, and the prefixes that ontologies declare."""

from __future__ import annotations

from pathlib import Path

import pytest

from dyknow_common import ExitCode, ValueType
from dyknow_semantics import Ontology, SemanticsError
from dyknow_semantics.ontology.documents.serialisations import normalise
from dyknow_semantics.ontology.documents.sources import OntologySource

STRING = 'http://www.w3.org/2001/XMLSchema#string'
IRI = 'http://www.example.org/fleet-ontology'

RDF_XML = f"""<?xml version="1.0"?>
<!DOCTYPE rdf:RDF [ <!ENTITY uav "{IRI}#"> ]>
<rdf:RDF xmlns="&uav;" xmlns:uav="&uav;" xml:base="{IRI}"
    xmlns:dyknow="http://www.dyknow.org/ontology#" xmlns:owl="http://www.w3.org/2002/07/owl#"
    xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"
    xmlns:rdfs="http://www.w3.org/2000/01/rdf-schema#">
  <owl:Ontology rdf:about="{IRI}"/>
  <owl:Class rdf:about="#UAV"><rdfs:subClassOf rdf:resource="http://www.dyknow.org/ontology#Object"/></owl:Class>
  <owl:Class rdf:about="#Altitude"><rdfs:subClassOf rdf:resource="http://www.dyknow.org/ontology#Feature"/>
    <dyknow:argument1 rdf:resource="#UAV"/>
    <dyknow:value_type>float</dyknow:value_type><dyknow:unit>m</dyknow:unit>
  </owl:Class>
</rdf:RDF>
"""

OWL_XML = f"""<?xml version="1.0"?>
<Ontology ontologyIRI="{IRI}" xml:base="{IRI}"
    xmlns="http://www.w3.org/2002/07/owl#">
  <Prefix name="uav" IRI="{IRI}#"/>
  <Prefix name="dyknow" IRI="http://www.dyknow.org/ontology#"/>
  <Prefix name="xsd" IRI="http://www.w3.org/2001/XMLSchema#"/>
  <Declaration><Class abbreviatedIRI="uav:UAV"/></Declaration>
  <SubClassOf>
    <Class abbreviatedIRI="uav:UAV"/><Class abbreviatedIRI="dyknow:Object"/>
  </SubClassOf>
  <Declaration><Class abbreviatedIRI="uav:Altitude"/></Declaration>
  <SubClassOf>
    <Class abbreviatedIRI="uav:Altitude"/><Class abbreviatedIRI="dyknow:Feature"/>
  </SubClassOf>
  <AnnotationAssertion>
    <AnnotationProperty abbreviatedIRI="dyknow:argument1"/>
    <IRI>{IRI}#Altitude</IRI><IRI>{IRI}#UAV</IRI>
  </AnnotationAssertion>
  <AnnotationAssertion>
    <AnnotationProperty abbreviatedIRI="dyknow:value_type"/>
    <IRI>{IRI}#Altitude</IRI><Literal datatypeIRI="{STRING}">float</Literal>
  </AnnotationAssertion>
  <AnnotationAssertion>
    <AnnotationProperty abbreviatedIRI="dyknow:unit"/>
    <IRI>{IRI}#Altitude</IRI><Literal datatypeIRI="{STRING}">m</Literal>
  </AnnotationAssertion>
</Ontology>
"""

TURTLE = f"""# The vocabulary of a fleet.
@prefix : <{IRI}#> .
@prefix uav: <{IRI}#> .
@prefix dyknow: <http://www.dyknow.org/ontology#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
<{IRI}> a owl:Ontology .
uav:UAV a owl:Class ; rdfs:subClassOf dyknow:Object .
uav:Altitude a owl:Class ; rdfs:subClassOf dyknow:Feature ;
    dyknow:argument1 uav:UAV ; dyknow:value_type "float" ; dyknow:unit "m" .
"""


UNDECLARED = OWL_XML.replace(
    '<Declaration><Class abbreviatedIRI="uav:Altitude"/></Declaration>', ''
)
UNDECLARED = UNDECLARED.replace('abbreviatedIRI="uav:Altitude"', f'IRI="{IRI}#Altitude"')


@pytest.mark.parametrize(
    ('name', 'text'),
    [
        ('a.owl', RDF_XML),
        ('a.owl', OWL_XML),
        ('a.owl', UNDECLARED),
        ('a.ttl', TURTLE),
        ('a.owl', TURTLE),
    ],
)
def test_serialisations_are_equivalent(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    with Ontology() as ontology:
        ontology.load(tmp_path / name)
        feature = ontology.knowledge.feature('uav:Altitude')
        assert (feature.name, feature.argument_sorts) == ('Altitude', ('UAV',))
        assert (feature.value_type, feature.unit) == (ValueType.FLOAT, 'm')
        assert ontology.knowledge.feature('fleet-ontology:Altitude') == feature
        assert ontology.knowledge.feature(f'{IRI}#Altitude') == feature
        assert ontology.knowledge.subconcepts('dyknow:Object') == ('Object', 'UAV')


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('@prefix a: <http://a.org/#> .\na:b c:d a:e .', 'line 2: Prefix "c:" not bound'),
        ('@prefix a: <http://a.org/#> .\na:b \xff .', 'it is not in UTF-8'),
        ('<?xml version="1.0"?>\n<rdf:RDF', 'parsing error: '),
        ('<?xml version="1.0"?>\n<html/>', 'its root is html; write it as RDF/XML, OWL/XML, '),
    ],
)
def test_texts_that_cannot_be_read(text: str, message: str) -> None:
    with pytest.raises(SemanticsError) as error:
        normalise(OntologySource('/fleet', text.encode('latin-1')), 'http://unknown/')
    assert error.value.message.startswith(f'cannot read an ontology: /fleet: {message}')


def test_a_base_with_a_fragment(tmp_path: Path) -> None:
    text = RDF_XML.replace(f'xml:base="{IRI}"', 'xml:base="&uav;"').replace(
        'owl:Class rdf:about="#', 'owl:Class rdf:ID="'
    )
    (tmp_path / 'a.owl').write_text(text)
    with Ontology() as ontology:
        ontology.load(tmp_path / 'a.owl')
        assert ontology.knowledge.concept_names.iri('uav:UAV') == f'{IRI}#UAV'
        assert ontology.knowledge.feature('Altitude').argument_sorts == ('UAV',)
        (tmp_path / 'a.owl').write_text(text.replace('</rdf:RDF>', ''))
        with pytest.raises(SemanticsError, match=r'a\.owl: parsing error: .*no element found'):
            ontology.load(tmp_path / 'a.owl')


def test_prefixes_are_kept_in_the_store(tmp_path: Path) -> None:
    (tmp_path / 'a.owl').write_text(RDF_XML)
    with Ontology(tmp_path / 'store') as ontology:
        ontology.load(tmp_path / 'a.owl')
    with Ontology(tmp_path / 'store') as ontology:
        ontology.create_concept('uav:Kite', ['uav:UAV'])
        assert ontology.knowledge.concept_names.iri('Kite') == f'{IRI}#Kite'
        # What the file no longer declares is forgotten.
        (tmp_path / 'a.owl').write_text(RDF_XML.replace('xmlns:uav="&uav;"', ''))
        ontology.load(tmp_path / 'a.owl')
        with pytest.raises(SemanticsError, match="unknown concept 'uav:UAV'"):
            ontology.knowledge.subconcepts('uav:UAV')


def test_one_prefix_for_two_namespaces(tmp_path: Path) -> None:
    (tmp_path / 'a.owl').write_text(RDF_XML)
    (tmp_path / 'b.owl').write_text(RDF_XML.replace('fleet', 'sea'))
    with Ontology() as ontology:
        ontology.load(tmp_path / 'a.owl')
        ontology.create_concept('uav:Kite', ['UAV'])
        ontology.load(tmp_path / 'b.owl')
        assert ontology.knowledge.subconcepts('uav:Kite') == ('Kite',)
        for name in ('UAV', 'uav:UAV'):
            with pytest.raises(SemanticsError) as error:
                ontology.knowledge.subconcepts(name)
            assert error.value.message.startswith(
                f"the concept '{name}' is ambiguous; "
                'it is one of fleet-ontology:UAV, sea-ontology:UAV; '
            )
        with pytest.raises(SemanticsError) as error:
            ontology.create_concept('uav:Balloon')
        assert error.value.code is ExitCode.INVALID_ARGUMENT
        assert error.value.message == (
            "the prefix 'uav' is ambiguous; it stands for http://www.example.org/fleet-ontology# "
            'and http://www.example.org/sea-ontology#: give the whole IRI'
        )
