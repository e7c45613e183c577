"""Knowledge from triples, against owlready2's own view of the same ontology."""

from __future__ import annotations

from io import BytesIO

import owlready2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_semantics import Knowledge, SemanticsError, Triple

RDF = 'http://www.w3.org/1999/02/22-rdf-syntax-ns#'
RDFS = 'http://www.w3.org/2000/01/rdf-schema#'
OWL = 'http://www.w3.org/2002/07/owl#'
HERE = 'http://www.example.org/here#'

CLASSES = [f'C{number}' for number in range(5)]
OBJECTS = [f'o{number}' for number in range(3)]


def class_triples(*names: str) -> list[Triple]:
    return [(HERE + name, RDF + 'type', OWL + 'Class') for name in names]


def construct(node: str, kind: str, *members: str) -> list[Triple]:
    """A class expression as a blank node and the list of its members."""
    cells = [f'{node}{place}' for place in range(len(members))]
    triples = [(node, OWL + kind, cells[0])]
    for cell, rest, member in zip(cells, [*cells[1:], RDF + 'nil'], members, strict=True):
        triples += [(cell, RDF + 'first', member), (cell, RDF + 'rest', rest)]
    return triples


def test_parts_of_intersections_and_unions() -> None:
    triples = class_triples('Both', 'Left', 'Right', 'Either', 'Split')
    triples += construct('-1', 'intersectionOf', HERE + 'Left', HERE + 'Right')
    triples += construct('-2', 'unionOf', HERE + 'Left', HERE + 'Right')
    triples.append((HERE + 'Both', RDFS + 'subClassOf', '-1'))
    triples.append((HERE + 'Either', OWL + 'equivalentClass', '-2'))
    triples += construct(HERE + 'Split', 'disjointUnionOf', HERE + 'Left', HERE + 'Right')
    knowledge = Knowledge(triples)
    assert knowledge.superconcepts('Both') == ('Both', 'Either', 'Left', 'Right', 'Split')
    assert knowledge.subconcepts('Either') == ('Both', 'Either', 'Left', 'Right')


def test_counts_are_those_of_the_own_ontologies() -> None:
    triples = class_triples('A', 'B', 'Level')
    triples += [
        (f'http://www.dyknow.org/ontology#{name}', RDF + 'type', OWL + 'Class')
        for name in ('Object', 'Feature')
    ]
    triples += [
        (HERE + 'Level', RDFS + 'subClassOf', 'http://www.dyknow.org/ontology#NullaryFeature'),
        (
            'http://www.dyknow.org/ontology#NullaryFeature',
            RDFS + 'subClassOf',
            'http://www.dyknow.org/ontology#Feature',
        ),
        (HERE + 'Level', 'http://www.dyknow.org/ontology#value_type', 'float'),
        (HERE + 'a', RDF + 'type', HERE + 'A'),
    ]
    assert Knowledge(triples).counts == {'concepts': 3, 'features': 1, 'objects': 1}


def test_constructs_within_constructs() -> None:
    triples = class_triples('A', 'B', 'C', 'D')
    triples += construct('-1', 'intersectionOf', HERE + 'B', '-2')
    triples += construct('-2', 'intersectionOf', HERE + 'C', HERE + 'D')
    triples.append((HERE + 'A', OWL + 'equivalentClass', '-1'))
    assert Knowledge(triples).superconcepts('A') == ('A', 'B', 'C', 'D')


def test_instances_of_class_expressions_and_enumerations() -> None:
    triples = class_triples('A', 'B', 'Crew')
    triples += construct('-1', 'intersectionOf', HERE + 'A', HERE + 'B')
    triples += construct('-2', 'oneOf', HERE + 'x', HERE + 'y', 'a text')
    triples.append((HERE + 'Crew', OWL + 'equivalentClass', '-2'))
    triples.append((HERE + 'x', RDF + 'type', '-1'))
    triples.append((HERE + 'y', RDF + 'type', OWL + 'NamedIndividual'))
    knowledge = Knowledge(triples)
    assert knowledge.instances('A') == knowledge.instances('B') == ('x',)
    assert knowledge.instances('Crew') == ('x', 'y')
    assert set(knowledge.concepts('x')) == {'A', 'B', 'Crew'}
    assert knowledge.concepts('y') == ('Crew',)


def test_a_broken_list_ends() -> None:
    triples = class_triples('A', 'B')
    triples += [
        (HERE + 'A', OWL + 'intersectionOf', '-1'),
        ('-1', RDF + 'first', HERE + 'B'),
        ('-1', RDF + 'rest', '-1'),
    ]
    assert Knowledge(triples).superconcepts('A') == ('A', 'B')


def test_classes_and_properties_are_no_instances() -> None:
    triples = class_triples('A')
    triples.append((HERE + 'p', RDF + 'type', OWL + 'ObjectProperty'))
    knowledge = Knowledge(triples)
    for name in ('A', 'p'):
        with pytest.raises(SemanticsError, match=f"unknown instance '{name}'"):
            knowledge.concepts(name)


def test_names_of_other_resources_are_their_iris() -> None:
    knowledge = Knowledge(class_triples('A'))
    assert knowledge.name(HERE + 'A') == 'A'
    assert knowledge.name(HERE + 'p') == HERE + 'p'


# A class lies below one of a lower number only: owlready2 drops a part of a circle of subclasses.
RELATIONS = st.lists(
    st.tuples(
        st.sampled_from(CLASSES),
        st.sampled_from([RDFS + 'subClassOf', OWL + 'equivalentClass']),
        st.sampled_from(CLASSES),
    ).filter(lambda triple: triple[0] > triple[2]),
    max_size=7,
)
TYPES = st.lists(st.tuples(st.sampled_from(OBJECTS), st.sampled_from(CLASSES)), max_size=5)


@given(RELATIONS, TYPES)
def test_hierarchies_are_as_owlready2_sees_them(
    relations: list[tuple[str, str, str]], types: list[tuple[str, str]]
) -> None:
    triples = class_triples(*CLASSES)
    triples += [(HERE + one, relation, HERE + other) for one, relation, other in relations]
    triples += [(HERE + name, RDF + 'type', OWL + 'NamedIndividual') for name in OBJECTS]
    triples += [(HERE + name, RDF + 'type', HERE + kind) for name, kind in types]
    knowledge = Knowledge(triples)
    text = ''.join(f'<{subject}> <{verb}> <{value}> .\n' for subject, verb, value in triples)
    world = owlready2.World()
    world.get_ontology(HERE).load(fileobj=BytesIO(text.encode()))
    # Not `concept.instances()`: its query is one that Python 3.12 warns of and 3.14 refuses.
    individuals = [(each.name, each.INDIRECT_is_a) for each in world.individuals()]
    for name in CLASSES:
        concept = world[HERE + name]
        assert set(knowledge.subconcepts(name)) == {each.name for each in concept.descendants()}
        found = {individual for individual, concepts in individuals if concept in concepts}
        assert set(knowledge.instances(name)) == found
    world.close()
