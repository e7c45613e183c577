"""Semantic grounding: ontologies, annotations of streams (SSL) and matching."""

from dyknow_semantics.annotation import (
    Annotation,
    Argument,
    Concept,
    Content,
    FeatureTerm,
    Key,
    Range,
)
from dyknow_semantics.annotation_store import AnnotationStore
from dyknow_semantics.bridges import Bridge, Bridged, Relation, bridged, parse_bridges
from dyknow_semantics.checking import check_annotation, check_concept
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.features import Feature
from dyknow_semantics.field_checking import check_fields
from dyknow_semantics.hierarchy import Entry, as_json, as_tree, entries, explanation_tree
from dyknow_semantics.knowledge import Knowledge, Triple
from dyknow_semantics.matching import Matcher, match
from dyknow_semantics.nearness import Explanation
from dyknow_semantics.ontology import Ontology
from dyknow_semantics.parsing import parse_annotations, parse_concept
from dyknow_semantics.reasoning import Reasoner, ReasonerProcess, choose_reasoner
from dyknow_semantics.specifications import Match
from dyknow_semantics.store import ALL_TRIPLES
from dyknow_semantics.vocabulary import UPPER_ONTOLOGY

__all__ = [
    'ALL_TRIPLES',
    'UPPER_ONTOLOGY',
    'Annotation',
    'AnnotationStore',
    'Argument',
    'Bridge',
    'Bridged',
    'Concept',
    'Content',
    'Entry',
    'Explanation',
    'Feature',
    'FeatureTerm',
    'Key',
    'Knowledge',
    'Match',
    'Matcher',
    'Ontology',
    'Range',
    'Reasoner',
    'ReasonerProcess',
    'Relation',
    'SemanticsError',
    'Triple',
    'as_json',
    'as_tree',
    'bridged',
    'check_annotation',
    'check_concept',
    'check_fields',
    'choose_reasoner',
    'entries',
    'explanation_tree',
    'match',
    'parse_annotations',
    'parse_bridges',
    'parse_concept',
]
