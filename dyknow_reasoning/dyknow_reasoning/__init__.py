"""Metric temporal logic over streams of states: its language, progression, formula groups."""

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.formula import Formula, Interval, Reference
from dyknow_reasoning.formula_group import DEFAULT_NODE_LIMIT, FormulaGroup, NamedFormula
from dyknow_reasoning.parsing import parse_formula
from dyknow_reasoning.results import FormulaResult, Verdict
from dyknow_reasoning.symbols import Symbol, SymbolKind, symbols_of
from dyknow_reasoning.type_checking import Kind, check_types

__all__ = [
    'DEFAULT_NODE_LIMIT',
    'Formula',
    'FormulaGroup',
    'FormulaResult',
    'Interval',
    'Kind',
    'NamedFormula',
    'ReasoningError',
    'Reference',
    'Symbol',
    'SymbolKind',
    'Verdict',
    'check_types',
    'parse_formula',
    'symbols_of',
]
