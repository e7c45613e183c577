"""Metric temporal logic over streams of states: its language, progression, formula groups."""

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.formula import Formula, Interval
from dyknow_reasoning.parsing import parse_formula

__all__ = ['Formula', 'Interval', 'ReasoningError', 'parse_formula']
