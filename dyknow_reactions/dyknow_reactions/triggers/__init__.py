"""Triggers: what is done when the verdict on a formula changes, when, and how it went."""

from dyknow_reactions.triggers.events import FormulaEvents, TriggerReport
from dyknow_reactions.triggers.runs import TriggerAttempt, TriggerRuns, TriggerState, TriggerUse

__all__ = [
    'FormulaEvents',
    'TriggerAttempt',
    'TriggerReport',
    'TriggerRuns',
    'TriggerState',
    'TriggerUse',
]
