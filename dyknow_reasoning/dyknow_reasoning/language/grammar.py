"""The grammar of formulas."""

from __future__ import annotations

from typing import Final

from dyknow_common import FORMULA_WORDS, NANOSECONDS, SOURCE_FIELDS, Language

_OPERATOR = 'an operator'
_FORMULA = 'a formula'
_SPELLINGS: Final = {
    # A terminal with an underscore is no child of its rule: a word between two operands.
    **{word.upper(): _FORMULA for word in FORMULA_WORDS},
    **{f'_{word.upper()}': _OPERATOR for word in FORMULA_WORDS},
    **dict.fromkeys(('_IMPLIES', '_EQUIVALENT', '_HOLDS_UNTIL', 'COMPARISON'), _OPERATOR),
    **dict.fromkeys(('PLUS', 'TIMES', 'DIVIDED_BY', '_TO_THE'), _OPERATOR),
    **dict.fromkeys(
        ('STRING', 'REFERENCE', 'QUOTED_REFERENCE', 'FUNCTION', 'MESSAGE_CONSTANT'), _FORMULA
    ),
    'BUILT_IN_REFERENCE': _FORMULA,
    'UNIT': 'a unit',
    'DURATION': 'a duration such as 5 s',
    'INFINITY': "'inf'",
    '_IN': "'in'",
    '_LET': _FORMULA,
    'COUNT': _FORMULA,
    'SOON': _FORMULA,
    '_OF': "'of'",
    '_FOR': _OPERATOR,
    **dict.fromkeys(('SPATIAL', '_OVER', '_DELAUNAY'), _FORMULA),
    **dict.fromkeys(('REACH', 'SURROUND', '_BY'), _OPERATOR),
    '_FROM': "'from'",
    '_TO': "'to'",
}

_CORRECTIONS: Final = {
    **dict.fromkeys(('&', '&&', 'AND'), 'and'),
    **dict.fromkeys(('||', 'OR'), 'or'),
    **dict.fromkeys(('!', '~', 'NOT'), 'not'),
    '=>': "->' or '>=",
    **dict.fromkeys(('==>', '-->', 'implies'), '->'),
    **dict.fromkeys(('<=>', '<==>', 'iff'), '<->'),
    'xor': 'not (p <-> q)',
    'for': 'always[0 s, 5 s] p',
    **dict.fromkeys(('G', 'globally', 'ALWAYS'), 'always'),
    **dict.fromkeys(('F', 'finally', 'EVENTUALLY'), 'eventually'),
    **dict.fromkeys(('all', 'FORALL'), 'forall'),
    **dict.fromkeys(('some', 'EXISTS'), 'exists'),
    **dict.fromkeys(('H', 'HISTORICALLY'), 'historically'),
    **dict.fromkeys(('O', 'ONCE'), 'once'),
    **dict.fromkeys(('Y', 'PREVIOUS'), 'previous'),
    **dict.fromkeys(('S', 'SINCE'), 'since'),
    **dict.fromkeys(('W', 'WU', 'weak_until'), 'unless'),
    **dict.fromkeys(('R', 'releases'), 'release'),
    'UNTIL': 'until',
    **dict.fromkeys(('avg', 'average'), 'mean'),
    **dict.fromkeys(('includes', 'has', 'CONTAINS'), 'contains'),
    **dict.fromkeys(('startswith', 'starts_with', 'begins'), 'starts with'),
    '==': '=',
    '=<': '<=',
    '<>': '!=',
}
"""Words of other languages, and mistakes; for an unknown word, the closest word is proposed."""

_BEFORE_OPERAND: Final = rf'(?:^|[^\w\s)\]"]|\b(?:{"|".join(FORMULA_WORDS)}))\s*'

_ADVICE: Final = {
    rf'{_BEFORE_OPERAND}\|[^|]+\|': "write an absolute value as 'abs(x)'",
    r'\|': "did you mean 'or' instead of '|'?",
    r'\bdelaunay\s*\([^()]*': (
        "'delaunay' stands first in the links: over (delaunay(East[a], North[a]) for a, b in Robot)"
    ),
    r'\b(?i:if|when|whenever|then|else)\b(?:\s*\([^()]*)?': "write 'p -> q' for 'if p then q'",
    r'\b(?:X|next)\b(?:\s*\([^()]*)?': "there is no 'next': write 'eventually(0 s, 1 s] p'",
    r'\bsoon\b': "write how far to look ahead, as in 'soon[5 s] x > 3'",
    r'\bwithin\b': "write the time after the operator, as in 'eventually[0 s, 5 s] p'",
    r'(?<!-)[<>=≤≥≠]=?\s*[^\s<>=≤≥≠()]+\s*(?<!-)[<>=≤≥≠]': (
        "join comparisons with 'and': '0 < x and x < 5'"
    ),
    r'\bin\s*[\[(]': "write an interval of values as '0 <= x and x <= 5'",
    r'\*\s*\*': "write a power as 'x^2'",
    r'%|\bmod\b': "write a remainder as 'mod(x, 2)'",
    r'[-+*/<>=≤≥≠]\s*previous\b|\bprev\s+(?=[\w"])': "write the value before as 'prev(x)'",
    r"(?<=[\w'])\[\s*\]": 'write an argument, an index or a time between the brackets',
    r'\[\s*\]': "did you mean 'always' instead of '[]'?",
    r'[{}]': 'use round brackets',
    rf'\[(?:[^\[\]]*,)?\s*[0-9.]+\s*(?!(?:{"|".join(NANOSECONDS)})\b)[A-Za-zµ]+': (
        f'the units of times are {", ".join(NANOSECONDS)}'
    ),
    r'\b(?:tf|action|rate)\s*\(\s*"[^()]*': (
        'write tf("map", "base_link").yaw, action("/dock").name or rate("/scan", 2 s).hz'
    ),
    rf'\b(?!(?:{"|".join((*FORMULA_WORDS, *SOURCE_FIELDS))})\b)([A-Za-z]\w*)\s*\('
    r'(?:[^()]*,)?\s*-?[0-9](?=[\w.]*\s*[-+*/,)<=>])': (
        r"'\1' is no function, and the arguments of a feature are names of objects"
    ),
    rf'{_BEFORE_OPERAND}U\b': ("'U' is the operator 'until': rename the sort or feature"),
}
"""Corrections of mistakes that are more than a word."""

LANGUAGE: Final = Language(
    'formula',
    __package__,
    'formula.lark',
    _SPELLINGS,
    corrections=_CORRECTIONS,
    advice=_ADVICE,
)
