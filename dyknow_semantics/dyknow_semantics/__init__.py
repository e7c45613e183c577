"""Semantic grounding: ontologies, annotations of streams (SSL) and matching."""

from dyknow_semantics.annotations.annotation import (
    Annotation,
    Concept,
    Content,
    FeatureArgument,
    FeatureTerm,
    Key,
    Range,
)
from dyknow_semantics.annotations.annotation_store import AnnotationStore
from dyknow_semantics.annotations.checking import (
    AnnotationFaults,
    Origin,
    check_annotation,
    check_annotations,
    check_concept,
    check_fields,
    origins_of,
)
from dyknow_semantics.annotations.parsing import parse_annotations, parse_concept
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.matching.matching import Matcher, match
from dyknow_semantics.matching.specifications import Match
from dyknow_semantics.ontology.bridges import (
    Bridge,
    Relation,
    bridge_triple,
    bridged,
    parse_bridges,
)
from dyknow_semantics.ontology.features import FeatureSignature
from dyknow_semantics.ontology.knowledge import ALL_TRIPLES, Knowledge, Triple
from dyknow_semantics.ontology.ontology import Ontology
from dyknow_semantics.ontology.reasoner import Reasoner, ReasonerProcess
from dyknow_semantics.ontology.terms import void_statements
from dyknow_semantics.ontology.vocabulary import UPPER_ONTOLOGY

__all__ = [
    'ALL_TRIPLES',
    'UPPER_ONTOLOGY',
    'Annotation',
    'AnnotationFaults',
    'AnnotationStore',
    'Bridge',
    'Concept',
    'Content',
    'FeatureArgument',
    'FeatureSignature',
    'FeatureTerm',
    'Key',
    'Knowledge',
    'Match',
    'Matcher',
    'Ontology',
    'Origin',
    'Range',
    'Reasoner',
    'ReasonerProcess',
    'Relation',
    'SemanticsError',
    'Triple',
    'bridge_triple',
    'bridged',
    'check_annotation',
    'check_annotations',
    'check_concept',
    'check_fields',
    'match',
    'origins_of',
    'parse_annotations',
    'parse_bridges',
    'parse_concept',
    'void_statements',
]
