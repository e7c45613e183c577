"""The parts that every package of DyKnow shares."""

from dyknow_common.constraints import (
    CONSTRAINT_KINDS,
    NO_CONSTRAINTS,
    StreamConstraints,
)
from dyknow_common.durations import (
    NANOSECONDS,
    SECOND_NS,
    format_duration,
    format_time,
    parse_duration,
    round_duration,
    round_time,
)
from dyknow_common.errors import DyKnowError, ExitCode
from dyknow_common.field_paths import absence, all_elements, listed_as
from dyknow_common.parsing import (
    NOWHERE,
    ConstraintBuilder,
    Language,
    LanguageError,
    PositionedError,
    SyntaxNode,
    TextPosition,
    builder,
    distinct_settings,
    duration_value,
    quoted,
    text_value,
)
from dyknow_common.reserved_words import FORMULA_WORDS, SSL_WORDS
from dyknow_common.symbol import Symbol, SymbolKind
from dyknow_common.text_files import open_text, read_file, read_text
from dyknow_common.units import check_unit, unit_conversion
from dyknow_common.values import Value, ValueType
from dyknow_common.verdict import Verdict

__all__ = [
    'CONSTRAINT_KINDS',
    'FORMULA_WORDS',
    'NANOSECONDS',
    'NOWHERE',
    'NO_CONSTRAINTS',
    'SECOND_NS',
    'SSL_WORDS',
    'ConstraintBuilder',
    'DyKnowError',
    'ExitCode',
    'Language',
    'LanguageError',
    'PositionedError',
    'StreamConstraints',
    'Symbol',
    'SymbolKind',
    'SyntaxNode',
    'TextPosition',
    'Value',
    'ValueType',
    'Verdict',
    'absence',
    'all_elements',
    'builder',
    'check_unit',
    'distinct_settings',
    'duration_value',
    'format_duration',
    'format_time',
    'listed_as',
    'open_text',
    'parse_duration',
    'quoted',
    'read_file',
    'read_text',
    'round_duration',
    'round_time',
    'text_value',
    'unit_conversion',
]
