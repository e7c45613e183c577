"""IRIs of RDF, RDFS, OWL and the upper ontology of DyKnow."""

from __future__ import annotations

from typing import Final

RDF: Final = 'http://www.w3.org/1999/02/22-rdf-syntax-ns#'
RDFS: Final = 'http://www.w3.org/2000/01/rdf-schema#'
OWL: Final = 'http://www.w3.org/2002/07/owl#'
XSD: Final = 'http://www.w3.org/2001/XMLSchema#'

LANGUAGES: Final = (RDF, RDFS, OWL, XSD)
"""The namespaces of the languages that ontologies are written in."""

TYPE: Final = RDF + 'type'
FIRST: Final = RDF + 'first'
REST: Final = RDF + 'rest'
NIL: Final = RDF + 'nil'
SUBCLASS_OF: Final = RDFS + 'subClassOf'
ANNOTATION_PROPERTY: Final = OWL + 'AnnotationProperty'
ONTOLOGY: Final = OWL + 'Ontology'
THING: Final = OWL + 'Thing'
NOTHING: Final = OWL + 'Nothing'
CLASS: Final = OWL + 'Class'
NAMED_INDIVIDUAL: Final = OWL + 'NamedIndividual'
EQUIVALENT_CLASS: Final = OWL + 'equivalentClass'
INTERSECTION_OF: Final = OWL + 'intersectionOf'
UNION_OF: Final = OWL + 'unionOf'
DISJOINT_UNION_OF: Final = OWL + 'disjointUnionOf'
ONE_OF: Final = OWL + 'oneOf'
SAME_AS: Final = OWL + 'sameAs'

UPPER_ONTOLOGY: Final = 'http://www.dyknow.org/ontology#'
"""The namespace of the upper ontology, which this package ships."""

RUNTIME_ONTOLOGY: Final = 'http://www.dyknow.org/runtime#'
"""The ontology of the concepts and instances that are created at run time."""

ENTAILED_ONTOLOGY: Final = 'http://www.dyknow.org/entailed#'
"""The ontology of the statements that a reasoner has derived from the others."""

BRIDGES_ONTOLOGY: Final = 'http://www.dyknow.org/bridges#'
"""The ontology of the statements that bridge rules make about the present names."""

OBJECT: Final = UPPER_ONTOLOGY + 'Object'
FEATURE: Final = UPPER_ONTOLOGY + 'Feature'
NULLARY_FEATURE: Final = UPPER_ONTOLOGY + 'NullaryFeature'
ARGUMENT: Final = UPPER_ONTOLOGY + 'argument'
VALUE_TYPE: Final = UPPER_ONTOLOGY + 'value_type'
UNIT: Final = UPPER_ONTOLOGY + 'unit'
PREFIX: Final = UPPER_ONTOLOGY + 'prefix'
