"""Corrections of what other languages write, and of misspelt words, for messages about errors."""

from __future__ import annotations

import re
from collections.abc import Mapping
from difflib import get_close_matches
from types import MappingProxyType
from typing import Final

from dyknow_common.errors import shortened

_TOKEN: Final = re.compile(r'[A-Za-z_]\w*|[=&|!<>~-]+')
_TOPIC: Final = re.compile(
    r"['\u2018\u201c](?P<quoted>[\w/]+)['\u2019\u201d]|(?P<bare>/[A-Za-z_][\w/]*)"
)
"""A topic, or another name, as it must not be written: in other quotes, or in none."""

_BETWEEN: Final = re.compile(r'[\s(\[]*')
_NEAR: Final = 30
"""The number of characters around an error in which the mistake is looked for."""

_SIMILARITY: Final = 0.8

_NUMBERS: Final = {
    r'(?<![0-9])\.([0-9]+)': r'did you mean 0.\1 instead of .\1?',
    r'\b([0-9]+)\.(?![0-9])': r'did you mean \1.0 instead of \1.?',
    r'\+\s*([0-9.]+)': r'numbers have no sign +: write \1',
    r'(?<![(\[])\b([0-9]+),([0-9]+)\b': r'did you mean \1.\2 instead of \1,\2?',
}
"""Advice on numbers, which all languages write alike."""


def correction(
    text: str,
    offset: int,
    corrections: Mapping[str, str],
    advice: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """Return a question about the mistake at an error, such as `did you mean 'and' ...?`.

    In `G(p > q)`, the error is at `>`, as `G(p` may begin a predicate: names of operators before an
    open parenthesis are mistakes, too.

    Args:
        text: the text with the error.
        offset: of what was unexpected; the mistake stands there, or before it as in `alway p`.
        corrections: what is meant, by mistake. Words close to what is meant are mistakes too.
        advice: what to write instead of mistakes that are more than a word. The keys are regular
            expressions of mistakes, and the values may refer to their groups.

    Returns:
        An empty text if no mistake is known.
    """
    if topic := _TOPIC.match(text, offset):
        return f'did you mean "{topic["quoted"] or topic["bare"]}" instead of {topic[0]}?'
    meant = sorted(set(corrections.values()))
    near = [*_TOKEN.finditer(text, max(0, offset - _NEAR), offset + _NEAR)]
    for each in reversed(near):
        is_at_error = each.start() <= offset < each.end()
        is_before = each.end() <= offset and _BETWEEN.fullmatch(text, each.end(), offset)
        if (is_at_error or is_before) and each[0] not in meant:
            close = get_close_matches(each[0], meant, 1, _SIMILARITY)
            if found := corrections.get(each[0], *close or ['']):
                return _question(found, each[0])
        if each[0] in corrections and _is_inside(text[each.end() : offset]):
            return _question(corrections[each[0]], each[0])
    return _advice(text, offset, {**advice, **_NUMBERS})


def _advice(text: str, offset: int, advice: Mapping[str, str]) -> str:
    """Return the advice on a mistake that contains an error, or ends before it."""
    for mistake, what in advice.items():
        for match in re.compile(mistake).finditer(text, max(0, offset - _NEAR), offset + _NEAR):
            is_before = match.end() <= offset and _BETWEEN.fullmatch(text, match.end(), offset)
            if match.start() <= offset and (match.end() > offset or is_before):
                return match.expand(what)
    return ''


def _is_inside(text: str) -> bool:
    """Return True if a text begins with a parenthesis that it does not close."""
    return text.lstrip().startswith('(') and text.count('(') > text.count(')')


def _question(meant: str, mistake: str) -> str:
    return f"did you mean '{meant}' instead of '{shortened(mistake)}'?"
