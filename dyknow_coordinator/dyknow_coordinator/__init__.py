"""Grounding formulas, running their evaluations and answering."""

from dyknow_coordinator.answer import Answer, Progress
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation import Evaluation, EvaluationPhase, Outcome, Verdict
from dyknow_coordinator.evaluation_status import (
    Diagnosis,
    EvaluationStatus,
    Level,
    SymbolGrounding,
    details,
    diagnose,
    outcome,
)
from dyknow_coordinator.grounding import (
    Candidates,
    Grounding,
    Source,
    Symbol,
    SymbolKind,
    check_grounding,
    concept_of,
    features,
    only_field,
    referenced,
    sorts,
    sources,
    state_specification,
)
from dyknow_coordinator.question import Question

__all__ = [
    'Candidates',
    'Answer',
    'CoordinationError',
    'Diagnosis',
    'Evaluation',
    'EvaluationPhase',
    'EvaluationStatus',
    'Grounding',
    'Level',
    'Outcome',
    'Question',
    'Progress',
    'Source',
    'Symbol',
    'SymbolGrounding',
    'SymbolKind',
    'Verdict',
    'check_grounding',
    'concept_of',
    'details',
    'diagnose',
    'features',
    'only_field',
    'outcome',
    'referenced',
    'sorts',
    'sources',
    'state_specification',
]
