"""The IRIs that the reading of an ontology rests on: RDF, OWL and the upper ontology of DyKnow."""

from __future__ import annotations

from typing import Final

_RDF: Final = 'http://www.w3.org/1999/02/22-rdf-syntax-ns#'
_RDFS: Final = 'http://www.w3.org/2000/01/rdf-schema#'
_OWL: Final = 'http://www.w3.org/2002/07/owl#'

TYPE: Final = _RDF + 'type'
FIRST: Final = _RDF + 'first'
REST: Final = _RDF + 'rest'
NIL: Final = _RDF + 'nil'
SUBCLASS_OF: Final = _RDFS + 'subClassOf'
CLASS: Final = _OWL + 'Class'
NAMED_INDIVIDUAL: Final = _OWL + 'NamedIndividual'
EQUIVALENT_CLASS: Final = _OWL + 'equivalentClass'
INTERSECTION_OF: Final = _OWL + 'intersectionOf'
UNION_OF: Final = _OWL + 'unionOf'
DISJOINT_UNION_OF: Final = _OWL + 'disjointUnionOf'
ONE_OF: Final = _OWL + 'oneOf'

UPPER_ONTOLOGY: Final = 'http://www.dyknow.org/ontology#'
"""The namespace of the upper ontology that this package ships."""

FEATURE: Final = UPPER_ONTOLOGY + 'Feature'
NULLARY_FEATURE: Final = UPPER_ONTOLOGY + 'NullaryFeature'
ARGUMENT: Final = UPPER_ONTOLOGY + 'argument'
VALUE_TYPE: Final = UPPER_ONTOLOGY + 'value_type'
UNIT: Final = UPPER_ONTOLOGY + 'unit'
