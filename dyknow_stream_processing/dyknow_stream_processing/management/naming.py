"""Names of streams and namespaces, and how they relate to topics (paper, VI-A.2)."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Self

from dyknow_common import FUNCTIONS, MAX_TOPIC_LENGTH, LanguageError, shortened
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.parsing import parse_once
from dyknow_stream_processing.language.specification import SinkDeclaration, StreamReference

WATERMARKS_NAME: Final = '_watermarks'
"""The last part of the topic for the watermarks of an engine, beside its streams' topics."""

_PLACEHOLDER: Final = '<name>'

_NAMESPACE: Final = re.compile(r'(/[A-Za-z_]\w*)*', re.ASCII)


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
        declarations = parse_once(f'sink {name}').declarations
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


@dataclass(frozen=True, slots=True)
class Namespaces:
    """Some namespaces and all below them.

    Args:
        names: the namespaces, absolute; the root namespace is empty.
    """

    names: tuple[str, ...] = ('',)

    @classmethod
    def of(cls, names: Iterable[str], own: str) -> Self:
        """Return the named namespaces, or the own one if none is named.

        Args:
            names: absolute, or relative to the own namespace.
            own: the namespace of the node.

        Raises:
            StreamError: naming an invalid namespace.
        """
        found = tuple(_absolute(each, own.rstrip('/')) for each in names if each)
        return cls(found or (own.rstrip('/'),))

    def contain(self, name: str) -> bool:
        """Return True if an absolute name of a node or a topic is in one of the namespaces."""
        return any(name.startswith(f'{each}/') for each in self.names)

    def __str__(self) -> str:
        return ', '.join(each or '/' for each in self.names)


def namespace_of(name: str) -> str:
    """Return `/robot1` for `/robot1/stream_processing_engine`; the root namespace is empty."""
    return name.rpartition('/')[0]


def _absolute(name: str, own: str) -> str:
    namespace = (name if name.startswith('/') else f'{own}/{name}').rstrip('/')
    if not _NAMESPACE.fullmatch(namespace):
        raise StreamError(
            f"engine_namespaces: '{name}' cannot be a namespace; write one such as /robot1"
        )
    return namespace
