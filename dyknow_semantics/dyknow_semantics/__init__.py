"""Semantic grounding: ontologies, annotations of streams (SSL) and matching."""

from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.features import Feature
from dyknow_semantics.knowledge import ALL_TRIPLES, Knowledge, Triple
from dyknow_semantics.ontology import Ontology
from dyknow_semantics.vocabulary import UPPER_ONTOLOGY

__all__ = [
    'ALL_TRIPLES',
    'UPPER_ONTOLOGY',
    'Feature',
    'Knowledge',
    'Ontology',
    'SemanticsError',
    'Triple',
]
