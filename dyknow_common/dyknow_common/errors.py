"""The base of all errors of DyKnow, and their codes."""

from __future__ import annotations

import copyreg
import re
from collections.abc import Collection, Iterable
from difflib import get_close_matches
from enum import IntEnum
from pathlib import Path
from traceback import extract_tb
from typing import Any, Final

_MAX_QUOTED: Final = 100
"""The number of characters of a name or a text that a message quotes."""

_MAX_LISTED: Final = 20
"""The number of names that a message lists."""

_LONGEST_NUMBER: Final = 15
"""Digits of a count that a message shows in full."""

_LONG_QUOTATION: Final = re.compile(r"""(?<!\w)"[^"\n]{201,}"|(?<!\w)'[^'\n]{201,}'|\S{300,}""")
_CONTROL: Final = re.compile(
    '[\x00-\x1f\x7f-\x9f\xad\u0600-\u0605\u061c\u06dd\u070f\u0890\u0891\u08e2\u180e\u200b-\u200f'
    '\u2028-\u202e\u2060-\u206f\ud800-\udfff\ufeff\ufff9-\ufffb\U000110bd\U000110cd'
    '\U00013430-\U0001343f\U0001bca0-\U0001bca3\U0001d173-\U0001d17a\U000e0000-\U000e007f]'
)
"""Characters that change a terminal, are invisible (the categories Cc, Cf, Zl and Zp of Unicode),
or that no message of ROS holds."""

_CONTROL_IN_ERROR: Final = re.compile(rf'(?![\n\t]){_CONTROL.pattern}')


class ExitCode(IntEnum):
    """The outcome of a request; numbers as in dyknow_interfaces/msg/ExitStatus."""

    SUCCESS = 0
    INVALID_ARGUMENT = 1
    NOT_FOUND = 2
    ALREADY_EXISTS = 3
    UNAVAILABLE = 4
    CONSTRAINT_VIOLATION = 5
    TIMEOUT = 6
    CANCELLED = 7
    INTERNAL_ERROR = 8


def shortened(text: object, most: int = _MAX_QUOTED) -> str:
    """Return a text for a message; beyond `most` characters, only its beginning and its end."""
    found, half = str(text), most // 2
    return found if len(found) <= most else f'{found[:half]}…{found[-half:]}'


def printable(text: str) -> str:
    """Return a text from a message for people, with control characters escaped as in JSON."""
    return _CONTROL.sub(_escaped, text)


def _escaped(character: re.Match[str]) -> str:
    code = character[0].encode('utf-16-be', 'surrogatepass').hex()
    return ''.join(f'\\u{code[first : first + 4]}' for first in range(0, len(code), 4))


def visible(text: str) -> str:
    """Return a text of several lines without any other control characters."""
    return _CONTROL_IN_ERROR.sub('\ufffd', text)


def amount(count: int) -> str:
    """Return a count for a message; only the power of ten of one that is very long."""
    text = str(count)
    return text if len(text) <= _LONGEST_NUMBER else f'about 1e{len(text) - 1}'


def one_line(error: object) -> str:
    """Return the text of an error, as of the middleware, without its line breaks."""
    return ' '.join(str(error).split())


def listed(names: Iterable[object]) -> str:
    """Return names for a message: the first ones, and how many more there are."""
    found = list(names)
    is_short = len(found) <= _MAX_LISTED + 1  # "and 1 more" would be as long as its name.
    shown = ', '.join(shortened(name) for name in (found if is_short else found[:_MAX_LISTED]))
    return shown if is_short else f'{shown} and {len(found) - _MAX_LISTED} more'


def unknown(kind: str, name: str, known: Collection[str]) -> str:
    """Return the message about an unknown name, with the most similar known one."""
    similar = get_close_matches(name, known, n=1)
    others = f'use {listed(known)}' if known else 'there is none'
    hint = f"did you mean '{similar[0]}'?" if similar else others
    return f"unknown {kind} '{shortened(name)}'; {hint}"


class DyKnowError(Exception):
    """An error that DyKnow raises on purpose.

    Its message can be sent by ROS: long words and quotations in it are shortened.

    Args:
        message: names the thing at fault and the remedy.
        code: the exit status of a service that fails with this error.
    """

    def __init__(self, message: str, code: ExitCode = ExitCode.INVALID_ARGUMENT) -> None:
        brief = _LONG_QUOTATION.sub(lambda quotation: shortened(quotation[0]), message)
        super().__init__(visible(brief))
        self.code = code

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how it is pickled: a subclass may be constructed from something else."""
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__  # type: ignore[attr-defined]

    @property
    def message(self) -> str:
        """The text of the error."""
        return str(self)


def error_text(error: Exception) -> str:
    """Return the line that people read of an error; one of Python has its place in the code."""
    match error:
        case DyKnowError():
            return error.message
        case OSError(strerror=str(reason), filename=str() | Path() as name):
            return f'{name}: {reason}'
        case OSError():
            return error.strerror or str(error)
    *_, place = extract_tb(error.__traceback__)
    kind = type(error).__name__
    return f'internal error: {kind}: {error} ({place.filename}:{place.lineno}); please report it'
