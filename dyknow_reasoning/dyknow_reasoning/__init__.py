"""Metric temporal logic over streams of states: its language, progression, formula groups."""

from dyknow_reasoning.check import CheckResult, check_trace
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.formula import (
    Always,
    And,
    Comparison,
    Feature,
    Forall,
    Formula,
    Interval,
    Number,
    Reference,
)
from dyknow_reasoning.formula_group import DEFAULT_NODE_LIMIT, FormulaGroup
from dyknow_reasoning.named_formula import NamedFormula
from dyknow_reasoning.parsing import parse_formula
from dyknow_reasoning.results import FormulaResult, Verdict
from dyknow_reasoning.symbols import Symbol, SymbolKind, symbols_of
from dyknow_reasoning.trace import RecordedState, read_trace
from dyknow_reasoning.type_checking import Kind, check_types

__all__ = [
    'DEFAULT_NODE_LIMIT',
    'Always',
    'And',
    'CheckResult',
    'Comparison',
    'Feature',
    'Forall',
    'Formula',
    'FormulaGroup',
    'FormulaResult',
    'Interval',
    'Kind',
    'NamedFormula',
    'Number',
    'ReasoningError',
    'RecordedState',
    'Reference',
    'Symbol',
    'SymbolKind',
    'Verdict',
    'check_trace',
    'check_types',
    'parse_formula',
    'read_trace',
    'symbols_of',
]
