"""The parts that every package of DyKnow shares."""

from dyknow_common.constraints import (
    CONSTRAINT_KINDS,
    NO_CONSTRAINTS,
    StreamConstraints,
)
from dyknow_common.durations import (
    MAX_DIGITS,
    MAX_DURATION_NS,
    NANOSECONDS,
    SECOND_NS,
    format_duration,
    format_time,
    parse_duration,
    round_duration,
    round_time,
)
from dyknow_common.errors import DyKnowError, ExitCode, listed, shortened
from dyknow_common.field_paths import absence, all_elements, listed_as
from dyknow_common.limits import (
    MAX_CHARACTERS,
    MAX_DEPTH,
    MAX_FORMULA_PARTS,
    MAX_STREAM_PARTS,
    MAX_WORDS,
)
from dyknow_common.parsing import (
    NOWHERE,
    ConstraintBuilder,
    Language,
    LanguageError,
    PositionedError,
    SyntaxBuilder,
    SyntaxNode,
    TextPosition,
    builder,
    comparison_value,
    distinct_settings,
    duration_value,
    number_value,
    quoted,
    text_value,
)
from dyknow_common.symbol import FORMULA_WORDS, FUNCTIONS, SSL_WORDS, Symbol, SymbolKind
from dyknow_common.text_files import open_text, read_file, read_text
from dyknow_common.units import check_unit, unit_conversion
from dyknow_common.values import Value, ValueType
from dyknow_common.verdict import Verdict

__all__ = [
    'CONSTRAINT_KINDS',
    'FORMULA_WORDS',
    'FUNCTIONS',
    'MAX_CHARACTERS',
    'MAX_DEPTH',
    'MAX_DIGITS',
    'MAX_DURATION_NS',
    'MAX_FORMULA_PARTS',
    'MAX_STREAM_PARTS',
    'MAX_WORDS',
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
    'SyntaxBuilder',
    'SyntaxNode',
    'TextPosition',
    'Value',
    'ValueType',
    'Verdict',
    'absence',
    'all_elements',
    'builder',
    'check_unit',
    'comparison_value',
    'distinct_settings',
    'duration_value',
    'format_duration',
    'format_time',
    'listed',
    'listed_as',
    'number_value',
    'open_text',
    'parse_duration',
    'quoted',
    'read_file',
    'read_text',
    'round_duration',
    'round_time',
    'shortened',
    'text_value',
    'unit_conversion',
]
