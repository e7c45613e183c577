"""Metric temporal logic over streams of states: language, progression, formula groups."""

from dyknow_reasoning.check import CheckResult, check_trace
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.formula_group import FormulaGroup
from dyknow_reasoning.language.formula import (
    Always,
    And,
    Comparison,
    Feature,
    Forall,
    Formula,
    Interval,
    Number,
)
from dyknow_reasoning.language.parsing import parse_formula
from dyknow_reasoning.language.symbols import symbols_of
from dyknow_reasoning.language.type_checking import Kind, check_types
from dyknow_reasoning.progression.sizes import FormulaLimits
from dyknow_reasoning.results import FormulaResult
from dyknow_reasoning.trace import RecordedState, read_trace

__all__ = [
    'Always',
    'And',
    'CheckResult',
    'Comparison',
    'Feature',
    'Forall',
    'Formula',
    'FormulaGroup',
    'FormulaLimits',
    'FormulaResult',
    'Interval',
    'Kind',
    'Number',
    'ReasoningError',
    'RecordedState',
    'check_trace',
    'check_types',
    'parse_formula',
    'read_trace',
    'symbols_of',
]
