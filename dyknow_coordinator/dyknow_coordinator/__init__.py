"""Coordination: ground formulas, run their evaluations and report the answers."""

from dyknow_common import StandingVerdicts, ViolationEpisode
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation import (
    FOLLOWED,
    Answer,
    EvaluationPhase,
    Progress,
)
from dyknow_coordinator.grounding.candidate_search import (
    CandidateSearch,
    check_symbols,
    feature_symbols,
    sort_names,
)
from dyknow_coordinator.grounding.compared_objects import check_compared_objects
from dyknow_coordinator.grounding.completion import completed
from dyknow_coordinator.grounding.declared_properties import unknown_features
from dyknow_coordinator.grounding.feature_sources import (
    Candidates,
    FeatureSource,
    Grounding,
    SymbolGrounding,
    parse_sources,
    with_caveat,
)
from dyknow_coordinator.grounding.known_streams import (
    KnownStream,
    KnownStreams,
    field_names,
    stream_topic,
)
from dyknow_coordinator.grounding.region_relations import ground_features
from dyknow_coordinator.grounding.source_session import (
    EXCLUSION_NS,
    SILENCE_LIMIT_NS,
    SILENCE_LIMITS_S,
    TRANSIENT,
    SourceChoice,
    SourceSession,
    StandbySources,
    StateFault,
    describe_sources,
    describe_violation,
    worst_fault,
)
from dyknow_coordinator.grounding.state_specification import FormulaInputs, state_specification
from dyknow_coordinator.grounding.units import feature_units, with_unit, with_units
from dyknow_coordinator.plan import (
    Event,
    FormulaPosition,
    Holds,
    Plan,
    PlanAction,
    PlanExecution,
    PlanFormula,
    PlanOutcome,
    PlanPhase,
    PlanVerdict,
)
from dyknow_coordinator.reporting.evaluation_status import (
    EvaluationStatus,
    Level,
    as_reported,
    diagnose,
)
from dyknow_coordinator.reporting.node_status import has_loaded
from dyknow_coordinator.reporting.peer_reasons import (
    PEER_VERDICT,
    PEER_WAITS,
    with_reasons_of_peers,
    with_waits_of_peers,
)
from dyknow_coordinator.reporting.verdict_topics import verdict_token
from dyknow_coordinator.retries import Retries

__all__ = [
    'EXCLUSION_NS',
    'FOLLOWED',
    'PEER_VERDICT',
    'PEER_WAITS',
    'SILENCE_LIMITS_S',
    'SILENCE_LIMIT_NS',
    'TRANSIENT',
    'Answer',
    'CandidateSearch',
    'Candidates',
    'CoordinationError',
    'EvaluationPhase',
    'EvaluationStatus',
    'Event',
    'FeatureSource',
    'FormulaInputs',
    'FormulaPosition',
    'Grounding',
    'Holds',
    'KnownStream',
    'KnownStreams',
    'Level',
    'Plan',
    'PlanAction',
    'PlanExecution',
    'PlanFormula',
    'PlanOutcome',
    'PlanPhase',
    'PlanVerdict',
    'Progress',
    'Retries',
    'SourceChoice',
    'SourceSession',
    'StandbySources',
    'StandingVerdicts',
    'StateFault',
    'SymbolGrounding',
    'ViolationEpisode',
    'as_reported',
    'check_compared_objects',
    'check_symbols',
    'completed',
    'describe_sources',
    'describe_violation',
    'diagnose',
    'feature_symbols',
    'feature_units',
    'field_names',
    'ground_features',
    'has_loaded',
    'parse_sources',
    'sort_names',
    'state_specification',
    'stream_topic',
    'unknown_features',
    'verdict_token',
    'with_caveat',
    'with_reasons_of_peers',
    'with_unit',
    'with_units',
    'with_waits_of_peers',
    'worst_fault',
]
