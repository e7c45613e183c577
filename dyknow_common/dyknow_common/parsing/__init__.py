"""Parsing that all languages share: positions, errors with a caret, constraints, one parser class.

A language consists of a lark grammar (LALR), which imports terminals and rules from `common.lark`,
and of a builder: a lark transformer that makes the abstract syntax. An error in a text shows where
it is and what the grammar accepts there:

    stream specification:1:8: unexpected 'where', expected a field or a quoted text
      select where b = 1
             ^
"""

from dyknow_common.parsing.language import Language
from dyknow_common.parsing.positions import (
    NOWHERE,
    LanguageError,
    PositionedError,
    SyntaxNode,
    TextPosition,
    position_at,
    without_generated_text,
)
from dyknow_common.parsing.syntax_builders import (
    ConstraintBuilder,
    Syntax,
    SyntaxBuilder,
    builder,
    comparison_value,
    distinct_settings,
    duration_value,
    number_value,
    quoted,
    text_value,
)

__all__ = [
    'NOWHERE',
    'ConstraintBuilder',
    'Language',
    'LanguageError',
    'PositionedError',
    'Syntax',
    'SyntaxBuilder',
    'SyntaxNode',
    'TextPosition',
    'builder',
    'comparison_value',
    'distinct_settings',
    'duration_value',
    'number_value',
    'position_at',
    'quoted',
    'text_value',
    'without_generated_text',
]
