"""Coordination: ground formulas, run their evaluations and report the answers."""

from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation.answer import Answer, Progress
from dyknow_coordinator.evaluation.evaluation import EvaluationPhase
from dyknow_coordinator.grounding.feature_sources import Grounding, SymbolGrounding
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
)
from dyknow_coordinator.reporting.evaluation_status import EvaluationStatus, Level, diagnose

__all__ = [
    'Answer',
    'CoordinationError',
    'EvaluationPhase',
    'EvaluationStatus',
    'Event',
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
    'SymbolGrounding',
    'diagnose',
]
