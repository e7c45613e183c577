"""Threads for long work, with a bounded queue."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Final, TypeVar

from dyknow_common import ExitCode
from dyknow_common.ros import Background, DyKnowNode
from dyknow_semantics.errors import SemanticsError

Result = TypeVar('Result')

STOP_LIMIT_S: Final = 0.5
"""The longest wait for a running function when a node stops."""


class Worker:
    """Threads that run functions in their order, while the node serves other requests.

    Args:
        node: the node.
        name: of the threads.
        threads: their number.
        max_waiting: the number of functions that may wait for a thread; `None` for any.
    """

    def __init__(
        self, node: DyKnowNode, name: str, threads: int = 1, max_waiting: int | None = None
    ) -> None:
        self._name = name
        self._unfinished = 0
        self._limit = None if max_waiting is None else threads + max_waiting
        self._background = Background(node, threads, name)

    def close(self) -> bool:
        """Cancel the waiting functions; return True if the running ones end within a short time."""
        return self._background.close(STOP_LIMIT_S)

    async def run(self, function: Callable[..., Result], *arguments: Any) -> Result:
        """Run a function in a thread; return its result or raise its error.

        Raises:
            SemanticsError: UNAVAILABLE, if too many functions wait.
        """
        if self._limit is not None and self._unfinished >= self._limit:
            raise SemanticsError(
                f'{self._unfinished} {self._name} are running or waiting already; try again later',
                ExitCode.UNAVAILABLE,
            )
        self._unfinished += 1
        try:
            return await self._background.run(partial(function, *arguments))
        finally:
            self._unfinished -= 1
