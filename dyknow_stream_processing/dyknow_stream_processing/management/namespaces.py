"""Namespaces of the engines that a stream manager uses."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Self

from dyknow_stream_processing.errors import StreamError

_NAMESPACE: Final = re.compile(r'(/[A-Za-z_]\w*)*', re.ASCII)


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
