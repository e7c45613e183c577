"""The parts that every package of DyKnow shares."""

from dyknow_common.constraints import NO_CONSTRAINTS, StreamConstraints
from dyknow_common.durations import (
    DURATION_PATTERN,
    NANOSECONDS,
    SECOND_NS,
    format_duration,
    format_time,
    parse_duration,
    round_duration,
    round_time,
)
from dyknow_common.errors import DyKnowError, ExitCode
from dyknow_common.field_paths import FIELD_PATH, absence, all_elements, listed_as
from dyknow_common.parsing import NOWHERE, Language, LanguageError, TextPosition
from dyknow_common.symbol import Symbol, SymbolKind
from dyknow_common.text_files import read_file
from dyknow_common.units import check_unit, unit_conversion
from dyknow_common.values import Value, ValueType
from dyknow_common.verdict import Verdict

__all__ = [
    'DURATION_PATTERN',
    'FIELD_PATH',
    'NANOSECONDS',
    'NOWHERE',
    'NO_CONSTRAINTS',
    'SECOND_NS',
    'DyKnowError',
    'ExitCode',
    'Language',
    'LanguageError',
    'StreamConstraints',
    'Symbol',
    'SymbolKind',
    'TextPosition',
    'Value',
    'ValueType',
    'Verdict',
    'absence',
    'all_elements',
    'check_unit',
    'format_duration',
    'format_time',
    'listed_as',
    'parse_duration',
    'read_file',
    'round_duration',
    'round_time',
    'unit_conversion',
]
