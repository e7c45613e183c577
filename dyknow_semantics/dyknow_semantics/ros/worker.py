"""Threads for work that takes long, beside the callbacks of a node."""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, Final, TypeVar

from rclpy.task import Future

from dyknow_common import ExitCode
from dyknow_common.ros import DyKnowNode
from dyknow_semantics.errors import SemanticsError

Result = TypeVar('Result')
Job = tuple[Future, Callable[[], Any]]

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
        self._jobs: SimpleQueue[Job | None] = SimpleQueue()
        self._finished: SimpleQueue[tuple[Future, Any, Exception | None]] = SimpleQueue()
        self._wake = node.create_guard_condition(self._resume, callback_group=node.reentrant)
        # The end of the process does not wait for them: a change is committed or it is not.
        self._threads = [
            threading.Thread(target=self._work, name=f'{name}_{number}', daemon=True)
            for number in range(threads)
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> bool:
        """Cancel the waiting functions; return True if the running ones end within a short time."""
        while not self._jobs.empty():
            self._jobs.get()
        for _ in self._threads:
            self._jobs.put(None)
        for thread in self._threads:
            thread.join(STOP_LIMIT_S)
        return not any(thread.is_alive() for thread in self._threads)

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
        finished: Future = Future()
        self._jobs.put((finished, lambda: function(*arguments)))
        try:
            result: Result = await finished
            return result
        finally:
            self._unfinished -= 1

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            finished, call = job
            result, failure = None, None
            try:
                result = call()
            except Exception as error:  # noqa: BLE001 - raised where the result is awaited
                failure = error
            self._finished.put((finished, result, failure))
            self._wake.trigger()

    def _resume(self) -> None:
        """Resume the waiting coroutines; futures of rclpy belong to the thread of the node."""
        while not self._finished.empty():
            future, result, failure = self._finished.get()
            if failure is None:
                future.set_result(result)
            else:
                future.set_exception(failure)
