"""Metric temporal logic over streams of states: language, progression, formula groups."""

from dyknow_reasoning.check import CheckResult, add_domain_option, check_trace, read_domains
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution import (
    FormulaProbability,
    probability_of,
)
from dyknow_reasoning.explanation.explanation import objects_text
from dyknow_reasoning.formula_group import FormulaGroup
from dyknow_reasoning.language.constants import NO_CONSTANTS, Constants, literal_of
from dyknow_reasoning.language.formula import (
    Always,
    And,
    Comparison,
    Connective,
    Count,
    CountOf,
    Eventually,
    Exists,
    Forall,
    Formula,
    FutureFormula,
    Historically,
    Implies,
    Not,
    Once,
    Or,
    PastFormula,
    Previous,
    Since,
    StateAtom,
    Until,
    compares_past,
    first_complete,
    joined,
    looks_back,
    parts,
    walk,
    with_changed_parts,
)
from dyknow_reasoning.language.interval import Interval
from dyknow_reasoning.language.parsing import parse_constants, parse_formula, stated_units
from dyknow_reasoning.language.quantities import mixed_units
from dyknow_reasoning.language.soon import ForecastBound, ForecastFeature
from dyknow_reasoning.language.spatial import Over
from dyknow_reasoning.language.sugar import SPATIAL
from dyknow_reasoning.language.symbols import symbols_of
from dyknow_reasoning.language.terms import (
    Arithmetic,
    Bounded,
    Feature,
    FieldReference,
    Function,
    Number,
    Object,
    PastTerm,
    Probability,
    Quantifier,
    Quantity,
    Sampled,
    Term,
    TextLiteral,
    Truth,
    Uncertain,
    Variable,
)
from dyknow_reasoning.language.type_checking import (
    Kind,
    asks_for_probability,
    best_estimate,
    check_types,
    is_uncertain,
)
from dyknow_reasoning.language.writing import as_written
from dyknow_reasoning.notes import FormulaNote, notes_on
from dyknow_reasoning.progression.atoms import CALCULATE, Values
from dyknow_reasoning.progression.functions import call_function_on_vectors
from dyknow_reasoning.progression.instances import Domains, ground_atoms
from dyknow_reasoning.progression.sizes import FormulaLimits
from dyknow_reasoning.progression.unknown_features import (
    ALL_KNOWN,
    ANY_NUMBER,
    Range,
    UnknownFeatures,
    UnknownValueError,
    is_unknown,
)
from dyknow_reasoning.results import FormulaResult
from dyknow_reasoning.standing import FailureEpisode, start_verdicts
from dyknow_reasoning.state_line import Breach, ReadStream, StateLine
from dyknow_reasoning.trace import RecordedState, read_trace
from dyknow_reasoning.trial import TrialFormula, asked_of_each_state, check_trial

__all__ = [
    'ALL_KNOWN',
    'ANY_NUMBER',
    'CALCULATE',
    'NO_CONSTANTS',
    'SPATIAL',
    'Always',
    'And',
    'Arithmetic',
    'Bounded',
    'Breach',
    'CheckResult',
    'Comparison',
    'Connective',
    'Constants',
    'Count',
    'CountOf',
    'Domains',
    'Eventually',
    'Exists',
    'FailureEpisode',
    'Feature',
    'FieldReference',
    'Forall',
    'ForecastBound',
    'ForecastFeature',
    'Formula',
    'FormulaGroup',
    'FormulaLimits',
    'FormulaNote',
    'FormulaProbability',
    'FormulaResult',
    'Function',
    'FutureFormula',
    'Historically',
    'Implies',
    'Interval',
    'Kind',
    'Not',
    'Number',
    'Object',
    'Once',
    'Or',
    'Over',
    'PastFormula',
    'PastTerm',
    'Previous',
    'Probability',
    'Quantifier',
    'Quantity',
    'Range',
    'ReadStream',
    'ReasoningError',
    'RecordedState',
    'Sampled',
    'Since',
    'StateAtom',
    'StateLine',
    'Term',
    'TextLiteral',
    'TrialFormula',
    'Truth',
    'Uncertain',
    'UnknownFeatures',
    'UnknownValueError',
    'Until',
    'Values',
    'Variable',
    'add_domain_option',
    'as_written',
    'asked_of_each_state',
    'asks_for_probability',
    'best_estimate',
    'call_function_on_vectors',
    'check_trace',
    'check_trial',
    'check_types',
    'compares_past',
    'first_complete',
    'ground_atoms',
    'is_uncertain',
    'is_unknown',
    'joined',
    'literal_of',
    'looks_back',
    'mixed_units',
    'notes_on',
    'objects_text',
    'parse_constants',
    'parse_formula',
    'parts',
    'probability_of',
    'read_domains',
    'read_trace',
    'start_verdicts',
    'stated_units',
    'symbols_of',
    'walk',
    'with_changed_parts',
]
