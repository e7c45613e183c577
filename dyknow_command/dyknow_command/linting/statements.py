"""All syntax errors of a text whose statements are separated by `;`."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Final

from dyknow_command.linting.findings import FilePlace, Finding, error_at
from dyknow_common import LanguageError, position_at

MAX_STATEMENT_FAULTS: Final = 50
"""The number of faults in one text after which no more are looked for."""

_PART: Final = re.compile(r'"(?:\\.|[^"\\\n])*"|#[^\n]*|;|[^"#;]+')


def syntax_findings(
    parse: Callable[[str], object], text: str, place: FilePlace
) -> Iterator[Finding]:
    """Yield the syntax errors of a text; of each statement the first.

    Args:
        parse: raises LanguageError.
        text: the text.
        place: where it begins.
    """
    try:
        parse(text)
    except LanguageError as error:
        whole = error
    else:
        return
    count = 0
    for offset, statement in _statements(text):
        try:
            parse(statement)
        except LanguageError as error:
            count += 1
            yield error_at(place.moved(position_at(text, offset)), error)
        if count >= MAX_STATEMENT_FAULTS:
            return
    if not count:
        yield error_at(place, whole)


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """Yield each statement that has more than space and comments, with its offset."""
    begin = position = 0
    is_empty = True
    while found := _PART.match(text, position):
        position = found.end()
        if found[0] != ';':
            is_empty = is_empty and (found[0][0] == '#' or found[0].isspace())
            continue
        if not is_empty:
            yield begin, text[begin:position]
        begin, is_empty = position, True
    if not is_empty or position < len(text):
        yield begin, text[begin:]
