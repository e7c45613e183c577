"""The grammar of formulas."""

from __future__ import annotations

from typing import Final

from dyknow_common import Language

_OPERATOR = 'an operator'
_FORMULA = 'a formula'
_SPELLINGS: Final = {
    **dict.fromkeys(('_AND', '_OR', '_IMPLIES', '_EQUIVALENT', '_UNTIL', 'COMPARISON'), _OPERATOR),
    **dict.fromkeys(('PLUS', 'TIMES', 'DIVIDED_BY'), _OPERATOR),
    **dict.fromkeys(('NOT', 'ALWAYS', 'EVENTUALLY', 'FORALL', 'EXISTS', 'TRUE', 'FALSE'), _FORMULA),
    **dict.fromkeys(('STRING', 'REFERENCE', 'QUOTED_REFERENCE', 'FUNCTION'), _FORMULA),
    'DURATION': 'a duration such as 5 s',
    'INFINITY': "'inf'",
    '_IN': "'in'",
}

LANGUAGE: Final = Language('formula', __package__, 'formula.lark', _SPELLINGS)
