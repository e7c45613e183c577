"""Grounding formulas, running their evaluations and answering."""

from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation import Evaluation, Outcome, Phase, Verdict
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
    'Evaluation',
    'Grounding',
    'Outcome',
    'Phase',
    'Source',
    'Symbol',
    'SymbolKind',
    'Verdict',
    'check_grounding',
    'choose',
    'concept_of',
    'features',
    'referenced',
    'sorts',
    'sources',
    'state_specification',
]
