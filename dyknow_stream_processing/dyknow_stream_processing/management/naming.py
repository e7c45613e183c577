"""Names of streams, and the convention that relates them to topics (paper, VI-A.2)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from dyknow_common import FUNCTIONS, MAX_TOPIC_LENGTH, LanguageError, shortened
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.parsing import parse_specification
from dyknow_stream_processing.language.specification import SinkDeclaration, StreamReference

WATERMARKS_NAME: Final = '_watermarks'
"""The last part of the topic for the watermarks of an engine, beside its streams' topics."""

_PLACEHOLDER: Final = '<name>'


def check_name(name: str) -> None:
    """Check that a specification can refer to a stream by a name.

    Raises:
        StreamError: if it cannot.
    """
    if len(name) > MAX_TOPIC_LENGTH:
        raise StreamError(
            f"the stream '{shortened(name)}' cannot be the name of a topic: it has more than "
            f'{MAX_TOPIC_LENGTH} characters, the limit of DDS'
        )
    if name in FUNCTIONS:
        raise StreamError(
            f"'{name}' cannot be the name of a stream: formulas would take it for a function"
        )
    if name == WATERMARKS_NAME:
        raise StreamError(f"'{name}' cannot be the name of a stream: it is the topic of watermarks")
    if name.endswith("'") or not _is_word(name):
        raise StreamError(
            f"'{shortened(name)}' cannot be the name of a stream; use letters, digits and _, "
            'beginning with no digit, and no keyword of the stream language'
        )


@lru_cache(maxsize=10_000)
def _is_word(name: str) -> bool:
    """Return True if a name is one in the stream language."""
    try:
        declarations = parse_specification(f'sink {name}').declarations
    except LanguageError:
        return False
    return declarations == (SinkDeclaration(StreamReference(name)),)


@dataclass(frozen=True, slots=True)
class NamingConvention:
    """Topics of streams that were neither created nor registered, such as `dyknow/streams/<name>`.

    Raises:
        StreamError: if the pattern does not contain `<name>` once.
    """

    pattern: str

    def __post_init__(self) -> None:
        if self.pattern.count(_PLACEHOLDER) != 1:
            raise StreamError(
                f"naming convention '{shortened(self.pattern)}' must hold {_PLACEHOLDER} once, "
                f'such as dyknow/streams/{_PLACEHOLDER}'
            )

    def topic(self, name: str) -> str:
        """Return the topic of a stream; it is relative if the pattern is."""
        return self.pattern.replace(_PLACEHOLDER, name)

    def name(self, topic: str) -> str | None:
        """Return the possible name of the stream of an absolute topic; `None` if it has none."""
        before, after = self.pattern.split(_PLACEHOLDER)
        _, found, name = topic.removesuffix(after).rpartition('/' + before.lstrip('~/'))
        if not found or not topic.endswith(after):
            return None
        try:
            check_name(name)
        except StreamError:
            return None
        return name

    def matches(self, name: str, topic: str) -> bool:
        """Return True if the topic carries a stream, in any namespace."""
        return f'/{topic}'.endswith('/' + self.topic(name).lstrip('/'))
