"""Grounding formulas, running their evaluations and answering."""

from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation import Evaluation, Outcome, Phase, Verdict
from dyknow_coordinator.evaluation_status import (
    Diagnosis,
    EvaluationPhase,
    EvaluationStatus,
    Level,
    SymbolGrounding,
    details,
    diagnose,
    outcome,
)
from dyknow_coordinator.grounding import (
    Grounding,
    Source,
    Symbol,
    SymbolKind,
    check_grounding,
    choose,
    concept_of,
    features,
    referenced,
    sorts,
    sources,
    state_specification,
)

__all__ = [
    'CoordinationError',
    'Diagnosis',
    'Evaluation',
    'EvaluationPhase',
    'EvaluationStatus',
    'Grounding',
    'Level',
    'Outcome',
    'Phase',
    'Source',
    'Symbol',
    'SymbolGrounding',
    'SymbolKind',
    'Verdict',
    'check_grounding',
    'choose',
    'concept_of',
    'details',
    'diagnose',
    'features',
    'outcome',
    'referenced',
    'sorts',
    'sources',
    'state_specification',
]
