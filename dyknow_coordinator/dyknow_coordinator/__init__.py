"""Grounding formulas, running their evaluations and answering."""

from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation.answer import Answer, Progress
from dyknow_coordinator.evaluation.evaluation import Evaluation, EvaluationOutcome, EvaluationPhase
from dyknow_coordinator.evaluation.request import EvaluationRequest
from dyknow_coordinator.grounding.ground import SymbolGrounding
from dyknow_coordinator.grounding.grounding import (
    Candidates,
    FeatureSource,
    Grounding,
    check_grounding,
    concept_of,
    features,
    only_field,
    referenced,
    sorts,
    sources,
    state_specification,
)
from dyknow_coordinator.plans.plan import (
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
    Step,
)
from dyknow_coordinator.reporting.evaluation_status import (
    Diagnosis,
    EvaluationStatus,
    Level,
    details,
    diagnose,
    outcome,
)

__all__ = [
    'Answer',
    'Candidates',
    'CoordinationError',
    'Diagnosis',
    'Evaluation',
    'EvaluationOutcome',
    'EvaluationPhase',
    'EvaluationRequest',
    'EvaluationStatus',
    'Event',
    'FeatureSource',
    'FormulaPosition',
    'Grounding',
    'Holds',
    'Level',
    'Plan',
    'PlanAction',
    'PlanExecution',
    'PlanFormula',
    'PlanOutcome',
    'PlanPhase',
    'PlanVerdict',
    'Progress',
    'Step',
    'SymbolGrounding',
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
