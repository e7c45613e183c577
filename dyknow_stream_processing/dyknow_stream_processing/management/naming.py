"""Names of streams, and the convention by which they name topics (paper, VI-A.2)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from dyknow_common import LanguageError
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.parsing import parse_specification

_NAME = re.compile(r'[A-Za-z][A-Za-z0-9_]*')
_PLACEHOLDER: Final = '<name>'


def check_name(name: str) -> None:
    """Checks that a text of the stream language can mention a stream by a name.

    Raises:
        StreamError: when it cannot.
    """
    if not _NAME.fullmatch(name):
        raise StreamError(
            f"'{name}' cannot be the name of a stream; use letters, digits and _, "
            f'beginning with a letter'
        )
    try:
        parse_specification(f'sink {name}')
    except LanguageError:
        raise StreamError(
            f"'{name}' cannot be the name of a stream, for it is a word of the stream language"
        ) from None


@dataclass(frozen=True, slots=True)
class NamingConvention:
    """The topic of a stream that nobody named explicitly, such as `dyknow/streams/<name>`.

    Raises:
        StreamError: when the pattern does not hold `<name>` once.
    """

    pattern: str

    def __post_init__(self) -> None:
        if self.pattern.count(_PLACEHOLDER) != 1:
            raise StreamError(
                f"naming convention '{self.pattern}' must hold {_PLACEHOLDER} once, "
                f'such as dyknow/streams/{_PLACEHOLDER}'
            )

    def topic(self, name: str) -> str:
        """The topic of a stream, absolute or relative as the convention is."""
        return self.pattern.replace(_PLACEHOLDER, name)

    def holds(self, name: str, topic: str) -> bool:
        """Whether a topic is that of a stream in some namespace."""
        return f'/{topic}'.endswith('/' + self.topic(name).lstrip('/'))
