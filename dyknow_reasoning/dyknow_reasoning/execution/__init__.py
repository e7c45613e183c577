"""Progression of all instances of the formulas of a group, as fast as possible.

`InstanceMonitor` takes the instances and the states, and returns the outcomes of formulas. All
ways to progress give identical results; the monitor chooses the fastest one. The modules are in
`docs/architecture.md`.
"""

from dyknow_reasoning.execution.aggregation import Outcome, Outcomes
from dyknow_reasoning.execution.automata.instance_states import (
    DecidingMoment,
    FormulaInstance,
    InstanceState,
    InstanceVerdict,
)
from dyknow_reasoning.execution.automata.readers import quick_reader
from dyknow_reasoning.execution.instance_monitor import InstanceMonitor
from dyknow_reasoning.execution.past.histories import Histories, PastValues
from dyknow_reasoning.execution.past.past_comparisons import past_terms, value_field
from dyknow_reasoning.execution.past.spatial_registers import SpatialTruths, link_lengths
from dyknow_reasoning.execution.probability.formula_probability import (
    FormulaProbability,
    probability_of,
)
from dyknow_reasoning.execution.recording import Recording
from dyknow_reasoning.execution.standing.standing_monitor import KEPT_FAILURES, StandingMonitor
from dyknow_reasoning.execution.standing.verdicts import Failure, VerdictLog
from dyknow_reasoning.execution.unknown.possible_formulas import (
    PossibleFormula,
    PossibleFormulas,
    PossibleVerdict,
)

__all__ = [
    'KEPT_FAILURES',
    'DecidingMoment',
    'Failure',
    'FormulaInstance',
    'FormulaProbability',
    'Histories',
    'InstanceMonitor',
    'InstanceState',
    'InstanceVerdict',
    'Outcome',
    'Outcomes',
    'PastValues',
    'PossibleFormula',
    'PossibleFormulas',
    'PossibleVerdict',
    'Recording',
    'SpatialTruths',
    'StandingMonitor',
    'VerdictLog',
    'link_lengths',
    'past_terms',
    'probability_of',
    'quick_reader',
    'value_field',
]
